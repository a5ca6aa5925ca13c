"""Files that numerical libraries warn about show no warning; the tests of all other commands fail at a warning too."""

import pytest
import xarray as xr

from tests.command import run_command
from tests.places import SAMPLES

GLIDER, ENSEMBLE = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("commands")
    with xr.open_dataset(ENSEMBLE) as data:
        repeated = data.isel(longitude=[0, *range(data.sizes["longitude"])])
        repeated.to_netcdf(folder / "repeated.nc")
        # without a value at some nodes of every member: means of nothing
        data.where(data.longitude > data.longitude[2]).to_netcdf(folder / "land.nc")
    return folder


@pytest.mark.parametrize("ensemble", ["repeated.nc", "land.nc"])
@pytest.mark.parametrize(
    "words",
    [
        f"replay {GLIDER} --end 2018-11-16T06:00:00Z --modes 4 -o {{0}}.mcap --ensemble",
        "info --ensemble",
    ],
)
def test_a_forecast_that_is_odd_ends_without_a_warning(folder, words, ensemble):
    done = run_command(folder, f"{words.format(ensemble)} {ensemble}")
    assert done.returncode in (0, 4), done.stderr
    assert "Warning" not in done.stdout + done.stderr
