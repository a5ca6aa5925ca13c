"""A result names its inputs by hash and base name: the folder that they are in changes no byte of it."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader

from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.plan import Place
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.verify import verify
from tests.results.result_samples import metadata_of
from tests.workflows.replay.interrupted import QUICK, make_ocean, run_until

GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[Path, Path]:
    """The same log, cut and with a wrong stamp, its forecast, bathymetry and configuration, in two folders of different names."""
    first = make_ocean(tmp_path_factory.mktemp("harbour"), RunConfig(), 16)
    log = (first / "glider.mcap").read_bytes()
    (first / "glider.mcap").write_bytes(log[: len(log) * 9 // 10])
    lon, lat = np.linspace(150.0, 155.0, 8), np.linspace(-42.0, -38.0, 8)
    xr.Dataset(
        {"elevation": (("lat", "lon"), np.full((8, 8), -2000.0), {"units": "m", "positive": "up"})},
        {"lat": lat, "lon": lon},
    ).to_netcdf(first / "bottom.nc", engine="h5netcdf")
    second = tmp_path_factory.mktemp("another-place-altogether")
    for path in first.iterdir():
        shutil.copy(path, second / path.name)
    for folder in (first, second):
        (folder / "run.toml").write_text(
            f'[planner]\nkind = "glide"\ninterval = 1e9\nbathymetry = "{folder / "bottom.nc"}"\n'
            "[estimator]\nmodes = 6\nsample_share = 0.5\nshift_distance = 0.0\n"
        )
    return first, second


@pytest.fixture(scope="module")
def results(folders) -> tuple[Path, Path]:
    """The results of the two folders."""
    for folder in folders:
        config = load_config(folder / "run.toml")
        job = ReplayJob(
            (folder / "glider.mcap",),
            folder / "ensemble.nc",
            folder / "out.mcap",
            goal=GOAL,
            truth=str(folder / "truth.nc"),
        )
        run_until(job, config, None)
    return folders[0] / "out.mcap", folders[1] / "out.mcap"


@pytest.mark.full
def test_the_folder_of_the_inputs_changes_no_byte(results):
    assert results[0].read_bytes() == results[1].read_bytes()


def test_nothing_in_a_result_names_a_folder(results):
    with results[1].open("rb") as file:
        reader = make_reader(file)
        held = [record.data for record in reader.iter_attachments()]
        held += [repr(record.metadata).encode() for record in reader.iter_metadata()]
        held += [message.data for _, _, message in reader.iter_messages()]
    assert not [data for data in held if b"another-place-altogether" in data]
    assert any(b'bathymetry = "bottom.nc"' in data for data in held)
    assert any(b"'bathymetry': 'bottom.nc sha256:" in data for data in held)


def test_verify_finds_the_bathymetry_by_its_name_and_content(folders, results, tmp_path):
    path = shutil.copy(results[0], tmp_path / "out.mcap")
    assert verify(Path(path), [folders[1]], planner_of).same


def test_a_bathymetry_that_nothing_reads_is_no_input(folders, tmp_path):
    config = RunConfig(estimator=QUICK, planner={"bathymetry": str(tmp_path / "nowhere.nc")})
    run_until(
        ReplayJob((folders[0] / "glider.mcap",), folders[0] / "ensemble.nc", tmp_path / "out.mcap"),
        config,
        None,
    )
    inputs = metadata_of(tmp_path / "out.mcap")["replay_kit.inputs"]
    assert sorted(inputs) == ["ensemble", "log0"]
