"""Variants of gliders' files as their writers make them: each gives the messages of the file that it was changed from."""

from typing import Any

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from tests.logs.netcdf import glider_samples as made


def _changed(path, write, change, monkeypatch):
    """Write a sample with its variables changed."""
    plain = made.write
    with monkeypatch.context() as patch:
        patch.setattr(
            made,
            "write",
            lambda at, variables, *rest, **named: plain(
                at, change(dict(variables)), *rest, **named
            ),
        )
        return write(path)


def _values(messages):
    """Return what fixes and mean currents say, as numbers."""
    found: list[Any] = []
    for message in messages:
        payload = message.payload
        if message.topic == "/dac":
            ends = [
                payload[end][name] for end in ("start_fix", "end_fix") for name in ("lon", "lat")
            ]
            found.append(
                (
                    message.time_ns,
                    payload["dac_eastward"],
                    payload["dac_northward"],
                    payload["duration"],
                    *ends,
                )
            )
        elif message.topic == "/vehicle/fix":
            found.append((message.time_ns, payload["longitude"], payload["latitude"]))
    return found


def _lower(variables):
    """Names and dimensions in lower case, and the mean current at the fixes as well."""
    dive = np.repeat([0, 1], 61)
    for k, name in enumerate(("WATERCURRENTS_U", "WATERCURRENTS_V")):
        dims, _, attributes = variables[name]
        variables[name] = (dims, 100.0 * np.array([made.mean(d)[k] for d in dive]), attributes)
    return {
        name.lower(): (tuple(d.lower() for d in dims), values, attrs)
        for name, (dims, values, attrs) in variables.items()
    }


def _packed(variables):
    dims, time, _ = variables["TIME"]
    stored = np.round((time - made.START) / 10.0).astype(np.int32)
    variables["TIME"] = (
        dims,
        stored,
        made.EPOCH | {"scale_factor": 10.0, "add_offset": made.START, "_FillValue": np.int32(-1)},
    )
    for name in ("LONGITUDE_GPS", "LATITUDE_GPS"):
        _, degrees, attributes = variables[name]
        missing = np.int32(-(2**31))
        whole = np.where(
            np.isfinite(degrees), np.round(np.nan_to_num(degrees) * 1e6), missing
        ).astype(np.int32)
        variables[name] = (dims, whole, attributes | {"scale_factor": 1e-6, "_FillValue": missing})
    del variables["TIME_GPS"]
    return variables


def _time(units, begin, seconds, kind):
    def change(variables):
        dims, time, _ = variables["time"]
        since = (time - np.datetime64(begin, "s").astype(np.int64)) / seconds
        variables["time"] = (
            dims,
            np.round(since).astype(kind) if kind.startswith("i") else since,
            {"units": units} if units else {},
        )
        return variables

    return change


def _text(kind):
    def change(variables):
        dims, time, _ = variables["time"]
        texts = np.array([str(np.datetime64(round(t), "s")) + "Z" for t in time], "S20")
        characters = (*dims, "n_char"), texts.view("S1").reshape(len(texts), 20), {}
        variables["time"] = characters if kind == "characters" else (dims, texts, {})
        return variables

    return change


def _decimal(variables):
    whole, fix = made._with_fixes(made.samples())
    for part in ("lon", "lat"):
        degrees = whole[{"lon": "longitude", "lat": "latitude"}[part]]
        variables[f"m_{part}"] = (("i",), degrees, {})
        variables[f"m_gps_{part}"] = (("i",), np.where(fix, degrees, 69_696_969.0), {})
    return variables


@pytest.mark.parametrize(
    ("write", "change"),
    [
        pytest.param(made.bodc, _lower, id="lower case"),
        pytest.param(made.bodc, _packed, id="packed"),
        pytest.param(
            made.socib, _time("days since 2023-01-01", "2023-01-01", 86400.0, "f8"), id="days"
        ),
        pytest.param(
            made.socib,
            _time("seconds since 2023-01-01 00:00:00 UTC", "2023-01-01", 1.0, "i4"),
            id="whole seconds",
        ),
        pytest.param(
            made.socib,
            _time("nanoseconds since 1970-01-01", "1970-01-01", 1e-9, "i8"),
            id="nanoseconds",
        ),
        pytest.param(made.socib, _time("", "1970-01-01", 1.0, "f8"), id="no epoch"),
        pytest.param(made.socib, _text("characters"), id="characters"),
        pytest.param(made.socib, _text("texts"), id="texts"),
        pytest.param(made.slocum, _decimal, id="decimal degrees"),
    ],
)
def test_a_variant_gives_the_same_fixes_and_mean_currents(tmp_path, monkeypatch, write, change):
    plain = _values(list(open_log(write(tmp_path / "plain.nc")).messages()))
    log = open_log(_changed(tmp_path / "changed.nc", write, change, monkeypatch))
    found = _values(list(log.messages()))
    assert len(found) == len(plain) == 6
    for ours, theirs in zip(found, plain, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-6)
    assert log.report().undecodable == {}


def test_latitudes_near_the_equator_are_degrees_and_minutes_where_the_longitudes_are(
    tmp_path, monkeypatch
):
    def south(variables):
        dims, values, attributes = variables["m_gps_lat"]
        variables["m_gps_lat"] = (dims, np.where(values < 1e6, values - 4000.0, values), attributes)
        dims, values, attributes = variables["m_lat"]
        variables["m_lat"] = (dims, values - 4000.0, attributes)
        return variables

    log = open_log(_changed(tmp_path / "a.nc", made.slocum, south, monkeypatch))
    fixes = [
        message.payload["latitude"] for message in log.messages() if message.topic == "/vehicle/fix"
    ]
    assert fixes == pytest.approx((made.FIXES[:, 2] - 40.0).tolist(), abs=1e-7)


def test_without_fixes_a_report_at_the_surface_is_of_the_dive_between_samples_at_the_surface(
    tmp_path, monkeypatch
):
    def change(variables):
        del variables["dead_reckoning"]
        return variables | {"profile_index": (("time",), np.repeat([0.0, 1.0], 61), {})}

    plain = _values(list(open_log(made.socib(tmp_path / "plain.nc")).messages()))
    log = open_log(_changed(tmp_path / "a.nc", made.socib, change, monkeypatch))
    found = _values(list(log.messages()))
    assert log.report().format == "pyglider"
    assert found == [values for values in plain if len(values) > 3]
    assert any("4 of 4 ends are not fixes of the file" in note for note in log.report().notes)


def test_a_ragged_array_states_a_profile_once(tmp_path):
    track, middle = made.samples(), made.middles()
    each = {
        "time": middle[:, 0],
        "longitude": middle[:, 1],
        "latitude": middle[:, 2],
        "profile_id": np.array([0, 1]),
    }
    each |= {"time_uv": middle[:, 0], "lon_uv": middle[:, 1], "lat_uv": middle[:, 2]}
    each |= {
        "u": np.array([made.mean(0)[0], made.mean(1)[0]]),
        "v": np.array([made.mean(0)[1], made.mean(1)[1]]),
    }
    rows = {
        "precise_time": track["time"],
        "precise_lon": track["longitude"],
        "precise_lat": track["latitude"],
        "depth": track["depth"],
    }
    variables: made.Variables = {
        name: ((dim,), values, made.EPOCH if "time" in name else {})
        for dim, columns in (("profile", each), ("obs", rows))
        for name, values in columns.items()
    }
    variables["rowSize"] = (("profile",), np.array([59, 59], np.int32), {"sample_dimension": "obs"})
    ragged = open_log(made.write(tmp_path / "ragged.nc", variables))
    assert _values(list(ragged.messages())) == _values(
        list(open_log(made.erddap(tmp_path / "rows.nc")).messages())
    )
    assert (
        "2 profiles of 118 samples: values stated once for each are repeated at its samples"
        in ragged.report().notes
    )


def test_ends_that_follow_from_the_middle_of_a_dive_cross_the_antimeridian(tmp_path, monkeypatch):
    def change(variables):
        for name in ("lon", "lon_uv"):
            dims, values, attributes = variables[name]
            # the first dive from 179.997 E to 179.993 W, its middle west of the antimeridian's other side
            moved = np.asarray(values) + 209.997
            variables[name] = (dims, np.where(moved > 180.0, moved - 360.0, moved), attributes)
        return variables

    log = open_log(_changed(tmp_path / "a.nc", made.spray, change, monkeypatch))
    first = next(message.payload for message in log.messages() if message.topic == "/dac")
    assert first["start_fix"]["lon"] % 360.0 == pytest.approx(179.997, abs=1e-9)
    assert first["end_fix"]["lon"] % 360.0 == pytest.approx(180.007, abs=1e-9)
    assert all(-180.0 <= first[end]["lon"] <= 360.0 for end in ("start_fix", "end_fix"))


def test_a_file_without_times_says_which_it_lacks(tmp_path):
    path = made.write(
        tmp_path / "a.nc", {"LATITUDE": (("N",), np.zeros(3), {})}, {"Conventions": "OG-1.0"}
    )
    with pytest.raises(
        LogError,
        match=r"OceanGliders OG1: expected a variable time with the times of the samples, got .*LATITUDE",
    ):
        open_log(path)


def test_numbers_that_are_texts_are_read_and_other_texts_are_missing(tmp_path, monkeypatch):
    def change(variables):
        dims, values, attributes = variables["latitude"]
        texts = np.array([f"{value:.6f}" for value in values], "S12")
        texts[1] = b"none"
        return variables | {"latitude": (dims, texts, attributes)}

    log = open_log(_changed(tmp_path / "a.nc", made.socib, change, monkeypatch))
    messages = list(log.messages())
    assert [
        message.payload["latitude"] for message in messages if message.topic == "/vehicle/fix"
    ] == [40.0, 40.01, 40.011, 40.021]
    assert sum(message.topic == "/vehicle/position" for message in messages) == 117
