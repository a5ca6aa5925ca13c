from collections import Counter

import h5netcdf
import numpy as np
import pytest
from scipy.io import netcdf_file

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.netcdf.glider_dialects import GLIDERS
from replay_kit.logs.netcdf.variables import open_netcdf
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.places import DATA

WITH_ADCP = sorted((DATA / "seaglider").glob("p17101*.nc"))
WITHOUT_ADCP = sorted((DATA / "seaglider").glob("p24900*.nc"))
real = pytest.mark.skipif(not WITH_ADCP, reason="../shared/data/seaglider is not there")

START = 1_700_000_000.0
_SECONDS = {"units": "seconds since 1970-1-1 00:00:00"}


def _read(path):
    return list(open_log(path).messages())


def _topic(messages, topic):
    return [message for message in messages if message.topic == topic]


def _small_dive():
    """A dive of 20 minutes to 100 m: name to dimensions, values, attributes."""
    time = START + np.arange(0.0, 1201.0, 10.0)
    depth = 100.0 - np.abs(np.linspace(-100.0, 100.0, time.size))
    depth[7] = np.nan
    relative = np.full((3, 4), 0.25)
    relative[1, 2] = np.nan
    profile = np.full((31, 2), 0.125)
    profile[25:] = -999.0
    fill = {"_FillValue": np.float64(-999.0)}
    gps = {
        "log_gps_time": (START + np.array([-300.0, -60.0, 1260.0]), _SECONDS),
        "log_gps_lat": np.array([12.0, 12.001, 12.01]),
        "log_gps_lon": np.array([85.0, 85.001, 85.01]),
        "log_gps_qc": np.array([b"1", b"1", b"1"]),
    }
    ctd = {
        "ctd_time": (time, _SECONDS),
        "ctd_depth": (depth, {"_FillValue": np.float64(np.nan)}),
        "latitude": np.linspace(12.001, 12.01, time.size),
        "longitude": np.linspace(85.001, 85.01, time.size),
    }
    pings = {
        "ad2cp_time": (START + np.array([100.0, 200.0, 300.0]), _SECONDS),
        "ad2cp_temperature": np.array([300.0, 295.0, 290.0]),
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
    inverted = {f"ad2cp_inv_profile_{name}": (profile, fill) for name in ("uocn", "vocn", "wocn")}
    return (
        made.over("gps", gps)
        | made.over("ctd", ctd)
        | made.over("ping", pings)
        | made.over(("ping", "cell"), {f"ad2cp_vel{axis}": (relative, "m/s") for axis in "XYZ"})
        | made.over((), once)
        | made.over("level", {"ad2cp_inv_profile_depth": (np.arange(31) * 5.0, fill)})
        | made.over(("level", "leg"), inverted)
    )


def _write_hdf5(path, variables):
    return made.write(path, variables, {"dive_number": 7})


def _write_classic(path, variables):
    with netcdf_file(path, "w") as file:
        file.dive_number = 7
        for name, (dims, values, attributes) in variables.items():
            values = np.asarray(values)
            for dim, size in zip(dims, values.shape, strict=True):
                if dim not in file.dimensions:
                    file.createDimension(dim, size)
            kind = "c" if values.dtype.kind == "S" else "d"
            variable = file.createVariable(name, kind, dims)
            variable[...] = values
            for key, value in attributes.items():
                setattr(variable, key, value)
    return path


def _assert_as_h5netcdf_reads(path):
    dive = open_netcdf(path, lambda held, _: GLIDERS[0].wanted(held))
    with h5netcdf.File(path, "r") as file:
        assert dive.dive_number == int(file.attrs["dive_number"])
        for name, stored in dive.variables.items():
            np.testing.assert_array_equal(stored.values, file.variables[name][...], strict=True)
            # h5netcdf leaves text of a fixed length as bytes
            texts = {
                key: value.decode() if isinstance(value, bytes) else value
                for key, value in file.variables[name].attrs.items()
            }
            wanted = {
                key: value
                for key, value in texts.items()
                if key in ("units", "_FillValue", "missing_value", "flag_meanings")
            }
            np.testing.assert_equal(
                {key: value for key, value in stored.attributes.items() if key in wanted}, wanted
            )
            assert stored.dims == file.variables[name].dimensions
        prefixes = ("log_gps_time", "log_gps_l", "log_gps_qc", "ad2cp_", "ctd_time", "ctd_depth")
        named = (
            "latitude",
            "longitude",
            "depth_avg_curr_east",
            "depth_avg_curr_error",
            "depth_avg_curr_qc",
            "magnetic_variation",
        )
        assert {
            name for name in file.variables if name.startswith(prefixes) or name in named
        } <= set(dive.variables)


def test_variables_are_those_that_h5netcdf_reads(tmp_path):
    _assert_as_h5netcdf_reads(_write_hdf5(tmp_path / "p0010007.nc", _small_dive()))


def test_velocities_on_other_axes_than_the_earths_are_not_read(tmp_path):
    for system, pings in ((0.0, 3), (1.0, 0)):
        path = _write_hdf5(
            tmp_path / f"{system}.nc", _small_dive() | {"ad2cp_coordinateSystem": ((), system, {})}
        )
        assert len(_topic(_read(path), "/adcp")) == pings
        told = "ADCP: not read, because its velocities are not east, north and up (ad2cp_coordinateSystem)"
        assert (told in open_log(path).report().notes) == (pings == 0)


@real
def test_the_adcp_of_real_dives_is_assumed_to_look_up_as_single_dives_do_not_tell():
    for path in WITH_ADCP:
        log = open_log(path)
        assert {ping.payload["orientation"] for ping in _topic(list(log.messages()), "/adcp")} == {
            "up"
        }
        assert any(note.startswith("ADCP: assumed to look up") for note in log.report().notes)


@real
def test_variables_of_a_real_dive_are_those_that_h5netcdf_reads():
    _assert_as_h5netcdf_reads(WITH_ADCP[0])


@pytest.mark.parametrize("write", [_write_hdf5, _write_classic])
def test_a_small_dive(tmp_path, write):
    reader = open_log(write(tmp_path / "p0010007.nc", _small_dive()), 2)
    assert reader.is_gliders()
    messages = list(reader.messages())
    times = [message.time_ns for message in messages]
    assert times == sorted(times)
    assert [message.position for message in messages] == list(range(len(messages)))
    assert {message.input for message in messages} == {2}
    # 121 samples ten seconds apart, one a minute
    expected = {
        "/vehicle/fix": 3,
        "/vehicle/position": 21,
        "/adcp": 3,
        "/adcp/inverted": 2,
        "/dac": 1,
    }
    assert Counter(message.topic for message in messages) == expected == reader.report().read
    assert reader.report().undecodable == {}
    ping = _topic(messages, "/adcp")[1].payload
    assert (ping["reference"], ping["coordinate_system"], ping["orientation"]) == (
        "platform",
        "earth",
        "up",
    )
    assert (ping["cell_size"], ping["bin0_distance"], ping["n_cells"]) == (2.0, 2.1, 4)
    assert (ping["sound_speed"], ping["temperature"], ping["magnetic_declination"]) == (
        1530.0,
        29.5,
        -1.5,
    )
    assert ping["velocity"] == [[0.25] * 3, [0.25] * 3, [None] * 3, [0.25] * 3]
    down, up = _topic(messages, "/adcp/inverted")
    assert (down.payload["dive"], down.payload["ping"], up.payload["ping"]) == (7, 14, 15)
    assert down.payload["velocity"][24:26] == [[0.125] * 3, [None] * 3]
    assert (down.payload["bin0_distance"], down.payload["cell_size"], down.payload["n_cells"]) == (
        0.0,
        5.0,
        31,
    )
    assert (down.time_ns, up.time_ns) == (round(START + 600) * 10**9, round(START + 1200) * 10**9)
    (dac,) = _topic(messages, "/dac")
    assert (dac.payload["dac_eastward"], dac.payload["dac_northward"], dac.payload["duration"]) == (
        0.1,
        -0.2,
        1320.0,
    )
    assert dac.time_ns == round(START + 1260) * 10**9


def test_profiles_are_observed_at_their_depths(tmp_path):
    messages = _read(_write_hdf5(tmp_path / "a.nc", _small_dive()))
    down, up = observations(messages, MeasurementConfig())
    np.testing.assert_allclose(down.depth, np.arange(31) * 5.0)
    assert np.isfinite(down.velocity).all(axis=1).sum() == 25
    assert (down.dive, up.dive) == (7, 7)
    # the same water is not counted twice: either the profiles, or what they were computed from
    pings = [
        o
        for o in observations(messages, MeasurementConfig(use_inverted=False))
        if o.source.topic != "/dac"
    ]
    assert [(o.source.topic, o.reference) for o in pings] == [("/adcp", "platform")] * 3
    assert down.longitude == pytest.approx(85.0055, abs=1e-4)
    assert up.longitude == pytest.approx(85.01, abs=1e-4)


def test_bad_fixes_are_counted_and_not_given(tmp_path):
    dive = _small_dive()
    dive["log_gps_qc"] = (("gps",), np.array([b"4", b"1", b"9"]), {})
    dive["depth_avg_curr_qc"] = ((), b"4", {})
    reader = open_log(_write_hdf5(tmp_path / "a.nc", dive))
    messages = list(reader.messages())
    assert len(_topic(messages, "/vehicle/fix")) == 1
    assert _topic(messages, "/dac") == []
    assert {topic: count for topic, (count, _) in reader.report().undecodable.items()} == {
        "/vehicle/fix": 2,
        "/dac": 1,
    }


def test_a_dive_without_adcp_or_track_still_has_its_fixes(tmp_path):
    kept = {name: value for name, value in _small_dive().items() if name.startswith("log_gps")}
    assert {message.topic for message in _read(_write_hdf5(tmp_path / "a.nc", kept))} == {
        "/vehicle/fix"
    }


def test_other_units_are_read_or_refused(tmp_path):
    dive = _small_dive()
    dive["ad2cp_cellSize"] = ((), 4.0, {"units": "m"})
    (ping, *_) = _topic(_read(_write_hdf5(tmp_path / "a.nc", dive)), "/adcp")
    assert ping.payload["bin0_distance"] == pytest.approx(4.1)
    dive["ad2cp_cellSize"] = ((), 4.0, {"units": "furlong"})
    with pytest.raises(LogError, match="ad2cp_cellSize: expected units"):
        _read(_write_hdf5(tmp_path / "b.nc", dive))
    dive["log_gps_time"] = (("gps",), np.zeros(3), {"units": "days since 1970-1-1"})
    with pytest.raises(LogError, match="log_gps_time: expected units"):
        _read(_write_hdf5(tmp_path / "c.nc", dive))


@pytest.mark.parametrize("write", [_write_hdf5, _write_classic])
def test_another_netcdf_is_refused(tmp_path, write):
    path = write(tmp_path / "a.nc", {"uo": (("x",), np.zeros(3), {})})
    with pytest.raises(LogError, match="expected a Seaglider basestation file"):
        open_log(path)


@pytest.mark.parametrize("write", [_write_hdf5, _write_classic])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7])
def test_a_cut_file_is_an_error_of_ours(tmp_path, write, share):
    data = write(tmp_path / "a.nc", _small_dive()).read_bytes()
    (tmp_path / "b.nc").write_bytes(data[: int(len(data) * share)])
    with pytest.raises(LogError, match=r"b\.nc"):
        list(open_log(tmp_path / "b.nc").messages())


@real
@pytest.mark.parametrize("path", WITH_ADCP, ids=lambda path: path.stem)
def test_relative_velocities_are_in_earth_coordinates(path):
    """The third component is the vertical speed that pressure gives, whatever the pitch: so the axes are not the instrument's."""
    pings = _topic(_read(path), "/adcp")
    time = np.array([ping.time_ns for ping in pings]) * 1e-9
    pressure = np.array([ping.payload["pressure"] for ping in pings])
    up = np.array(
        [[cell[2] for cell in ping.payload["velocity"][1:6]] for ping in pings], dtype=float
    ).mean(axis=1)
    steady = (pressure > 150.0) & (pressure < 450.0)
    sinking = np.gradient(pressure, time)[steady]
    assert np.corrcoef(up[steady], sinking)[0, 1] > 0.97
    assert np.polyfit(sinking, up[steady], 1)[0] == pytest.approx(1.0, abs=0.08)


@real
@pytest.mark.parametrize("path", WITHOUT_ADCP, ids=lambda path: path.stem)
def test_real_dives_without_adcp(path):
    messages = _read(path)
    topics = {"/vehicle/fix", "/vehicle/position", "/dac", "/ctd"}
    assert {message.topic for message in messages} == topics
    (dac,) = _topic(messages, "/dac")
    assert np.hypot(dac.payload["dac_eastward"], dac.payload["dac_northward"]) < 0.2
    assert dac.payload["error"] < 0.02
