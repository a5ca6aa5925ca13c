"""Files of a Seaglider's basestation: a small dive with its ADCP, its edits, and real dives."""

import h5netcdf
import numpy as np
import pytest
import xarray as xr

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.netcdf.dialects import GLIDERS
from replay_kit.logs.netcdf.variables import open_netcdf
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read
from tests.places import DATA

WITH_ADCP = sorted((DATA / "seaglider").glob("p17101*.nc"))
real = pytest.mark.skipif(not WITH_ADCP, reason="../shared/data/seaglider is not there")

_SECONDS = {"units": "seconds since 1970-1-1 00:00:00"}


def _small_dive():
    """A dive of 20 minutes to 100 m: name to dimensions, values, attributes."""
    time = made.START + np.arange(0.0, 1201.0, 10.0)
    depth = 100.0 - np.abs(np.linspace(-100.0, 100.0, time.size))
    depth[7] = np.nan
    relative = np.full((3, 4), 0.25)
    relative[1, 2] = np.nan
    profile = np.full((31, 2), 0.125)
    profile[25:] = -999.0
    gps = {
        "log_gps_time": (made.START + np.array([-300.0, -60.0, 1260.0]), _SECONDS),
        "log_gps_lat": [12.0, 12.001, 12.01],
        "log_gps_lon": [85.0, 85.001, 85.01],
        "log_gps_qc": np.array([b"1"] * 3),
    }
    ctd = {
        "ctd_time": (time, _SECONDS),
        "ctd_depth": (depth, {"_FillValue": np.float64(np.nan)}),
        "latitude": np.linspace(12.001, 12.01, time.size),
        "longitude": np.linspace(85.001, 85.01, time.size),
    }
    pings = {
        "ad2cp_time": (made.START + np.array([100.0, 200.0, 300.0]), _SECONDS),
        "ad2cp_temperature": [300.0, 295.0, 290.0],
    }
    once = {
        "ad2cp_blanking": (10.0, "cm"),
        "ad2cp_cellSize": (2000.0, "mm"),
        "ad2cp_soundspeed": (15_300.0, "m/s"),
        "depth_avg_curr_east": 0.1,
        "depth_avg_curr_north": -0.2,
        "depth_avg_curr_error": 0.01,
        "depth_avg_curr_qc": b"1",
        "magnetic_variation": -1.5,
        "log_dive": 7.0,
    }
    cells = dict.fromkeys(("ad2cp_velX", "ad2cp_velY", "ad2cp_velZ"), (relative, "m/s"))
    inverted = dict.fromkeys((f"ad2cp_inv_profile_{name}ocn" for name in "uvw"), profile)
    level, fill = {"ad2cp_inv_profile_depth": np.arange(31) * 5.0}, np.float64(-999.0)
    return (
        made.over("gps", gps)
        | made.over("ctd", ctd)
        | made.over("ping", pings)
        | made.over(("ping", "cell"), cells)
        | made.over((), once)
        | made.over("level", level, _FillValue=fill)
        | made.over(("level", "leg"), inverted, _FillValue=fill)
    )


def _write_hdf5(path, variables):
    return made.write(path, variables, {"dive_number": 7})


def _write_classic(path, variables):
    modern = _write_hdf5(path.with_suffix(".h5"), variables)
    with xr.open_dataset(modern, engine="h5netcdf", decode_cf=False) as dive:
        dive.to_netcdf(path, engine="scipy")
    return path


both = pytest.mark.parametrize("write", [_write_hdf5, _write_classic])


@pytest.mark.parametrize("which", ["made", pytest.param("real", marks=real)])
def test_variables_are_those_that_h5netcdf_reads(tmp_path, which):
    path = WITH_ADCP[0] if which == "real" else _write_hdf5(tmp_path / "a.nc", _small_dive())
    dive = open_netcdf(path, lambda held, _: GLIDERS[0].wanted(held))
    with h5netcdf.File(path, "r") as file:
        assert dive.dive_number == int(file.attrs["dive_number"])
        for name, stored in dive.variables.items():
            theirs = file.variables[name]
            np.testing.assert_array_equal(stored.values, theirs[...], strict=True)
            for key in ("units", "_FillValue", "flag_meanings"):
                # h5netcdf leaves text of a fixed length as bytes
                said = theirs.attrs.get(key)
                said = said.decode() if isinstance(said, bytes) else said
                np.testing.assert_equal(stored.attributes.get(key), said)
            assert stored.dims == theirs.dimensions
        wanted = {
            name
            for name in file.variables
            if name.startswith(("log_gps_t", "log_gps_l", "ad2cp_", "ctd_time"))
        }
        assert wanted <= dive.variables.keys()


@both
def test_a_small_dive(tmp_path, write):
    said = read(write(tmp_path / "p0010007.nc", _small_dive()))
    assert open_log(tmp_path / "p0010007.nc").is_gliders()
    # 121 samples ten seconds apart, one a minute
    counts = {"/vehicle/fix": 3, "/vehicle/position": 21, "/adcp": 3, "/adcp/inverted": 2}
    assert said.counts() == counts | {"/dac": 1} == said.report.read
    assert said.report.undecodable == {}
    (down, up), (dac,), (_, ping, _) = map(said.of, ("/adcp/inverted", "/dac", "/adcp"))
    assert ping == ping | {"reference": "platform", "coordinate_system": "earth"}
    assert ping == ping | {"orientation": "up", "cell_size": 2.0, "bin0_distance": 2.1}
    assert ping == ping | {"n_cells": 4, "sound_speed": 1530.0, "temperature": 29.5}
    assert ping["magnetic_declination"] == -1.5
    assert ping["velocity"] == [[0.25] * 3, [0.25] * 3, [None] * 3, [0.25] * 3]
    profile = {"dive": 7, "bin0_distance": 0.0, "cell_size": 5.0, "n_cells": 31}
    profile["velocity"] = [[0.125] * 3] * 25 + [[None] * 3] * 6
    for one, number, second in ((down, 14, 600), (up, 15, 1200)):
        stamp = {"sec": int(made.START) + second, "nsec": 0}
        assert one == one | profile | {"ping": number, "stamp": stamp}
    assert dac == dac | {"dac_eastward": 0.1, "dac_northward": -0.2, "error": 0.01}
    assert (dac["duration"], dac["stamp"]["sec"]) == (1320.0, int(made.START) + 1260)
    # the same water is not counted twice: either the profiles, or what they were computed from
    down, up = observations(said.messages, MeasurementConfig())
    np.testing.assert_allclose(down.depth, np.arange(31) * 5.0)
    assert np.isfinite(down.velocity).all(axis=1).sum() == 25
    assert (down.dive, up.dive) == (7, 7)
    assert (down.longitude, up.longitude) == pytest.approx((85.0055, 85.01), abs=1e-4)
    others = observations(said.messages, MeasurementConfig(use_inverted=False))
    found = [(o.source.topic, o.reference) for o in others if o.source.topic != "/dac"]
    assert found == [("/adcp", "platform")] * 3


_AXES, _GPS = "ad2cp_coordinateSystem", {k: v for k, v in _small_dive().items() if "log_gps" in k}
_OTHER_AXES = "ADCP: not read, because its velocities are not east, north and up"
_FLAGS = {
    "log_gps_qc": (("gps",), np.array([b"4", b"1", b"9"]), {}),
    "depth_avg_curr_qc": ((), b"4", {}),
}


@pytest.mark.parametrize(
    ("dive", "counts", "skipped", "note"),
    [
        (_small_dive() | made.over((), {_AXES: 0.0}), (3, 3, 1), {}, "ADCP: assumed to look up"),
        (_small_dive() | made.over((), {_AXES: 1.0}), (3, 0, 1), {}, _OTHER_AXES),
        (_small_dive() | _FLAGS, (1, 3, 0), {"/vehicle/fix": 2, "/dac": 1}, "not used"),
        (_GPS, (3, 0, 0), {}, "nothing"),
    ],
)
def test_a_dive_that_was_changed(tmp_path, dive, counts, skipped, note):
    said = read(_write_hdf5(tmp_path / "a.nc", dive))
    assert tuple(len(said.of(topic)) for topic in ("/vehicle/fix", "/adcp", "/dac")) == counts
    assert {topic: n for topic, (n, _) in said.report.undecodable.items()} == skipped
    assert said.noted(note) == (note != "nothing")


def test_other_units_are_read_or_refused(tmp_path):
    dive = _small_dive() | made.over((), {"ad2cp_cellSize": (4.0, "m")})
    (ping, *_) = read(_write_hdf5(tmp_path / "a.nc", dive)).of("/adcp")
    assert ping["bin0_distance"] == pytest.approx(4.1)
    for wrong in (
        made.over((), {"ad2cp_cellSize": (4.0, "furlong")}),
        made.over("gps", {"log_gps_time": (np.zeros(3), "days since 1970-1-1")}),
    ):
        path = _write_hdf5(tmp_path / "b.nc", dive | wrong)
        with pytest.raises(LogError, match=f"{next(iter(wrong))}: expected units"):
            open_log(path)
