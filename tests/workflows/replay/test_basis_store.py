"""Estimators that are kept: what is read is what was built, for each kind, and nothing of another version or damaged is used."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replay_kit.core.sealed import sealed

from replay_kit.config.run import load_config
from replay_kit.core.errors import LogError
from replay_kit.core.plan import Place
from replay_kit.workflows.replay.inputs import estimator as basis_store
from replay_kit.workflows.replay.inputs.estimator import build, built
from replay_kit.workflows.replay.inputs.forecast import read_forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from tests import synthetic

SETTINGS = {"estimator": {"modes": 6}}
KINDS = [
    "naive3d",
    "nearest",
    "reduced_basis",
]


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ocean")
    synthetic.write_ocean(folder, 6)
    return folder


def job_in(ocean, folder):
    return ReplayJob(
        (), (ocean / "ensemble.nc",), goal=Place(152.3, -39.8, 100.0), basis_store=folder
    )


def forecasts_in(ocean, config):
    return read_forecasts((ocean / "ensemble.nc",), config, None, None)


def innovations(estimator, grid):
    return [
        each.innovation.innovation
        for each in estimator.assimilate(estimator.initial(), synthetic.random_profiles(grid, 3))[1]
    ]


@pytest.mark.parametrize(
    "settings",
    [
        *({"estimator": {"name": name, "modes": 6}} for name in KINDS),
        {**SETTINGS, "time": {"scale": 3e5}},
    ],
)
def test_what_is_read_gives_what_was_built(ocean, tmp_path, settings):
    config = load_config(None, settings)
    forecasts = forecasts_in(ocean, config)
    fresh, grid = build(forecasts, config), forecasts.ensemble.grid
    for _ in range(2):
        kept = built(forecasts, config, job_in(ocean, tmp_path))
        assert type(kept) is type(fresh)
        np.testing.assert_array_equal(innovations(kept, grid), innovations(fresh, grid))
    assert len(list(tmp_path.glob("*.basis"))) == 1


def test_other_settings_parts_and_versions_have_estimators_of_their_own(
    ocean, tmp_path, monkeypatch
):
    config = load_config(None, SETTINGS)
    job = job_in(ocean, tmp_path)
    part = load_config(None, {**SETTINGS, "forecast": {"levels": [5.0, 60.0]}})
    for count, given in enumerate(
        (config, part, load_config(None, {"estimator": {"modes": 5}})), start=1
    ):
        built(forecasts_in(ocean, given), given, job)
        assert len(list(tmp_path.glob("*.basis"))) == count
    built(forecasts_in(ocean, config), config, replace(job, goal=None))
    assert len(list(tmp_path.glob("*.basis"))) == 3
    monkeypatch.setattr(basis_store, "package_versions", lambda: {"replay-kit": "another"})
    built(forecasts_in(ocean, config), config, job)
    assert len(list(tmp_path.glob("*.basis"))) == 4


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: sealed(b"replay-kit basis 1\n" + data[19:-84]), "of another kind or version"),
        (lambda data: data[: len(data) // 2], "its checksum is missing"),
        (lambda data: data[:19] + bytes(8) + data[27:], "its checksum does not match"),
        (lambda data: data[:-9000] + bytes([data[-9000] ^ 1]) + data[-8999:], "checksum"),
        (
            lambda data: sealed(
                data[:-84].replace(b"replay_kit.core.grid", b"replay_kit.core.gnid")
            ),
            "gnid",
        ),
    ],
)
def test_a_damaged_file_is_named_and_not_used(ocean, tmp_path, change, said):
    config = load_config(None, SETTINGS)
    forecasts = forecasts_in(ocean, config)
    built(forecasts, config, job_in(ocean, tmp_path))
    (path,) = tmp_path.glob("*.basis")
    # a file of its own: the arrays of the one that is there are still mapped
    data = change(path.read_bytes())
    path.unlink()
    path.write_bytes(data)
    with pytest.raises(
        LogError, match=f"{path}: the basis cannot be used: .*{said}.*; delete the file"
    ):
        built(forecasts, config, job_in(ocean, tmp_path))


def test_what_a_killed_process_left_is_removed_by_the_next_one_that_builds(ocean, tmp_path):
    config = load_config(None, SETTINGS)
    forecasts = forecasts_in(ocean, config)
    built(forecasts, config, job_in(ocean, tmp_path))
    (path,) = tmp_path.glob("*.basis")
    path.unlink()
    for name in (f"{path.stem}-1.new.part", f"{path.stem}-2.new", "another-1.new.part"):
        (tmp_path / name).write_bytes(b"half")
    built(forecasts, config, job_in(ocean, tmp_path))
    assert path.exists()
    assert [left.name for left in tmp_path.glob("*.new*")] == ["another-1.new.part"]


def test_nothing_is_left_of_a_file_that_cannot_be_written(ocean, tmp_path, monkeypatch):
    config = load_config(None, SETTINGS)

    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("replay_kit.core.atomic.os.fsync", full)
    with pytest.raises(Exception, match="is the disk full"):
        built(forecasts_in(ocean, config), config, job_in(ocean, tmp_path))
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".lock"]
