"""``import replay_kit``: a replay, a plan and the readers as a notebook uses them."""

import subprocess
import sys

import numpy as np
import pytest

import planners
import replay_kit as rk
from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError, ForecastError, LogError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.workflows.library.calls import settings_of
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from tests.places import ROOT, SAMPLES

LOG, ENSEMBLE = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
SETTINGS = {
    "logs": {"end": "2018-11-16T04:00:00Z"},
    "forecast": {"levels": [5, 150, 500]},
    "estimator": {"modes": 10, "sample_share": 0.5, "shift_distance": 0.0},
    "output": {"depths": [150.0], "interval": 1e6},
}
START, GOAL = (153.12, -40.28, 0.0), (153.05, -40.2, 150.0)


@pytest.fixture(scope="module")
def result() -> rk.Result:
    return rk.replay(LOG, ENSEMBLE, goal=GOAL, settings=SETTINGS)


def test_a_replay_is_one_call_and_its_answer_one_more(result):
    got = result.estimate.velocity_at(153.1, -40.25, 150.0)
    assert np.isfinite([got.u, got.v]).all()
    assert 0.0 < got.u_standard_error < 0.3
    used = result.outcome.observations["used"]
    assert used == (result.observations["decision"] == "accepted").sum() > 20
    assert repr(result.outcome).startswith(result.outcome.verdict.word)
    assert f"estimate: {result.outcome.verdict};" in repr(result)


def test_what_is_opened_is_what_was_made(result, tmp_path):
    out = str(tmp_path / "out.mcap")
    goal = rk.Place(*GOAL)
    made = rk.replay([str(LOG)], str(ENSEMBLE), out=out, goal=goal, settings=SETTINGS)
    opened = rk.open_result(out)
    assert made.path.read_bytes() == result.path.read_bytes()
    assert opened.made is None
    assert opened.outcome == made.outcome
    np.testing.assert_array_equal(opened.estimate.latent, result.estimate.latent)
    # of the covariance a result keeps what single precision holds
    p, kept = result.estimate.unknowns.p, opened.estimate.unknowns.p
    np.testing.assert_allclose(kept, p, rtol=0.0, atol=1e-6)
    assert opened.estimate.span_ns == result.estimate.span_ns
    with pytest.raises(ConfigError, match="exists"):
        rk.replay(LOG, ENSEMBLE, out=made.path, settings=SETTINGS)
    opened.estimate.save(tmp_path / "flow.nc")
    saved = rk.open_estimate(str(tmp_path / "flow.nc"))
    np.testing.assert_array_equal(saved.latent, result.estimate.latent)


def test_a_temporary_result_lasts_as_long_as_its_value():
    made = rk.replay(rk.open_log(LOG), ENSEMBLE, settings=SETTINGS)
    folder = made.path.parent
    assert made.path.exists()
    assert made.plans.empty
    del made
    assert not folder.exists()


def test_a_replay_that_fails_leaves_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(LogError, match=r"nowhere\.mcap: file not found"):
        rk.replay("nowhere.mcap", ENSEMBLE)
    with pytest.raises(ForecastError, match=r"nowhere\.nc: no such file"):
        rk.replay(LOG, "nowhere.nc")
    assert not list(tmp_path.iterdir())


def test_a_log_is_iterated_as_it_is_or_in_its_context():
    with rk.open_log(LOG) as log:
        expected = [message.position for message in log.messages()]
    assert [message.position for message in rk.open_log(LOG)] == expected
    first = next(rk.observations(rk.open_log(LOG)))
    assert first.depth.size
    # a loop that ends early leaves no file open, of which a warning would tell
    assert next(iter(rk.open_log(LOG))).position == expected[0]


def test_what_is_lost_of_a_log_is_a_warning(tmp_path):
    (tmp_path / "cut.mcap").write_bytes(LOG.read_bytes()[:-200_000])
    with pytest.warns(UserWarning, match="lost: 1 damaged parts of the logs, 0 late messages"):
        rk.replay(tmp_path / "cut.mcap", ENSEMBLE, settings=SETTINGS)


def test_a_plan_is_one_call(result):
    plan = rk.plan(result.estimate, START, GOAL)
    assert plan.status == "uncertain"
    assert " of 100 simulated flights come up " in plan.message
    assert plan.start_time_ns == result.estimate.time_ns
    assert plan.message.endswith("; assumed: 0.30 m/s, dives to 500 m")
    quick = {"planner": {"speed": 0.4}}
    later = rk.plan(result.estimate, rk.Place(*START), GOAL, time="2018-11-17", settings=quick)
    assert (later.speed, later.start_time_ns) == (0.4, 1_542_412_800 * 10**9)
    assert later.message.endswith("; assumed: dives to 500 m")
    glide = rk.plan(result.estimate, START, GOAL, settings={"planner": {"kind": "glide"}})
    assert glide.message.endswith("; assumed: 0.30 m/s")
    with pytest.raises(PlanError, match="goal"):
        rk.plan(result.estimate, START, (10.0, 50.0, 0.0))


def test_an_ensemble_is_the_part_that_the_settings_choose():
    ensemble = rk.open_ensemble(str(ENSEMBLE), settings=SETTINGS)
    assert ensemble.grid.levels.tolist() == [5.0, 150.0, 500.0]
    assert repr(ensemble).startswith(
        f"Ensemble of 40 members from {ENSEMBLE}, 2018-11-16 00:00:00Z, RMS component speed 0.2"
    )
    assert repr(ensemble.grid) in repr(ensemble)


def test_settings_are_tables_a_file_or_a_configuration(tmp_path):
    config = load_config(None, SETTINGS)
    (tmp_path / "run.toml").write_text(run_settings_toml(config))
    for form in (SETTINGS, config, tmp_path / "run.toml", str(tmp_path / "run.toml")):
        assert settings_of(form) == config
    assert settings_of(None) == rk.RunConfig()
    with pytest.raises(ConfigError, match=r"forecast\.lev"):
        rk.open_ensemble(ENSEMBLE, settings={"forecast": {"lev": [5]}})


PATH = "expected a path (str or Path), got"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rk.open_log([LOG]), f"log: {PATH} list"),
        (lambda: rk.replay([LOG, None], ENSEMBLE), f"log: {PATH} NoneType"),
        (lambda: rk.replay(LOG, rk.open_log(LOG)), f"ensemble: {PATH} McapReader"),
        (
            lambda: rk.replay(LOG, ENSEMBLE, overwite=True),
            "replay: expected options among overwrite, estimator, planner, got overwite",
        ),
        (lambda: rk.replay([], ENSEMBLE), "logs: expected one log or several, got none"),
        (lambda: rk.plan("flow.nc", START, GOAL), "estimate: expected a FlowEstimate, got str"),
        (lambda: rk.replay(LOG, ENSEMBLE, out=1), f"out: {PATH} int"),
        (lambda: rk.replay(LOG, ENSEMBLE, settings=1), f"settings: {PATH} int"),
        (lambda: rk.replay(LOG, ENSEMBLE, goal=(1.0, 2.0)), "and depth [m], got (1.0, 2.0)"),
        (lambda: rk.open_ensemble(None), f"ensemble: {PATH} NoneType"),
        (lambda: rk.open_estimate(b"x"), f"estimate: {PATH} bytes"),
        (lambda: rk.open_result({}), f"result: {PATH} dict"),
    ],
)
def test_a_wrong_type_is_named(call, words):
    with pytest.raises(ConfigError) as error:
        call()
    assert words in str(error.value)


def test_texts_of_values_are_short(result):
    log = rk.open_log(LOG)
    message, first = next(log.messages()), next(rk.observations(log.messages()))
    plan = rk.plan(result.estimate, START, GOAL)
    for value, words in (
        (log, f"Log {LOG} (mcap, "),
        (message, "Message 2018-11-16 00:00:00Z /vehicle/fix (foxglove.LocationFix): "),
        (first, "Observation 2018-11-16 00:00:00Z at 153.1360 E, 40.2916 S, "),
        (plan, "Plan for 2018-11-16 04:00:00Z: uncertain; 153.1200 E, "),
        (result, ""),
        (result.estimate, ""),
        (result.estimate.grid, "Grid of 3 levels x 13 x 21 points (100 % wet): "),
    ):
        assert repr(value).startswith(words)
        assert len(repr(value)) < 400
        assert repr(value).count("\n") <= 2


def test_every_public_name_is_there_and_no_other():
    for package in (rk, planners):
        # tools such as the site's reference know a package by dir
        assert set(package.__all__) <= set(dir(package))
        for name in package.__all__:
            assert getattr(package, name) is not None
    assert rk.FlowEstimate is FlowEstimate
    with pytest.raises(AttributeError, match=r"has no attribute 'relpay'; it has .*replay"):
        rk.relpay  # noqa: B018


def test_names_are_loaded_when_they_are_asked_for():
    program = (
        "import sys; before = set(sys.modules); import replay_kit as rk; "
        "assert not {'numpy', 'pydantic', 'xarray', 'scipy'} & (set(sys.modules) - before); "
        "rk.open_log(sys.argv[1]); "
        "heavy = {'pandas', 'xarray', 'scipy', 'casadi', 'matplotlib', 'pyproj', 'pymavlink'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", program, str(LOG)], cwd=ROOT, check=True)
