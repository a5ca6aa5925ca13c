"""A result names its inputs by hash and base name: the folder that they are in changes no byte of it."""

import shutil

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader

from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.plan import Place
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import verify
from tests.results.result_samples import metadata_of
from tests.workflows.replay.interrupted import QUICK, job_in, make_ocean

GOAL = Place(152.3, -39.8, 150.0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The same log, cut, its forecast, bathymetry and configuration, in two folders of different names."""
    first = make_ocean(tmp_path_factory.mktemp("harbour"), RunConfig(), 16)
    log = (first / "glider.mcap").read_bytes()
    (first / "glider.mcap").write_bytes(log[: len(log) * 9 // 10])
    lon, lat = np.linspace(150.0, 155.0, 8), np.linspace(-42.0, -38.0, 8)
    depth = ("lat", "lon"), np.full((8, 8), 2000.0), {"units": "m", "positive": "down"}
    bottom = xr.Dataset({"depth": depth}, {"lat": lat, "lon": lon})
    bottom.to_netcdf(first / "bottom.nc", engine="h5netcdf")
    second = tmp_path_factory.mktemp("another-place-altogether")
    shutil.copytree(first, second, dirs_exist_ok=True)
    return first, second


@pytest.fixture(scope="module")
def first(folders):
    return replayed(folders[0])


def replayed(folder):
    """The summary of a folder's replay, whose result lies in it."""
    (folder / "run.toml").write_text(
        f'planner = {{ kind = "glide", interval = 1e9, bathymetry = "{folder}/bottom.nc" }}\n'
        "estimator = { modes = 6, sample_share = 0.5, shift_distance = 0.0 }\n"
    )
    job = job_in(folder, folder / "out.mcap", GOAL, truth=str(folder / "truth.nc"))
    return replay(job, load_config(folder / "run.toml"), planner_of)[0]


@pytest.mark.full
def test_the_folder_of_the_inputs_changes_no_byte(folders, first):
    replayed(folders[1])
    one, other = ((folder / "out.mcap").read_bytes() for folder in folders)
    assert one == other


def test_what_is_lost_is_counted_and_nothing_in_a_result_names_a_folder(folders, first):
    assert first.exit_code == 4
    assert first.losses[0]["bytes"] > 0
    assert first.observations["used"] > 0
    with (folders[0] / "out.mcap").open("rb") as file:
        reader = make_reader(file)
        held = [record.data for record in reader.iter_attachments()]
        held += [repr(record.metadata).encode() for record in reader.iter_metadata()]
        held += [message.data for _, _, message in reader.iter_messages()]
    assert not [data for data in held if folders[0].name.encode() in data]
    assert any(b'bathymetry = "bottom.nc"' in data for data in held)
    assert any(b"'bathymetry': 'bottom.nc sha256:" in data for data in held)


def test_verify_finds_the_bathymetry_by_its_name_and_content(folders, first, tmp_path):
    shutil.copy(folders[0] / "out.mcap", tmp_path)
    assert verify(tmp_path / "out.mcap", [folders[1]], planner_of).same


def test_a_bathymetry_that_nothing_reads_is_no_input(folders, tmp_path):
    config = RunConfig(estimator=QUICK, planner={"bathymetry": str(tmp_path / "nowhere.nc")})
    replay(job_in(folders[0], tmp_path / "out.mcap"), config)
    inputs = metadata_of(tmp_path / "out.mcap")["replay_kit.inputs"]
    assert sorted(inputs) == ["ensemble", "log0"]
