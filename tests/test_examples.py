"""The package that adds one of each kind: installed, found by its entry points and used; and packages that cannot be loaded, named."""

import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import EstimatorConfig, MeasurementConfig, load_config
from replay_kit.core import extensions
from replay_kit.core.errors import ConfigError, MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.estimator.baselines import build_named
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.netcdf.dialects import dialect_of
from replay_kit.logs.tables import schemas
from replay_kit.measurements.checks.check import added_checks
from replay_kit.measurements.observed import new_stream
from tests import synthetic
from tests.measurements.samples import interpret_block
from tests.places import ROOT
from tests.synthetic import ensemble
from tests.synthetic_flow import TIME_NS

EXTENSION = ROOT / "sample_logs" / "examples" / "extension"
NAMED = EstimatorConfig(name="mine")
POINTS = tomllib.loads((EXTENSION / "pyproject.toml").read_text())["project"]["entry-points"]


@pytest.fixture(autouse=True)
def _forget():
    """Forget the entry points before and after each test."""
    for cached in (extensions._points, extensions._loaded, schemas.reader_of):
        cached.cache_clear()
    yield
    for cached in (extensions._points, extensions._loaded, schemas.reader_of):
        cached.cache_clear()


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Let the example package be installed, as its wheel would write it."""
    lines = []
    for group, held in POINTS.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in held.items())]
    info = tmp_path / "replay_kit_example-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: replay-kit-example\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(EXTENSION))


@pytest.mark.usefixtures("installed")
def test_each_kind_is_found_where_the_project_looks_for_it():
    from planners.request import MissionSettings

    assert dialect_of(["JULD", "CURRENT_EAST", "CURRENT_NORTH"], {}).name == "ego"
    assert [check.__name__ for check in added_checks().values()] == ["repeated_times"]
    estimator = build_named(ensemble(), EstimatorConfig(name="closest"))
    assert type(estimator).__name__ == "NearestMember"
    planner = load_config(None, {"planner": {"objective": "surfacings"}}).planner
    assert planner.objective == "surfacings"
    assert MissionSettings(objective="surfacings").aim.rank is not None
    payload = {"longitude": 2.2, "latitude": 41.3, "towards": 90.0, "speed": 0.3, "error": 0.05}
    messages = [
        Message(7, "/radial", "example/Radial", payload | {"error": error}, 0, k)
        for k, error in enumerate((0.05, 0.0))
    ]
    _, ((_, given), (skipped,)) = interpret_block(new_stream(), messages, MeasurementConfig())
    assert (given.time_ns, given.source.topic) == (7, "/radial")
    np.testing.assert_allclose([*given.value[0], *given.components[0]], [0.3, 1.0, 0.0], atol=1e-15)
    assert skipped.reason == "radial without an error"
    (section,) = extensions.additions("sections", callable, "").values()
    assert section.__name__ == "depths_section"


def test_without_the_package_its_names_are_refused():
    with pytest.raises(
        ConfigError, match="expected one of time, energy, odds, closest, got 'surfacings'"
    ):
        load_config(None, {"planner": {"objective": "surfacings"}})
    with pytest.raises(ConfigError, match="got 'closest'"):
        build_named(ensemble(), EstimatorConfig(name="closest"))


def dialects():
    return dialect_of(["a"], {})


def estimators():
    return build_named(ensemble(), NAMED)


@pytest.mark.parametrize(
    ("use", "value", "words"),
    [
        (dialects, "no_such_module:EGO", "cannot be imported: ModuleNotFoundError"),
        (dialects, "math:pi", "expected a Dialect, got float"),
        (added_checks, "math:pi", "expected a check, got float"),
        (estimators, "math:pi", "expected a function, got float"),
    ],
)
def test_a_package_that_cannot_be_used_is_named(monkeypatch, use, value, words):
    kind = use.__name__.removeprefix("added_")
    point = EntryPoint("mine", value, f"replay_kit.{kind}")
    monkeypatch.setattr(extensions, "_points", lambda asked: (point,) if asked == kind else ())
    with pytest.raises(ConfigError, match=f"^replay_kit.{kind}: mine = {value}.*{words}"):
        use()


def test_two_packages_of_one_name_are_refused(monkeypatch):
    points = tuple(
        EntryPoint("mine", f"math:{name}", "replay_kit.sections") for name in ("sin", "cos")
    )
    monkeypatch.setattr(extensions, "_points", lambda kind: points)
    with pytest.raises(ConfigError, match="another package adds this name too"):
        extensions.additions("sections", callable, "a function")


def sensor(payload):
    """A current meter chain; with ``pairs``, each value is the mean of two points."""
    depth = [np.nan if each is None else each for each in payload["depth"]]
    made = Observation.profile(
        0, 152.2, -39.8, depth, *(np.full((2, len(depth)), 0.1)), 0.05
    ).linear
    if payload["pairs"]:
        n = len(depth) // 2
        short = {name: getattr(made, name)[:n] for name in ("value", "error_std")}
        flags = {"flags": np.ones(n, np.int8), "reasons": np.zeros(n, np.int32)}
        return replace(made, weights=np.repeat(np.eye(n), 2, axis=1) / 2, **short, **flags)
    return replace(made, flags=np.ones(len(depth), np.int8))


@pytest.mark.parametrize("pairs", [False, True])
def test_a_sensors_values_without_a_place_in_the_water_are_flagged_and_of_their_own_kind(
    monkeypatch, tmp_path, pairs
):
    point = EntryPoint("test.Chain", "tests.test_examples:sensor", "replay_kit.sensors")
    monkeypatch.setattr(extensions, "_points", lambda asked: (point,) * (asked == "sensors"))

    def replayed(depth, **measurements):
        payload = {"depth": depth, "pairs": pairs}
        write_mcap_log(
            tmp_path / "a.mcap", [Message(TIME_NS, "/chain", "test/Chain", payload, 0, 0)]
        )
        dataset = synthetic.dataset(n_members=6).assign_coords(time=np.datetime64(TIME_NS, "ns"))
        settings = {
            "estimator": {"modes": 4, "shift_distance": 0.0},
            "time": {"scale": "static"},
            "measurements": measurements,
        }
        return rk.replay(tmp_path / "a.mcap", dataset, settings=settings)

    sound = [20.0, 40.0, 60.0, 80.0]
    expected, found = (replayed([*sound, *odd]) for odd in ([], [None, 30.0, -20.0, 30.0]))
    (row,) = found.outcome.observations["sources"]
    assert (row["kind"], row["used"]) == ("sensors", 1)
    assert found.outcome.observations["bins_rejected"] == {"missing": 1, "above_surface": 1}
    if pairs:
        np.testing.assert_allclose(found.estimate.latent, expected.estimate.latent, atol=1e-12)
    with pytest.raises(MeasurementError, match="left out: sensors"):
        replayed(sound, without=["sensors"])


@pytest.mark.full
def test_the_wheel_of_the_package_has_its_entry_points(tmp_path):
    words = "-m pip install --quiet --no-deps --no-build-isolation --target"
    installed = tmp_path / "installed"
    subprocess.run([sys.executable, *words.split(), installed, EXTENSION], check=True)
    code = "from replay_kit.core.extensions import names_of; print(names_of('dialects'), names_of('estimators'))"
    path = os.pathsep.join((str(installed), str(ROOT)))
    said = subprocess.check_output(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": path}, text=True
    )
    assert said.strip() == "('ego',) ('closest',)"
