"""No command shows a warning of a library: each is an error here, on samples and on files that numerical libraries warn about."""

import warnings

import pytest
import xarray as xr

import replay_kit as rk
from tests.command import run_command
from tests.places import SAMPLES

GLIDER, ENSEMBLE = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
SHORT = f"--ensemble {ENSEMBLE} --end 2018-11-16T06:00:00Z --modes 4 --config run.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("commands")
    (folder / "run.toml").write_text("[estimator]\nsample_share = 0.5\n")
    settings = {
        "logs": {"end": "2018-11-16T06:00:00Z"},
        "estimator": {"modes": 4, "sample_share": 0.5},
    }
    rk.replay(GLIDER, ENSEMBLE, settings=settings, goal=(152.6, -40, 5), out=folder / "r.mcap")
    with xr.open_dataset(ENSEMBLE) as data:
        repeated = data.isel(longitude=[0, *range(data.sizes["longitude"])])
        repeated.to_netcdf(folder / "repeated.nc")
        # without a value at some nodes of every member: means of nothing
        data.where(data.longitude > data.longitude[2]).to_netcdf(folder / "land.nc")
    return folder


@pytest.mark.parametrize(
    "words",
    [
        f"replay {GLIDER} {SHORT} -o glider.mcap",
        f"replay {SAMPLES / 'glider.tlog'} {SHORT} -o tlog.mcap",
        f"replay {GLIDER} {SHORT.replace(str(ENSEMBLE), 'repeated.nc')} -o repeated.mcap",
        f"replay {GLIDER} {SHORT.replace(str(ENSEMBLE), 'land.nc')} -o land.mcap",
        f"smooth {GLIDER} {SHORT} -o smooth.mcap",
        f"info {SAMPLES / 'survey.mcap'}",
        f"info {SAMPLES / 'glider.tlog'}",
        "info --ensemble repeated.nc",
        "info --ensemble land.nc",
        f"qc {GLIDER}",
        f"convert {SAMPLES / 'glider.tlog'} -o converted.mcap",
        "report r.mcap -o r.html",
        "status r.mcap",
        "layout r.mcap -o layout.json",
        "plot r.mcap map -o map.png",
        "plot r.mcap section -o section.png",
        "plot r.mcap trust -o trust.png",
        "export r.mcap -o r.csv --table track",
        "export r.mcap -o r.nc",
        "plan r.mcap --start 152.4,-40.1,5 --goal 152.6,-40.0,5 -o plan.mcap",
        f"verify r.mcap --inputs {SAMPLES}",
        "synthesize --ensemble made.nc --truth truth.nc --members 4",
        f"twin --truth {ENSEMBLE}#0 -o twin.mcap --pings 20 --vehicle glider",
    ],
)
def test_a_command_ends_without_a_warning(folder, words):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = run_command(folder, words)
    assert done.returncode in (0, 4), done.stderr
    assert "Warning" not in done.stdout + done.stderr
