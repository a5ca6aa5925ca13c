"""``info --ensemble``: what forecasts hold, on real files and on made ones."""

import json

import numpy as np
import pytest
import xarray as xr

from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from tests import synthetic
from tests.command import invoke, succeed
from tests.forecast import forms
from tests.forecast.forms import save
from tests.places import DATA, needs

MODELS = DATA / "models"


def described(*words):
    """Return what ``info`` prints and its JSON."""
    done = succeed(["info", "--ensemble", *map(str, words), "--json", "-"], columns=300)
    return json.loads(done.stdout)["forecast"], done.stderr


@needs(MODELS)
@pytest.mark.parametrize(
    ("files", "dialect", "grids", "size", "wet"),
    [
        (
            ("nemo_ORCA025_U.nc", "nemo_ORCA025_V.nc", "nemo_ORCA025_coordinates.nc"),
            "NEMO",
            1,
            [200, 150, 75],
            0.69,
        ),
        pytest.param(
            ("nemo_ORCA025_U.nc", "nemo_ORCA025_V.nc"),
            "NEMO",
            0,
            [200, 150, 75],
            0.69,
            marks=pytest.mark.full,
        ),
        (("access_om2_u.nc", "access_om2_v.nc"), "MOM5 (B-grid)", 0, [8, 11, 4], 1.0),
        (("roms_ocean_his_0001.nc", "roms_grid.nc"), "ROMS or CROCO", 1, [7, 12, 3], 1.0),
    ],
)
def test_real_files_of_models(files, dialect, grids, size, wet):
    found, _ = described(*(MODELS / name for name in files))
    assert found["arrangement"].startswith(f"{dialect} names")
    assert len(found["grid_files"]) == grids
    assert [*found["grid"], len(found["levels"])] == size
    assert found["wet_share"] == pytest.approx(wet, abs=0.01)
    assert found["use"].startswith("one field, which --truth takes; no ensemble")
    assert found["axes"]["read_along"] == "grid"
    assert not found["axes_check"]["contradicted"]


@needs(MODELS)
def test_a_file_of_a_grid_is_told_to_hold_no_current():
    found, _ = described(MODELS / "enkfc_grid_spec.nc")
    assert found["use"].startswith(
        "no current: a file of the grid or of other variables (depth_t, lat, lon, num_levels, zt)"
    )
    assert found["grid_files"] == ["enkfc_grid_spec.nc"]
    assert found["members"] == []


def test_a_log_says_which_of_several_times_of_a_forecast_is_taken(tmp_path):
    longitude, latitude = forms.lonlat()
    ds = forms.standard(*forms.regular(longitude, latitude), longitude, latitude).isel(member=0)
    days = np.datetime64("2020-01-01", "ns") + np.arange(9) * np.timedelta64(1, "D")
    fields = [(1.0 + 0.1 * np.sin(k)) * ds for k in range(days.size)]
    save(xr.concat(fields, xr.DataArray(days, dims="time", name="time")), tmp_path / "days.nc")
    fix = {"longitude": float(longitude.mean()), "latitude": float(latitude.mean())}
    write_mcap_log(
        tmp_path / "log.mcap",
        [Message(int(days[3].astype(np.int64)), "/vehicle/fix", "foxglove.LocationFix", fix, 0, 0)],
    )
    rule = ("--members", "times:4d")
    assert described(tmp_path / "days.nc", *rule)[0]["time"] == "2020-01-09T00:00:00Z"
    log, days = tmp_path / "log.mcap", tmp_path / "days.nc"
    done = invoke(f"info {log} --ensemble {days} {' '.join(rule)} --json -")
    assert json.loads(done.stdout)["forecast"]["time"] == "2020-01-04T00:00:00Z"


def test_members_and_their_origin_are_shown(tmp_path):
    longitude, latitude = forms.lonlat()
    ds = forms.standard(*forms.regular(longitude, latitude), longitude, latitude)
    for k in range(3):
        save(ds.isel(member=k), tmp_path / f"mem{k:03d}.nc")
    done = succeed(f"info --ensemble {tmp_path}/mem*.nc", columns=200)
    assert "3 by --members files" in done.stdout
    assert "mem001.nc" in done.stdout
    assert "CF names, longitude-latitude grid, both components at the same points" in done.stdout
    assert "true east and north (standard name eastward_sea_water_velocity)" in done.stdout
    assert "Use: an ensemble of 3 members" in done.stdout
    found, _ = described(tmp_path)
    assert found["members"] == ["mem000.nc", "mem001.nc", "mem002.nc"]
    assert found["members_rule"] == "files"
    many, _ = described(save(synthetic.dataset(), tmp_path / "many.nc"))
    assert many["members_rule"] == "dim:member"
    shown = invoke(f"info --ensemble {tmp_path}/many.nc", columns=200).stdout
    assert "... 2 more ..." in shown
    assert "many.nc member 7" in shown
    assert "many.nc member 3" not in shown


def test_info_needs_a_log_or_a_forecast(tmp_path):
    done = invoke("info")
    assert done.exit_code == 2
    assert "expected a log, or a forecast with --ensemble" in done.output
    done = invoke(f"info --ensemble {tmp_path}/none*.nc")
    assert done.exit_code == 3
    assert "no file matches this pattern" in done.output
