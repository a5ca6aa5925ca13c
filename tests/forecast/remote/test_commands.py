"""Commands with a forecast on a server: the same estimate as with the file, again without a link, and one download for many logs."""

import json
import logging
import re

import numpy as np
import pytest
import xarray as xr

from replay_kit.forecast.remote.kept import record_of
from replay_kit.results import read_recorded
from tests.command import invoke, succeed
from tests.forecast.remote.conftest import sea
from tests.forecast.remote.servers import Files, serving, zarr_objects
from tests.places import SAMPLES

pytest.importorskip("aiohttp", reason="the extra 'remote' is not installed")
pytestmark = pytest.mark.filterwarnings("ignore:Consolidated metadata is currently not part")
LOG = str(SAMPLES / "survey.mcap")
QUICK = "--end 2018-11-16T01:00Z --modes 5 --levels 5,50"


@pytest.fixture(autouse=True)
def quiet(here, tmp_path):
    (tmp_path / "run.toml").write_text(f'[forecast]\ncache = "{tmp_path}/cache"\n')
    logging.disable(logging.WARNING)
    yield
    logging.disable(logging.NOTSET)


@pytest.fixture(scope="module")
def ensemble():
    with xr.open_dataset(SAMPLES / "ensemble.nc") as ds:
        held = ds.drop_vars("time").isel(member=slice(6)).load()
    for variable in held.variables.values():
        variable.encoding = {}
    return held


def replayed(folder, name, forecast, more=""):
    """Replay on a forecast; return the bytes of the result and of the lossless estimate."""
    out, flow = folder / f"{name}.mcap", folder / f"{name}.nc"
    files = f"--ensemble {forecast} -o {out} --save-estimate {flow} --config {folder}/run.toml"
    succeed(f"replay {LOG} {files} {QUICK} {more}")
    return out.read_bytes(), flow.read_bytes()


@pytest.mark.full
def test_a_replay_by_address_is_that_of_the_file_and_the_same_without_a_link(tmp_path, ensemble):
    ensemble.to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    _, expected = replayed(tmp_path, "file", str(tmp_path / "e.nc"))
    with serving(Files(zarr_objects(ensemble, zarr_format=2))) as files:
        result, flow = replayed(tmp_path, "zarr", files.url)
        assert flow == expected
    assert replayed(tmp_path, "offline", files.url, "--offline") == (result, expected)
    recorded = read_recorded(tmp_path / "zarr.mcap")
    fetched = json.loads(recorded.metadata["replay_kit.fetched"]["ensemble"])
    assert fetched["address"] == files.url
    name, _, digest = recorded.metadata["replay_kit.inputs"]["ensemble"].rpartition(" sha256:")
    assert fetched == record_of(tmp_path / "cache" / name)
    assert digest.startswith(name.removesuffix(".nc").rpartition("-")[2])
    assert "offline" not in recorded.config_toml
    verified = invoke(f"verify {tmp_path}/zarr.mcap --inputs {tmp_path}/cache --inputs {SAMPLES}")
    assert "the same values" in verified.output


def test_fetch_says_what_it_costs_and_gives_a_file_for_the_boat(tmp_path, ensemble):
    cache, out = f"--config {tmp_path}/run.toml", f"{tmp_path}/boat.nc"
    with serving(Files(zarr_objects(ensemble, zarr_format=2))) as files:
        part = f"--ensemble {files.url} --region 152,-40.2,153,-39.8 {cache}"
        priced = invoke(f"fetch {part} --dry-run --json -")
        (row,) = json.loads(priced.stdout)["addresses"]
        assert row["shape"] == {"member": 6, "depth": 6, "latitude": 5, "longitude": 9}
        assert row["bytes"] > 2 * 8 * 6 * 6 * 5 * 9
        assert not (tmp_path / "cache").exists()
        done = succeed(f"fetch {part} -o {out} --json {tmp_path}/a.json")
        assert "received" in done.output
        described = invoke(f"info --ensemble {files.url} {cache}")
        assert "6 member x 6 depth x 13 latitude x 21 longitude" in described.output
        count = len(files.asked)
    (held,) = json.loads((tmp_path / "a.json").read_text())["files"]
    assert held["address"] == files.url
    with xr.open_dataset(out) as ds:
        expected = ensemble.sel(longitude=slice(152, 153), latitude=slice(-40.2, -39.8))
        np.testing.assert_array_equal(ds.uo, expected.uo)
    told = invoke(f"info {part} --offline")
    assert "an ensemble of 6 members" in told.output
    assert len(files.asked) == count
    missing = invoke(f"info --ensemble {files.url} --region 1,2,3,4 {cache}")
    assert "the server cannot be reached: Connection refused" in missing.stderr
    refused = invoke(f"fetch --ensemble {out}")
    assert "expected an address, such as https://" in refused.stderr
    paper = f"experiment paper --leave-out 1 -o {tmp_path}/paper"
    other = invoke(f"{paper} --ensemble {files.url}")
    assert "fetch the forecast first: replay-kit fetch --ensemble http://127.0.0.1" in other.stderr


def test_another_year_or_ocean_is_said_before_the_margin_is_measured(tmp_path):
    """The margin needs the correlation length, hence values."""
    for east, year, words in ((149, 2010, "the forecast is of 2010"), (9, 2018, "covers")):
        ds = sea(times=2, shape=(60, 80)).assign_coords(
            lon=("lon", east + 0.1 * np.arange(80), {"units": "degrees_east"}),
            lat=("lat", -43.0 + 0.1 * np.arange(60), {"units": "degrees_north"}),
            time=np.array([f"{year}-11-16", f"{year}-11-17"], "M8[ns]"),
        )
        with serving(Files(zarr_objects(ds, zarr_format=2))) as files:
            done = invoke(f"fetch {LOG} --ensemble {files.url} --config {tmp_path}/run.toml")
        assert done.exit_code == 3
        assert words in done.stderr
        assert not [path for path in files.asked if re.match(r"[uv]o/\d", path)]
