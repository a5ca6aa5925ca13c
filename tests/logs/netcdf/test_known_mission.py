"""One known mission in the form of each dialect, and as writers vary them: the fixes and the field that were written come back."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, PathMean
from replay_kit.logs import open_logs
from replay_kit.logs.netcdf.adcp import _BEAMS
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read

Change = Callable[[dict[str, Any]], dict[str, Any]]
VELOCITY = np.array([0.3, -0.1, 0.05])


class Form(NamedTuple):
    """A form of the mission: its format, its writer, and what changes its variables.

    Attributes:
        fixes: Whether it holds the four fixes.
        inside: Seconds by which the ends of a dive are its first and last sample.
        numbered: Whether the dives have numbers.
        deepest: Of each dive [m].
        notes: Parts of what is noted.
    """

    format: str
    write: Callable[[Path], Path | list[Path]]
    change: Change | None = None
    fixes: bool = True
    inside: float = 0.0
    numbered: bool = False
    deepest: tuple[float, float] = (100.0, 100.0)
    notes: tuple[str, ...] = ()

    def written(self, path: Path) -> Path | list[Path]:
        return self.write(path) if self.change is None else changed(self.write, self.change, path)


def changed(write, change, path):
    """Write a form with its variables changed."""
    plain = made.write
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            made,
            "write",
            lambda at, variables, *rest, **named: plain(
                at, change(dict(variables)), *rest, **named
            ),
        )
        return write(path)


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
    packing = {"scale_factor": 10.0, "add_offset": made.START, "_FillValue": np.int32(-1)}
    stored = np.round((time - made.START) / 10.0).astype(np.int32)
    variables["TIME"] = (dims, stored, made.EPOCH | packing)
    missing = np.int32(-(2**31))
    for name in ("LONGITUDE_GPS", "LATITUDE_GPS"):
        _, degrees, attributes = variables[name]
        whole = np.where(np.isfinite(degrees), np.round(np.nan_to_num(degrees) * 1e6), missing)
        packing = {"scale_factor": 1e-6, "_FillValue": missing}
        variables[name] = (dims, whole.astype(np.int32), attributes | packing)
    del variables["TIME_GPS"]
    return variables


def _time(units, begin, seconds, kind):
    def change(variables):
        dims, time, _ = variables["time"]
        since = (time - np.datetime64(begin, "s").astype(np.int64)) / seconds
        values = np.round(since).astype(kind) if kind.startswith("i") else since
        return variables | {"time": (dims, values, {"units": units} if units else {})}

    return change


def _text(characters):
    def change(variables):
        dims, time, _ = variables["time"]
        texts = np.array([str(np.datetime64(round(t), "s")) + "Z" for t in time], "S20")
        letters = (*dims, "n_char"), texts.view("S1").reshape(len(texts), 20), {}
        return variables | {"time": letters if characters else (dims, texts, {})}

    return change


def _decimal(variables):
    whole, fix = made._with_fixes(made.samples())
    for part, name in (("lon", "longitude"), ("lat", "latitude")):
        variables[f"m_{part}"] = (("i",), whole[name], {})
        variables[f"m_gps_{part}"] = (("i",), np.where(fix, whole[name], 69_696_969.0), {})
    return variables


def _as_pyglider(variables):
    del variables["dead_reckoning"]
    return variables | {"profile_index": (("time",), np.repeat([0.0, 1.0], 61), {})}


def _texts(variables):
    """Latitudes as texts, one of which is no number."""
    dims, values, attributes = variables["latitude"]
    texts = np.array([f"{value:.6f}" for value in values], "S12")
    texts[1] = b"none"
    return variables | {"latitude": (dims, texts, attributes)}


def _ragged(path):
    """ERDDAP's rows as a ragged array, in which a profile's own are stated once."""
    track, middle = made.samples(), made.middles()
    means = np.array([made.mean(0), made.mean(1)])
    each = {"profile_id": np.array([0, 1]), "u": means[:, 0], "v": means[:, 1]}
    for names in (("time", "longitude", "latitude"), ("time_uv", "lon_uv", "lat_uv")):
        each |= dict(zip(names, middle.T, strict=True))
    names = {"time": "precise_time", "longitude": "precise_lon", "latitude": "precise_lat"}
    rows = {names.get(name, name): track[name] for name in (*names, "depth")}
    variables: made.Variables = {
        name: ((dim,), values, made.EPOCH if "time" in name else {})
        for dim, columns in (("profile", each), ("obs", rows))
        for name, values in columns.items()
    }
    variables["rowSize"] = (("profile",), np.array([59, 59], np.int32), {"sample_dimension": "obs"})
    return made.write(path, variables)


_IN = {"fixes": False, "inside": 60.0, "numbered": True}
DIALECTS = {
    "spray": Form("spray", made.spray, fixes=False, numbered=True, deepest=(100.0, 90.0)),
    "gliderdac": Form(
        "gliderdac",
        made.gliderdac,
        notes=("IOOS GliderDAC: 4 files are one log", "2 in 118 values, each counted once"),
        **_IN,
    ),
    "erddap": Form("erddap", made.erddap, **_IN),
    "bodc": Form(
        "og1",
        made.bodc,
        notes=(
            "WATERCURRENTS_U, WATERCURRENTS_V: converted from cm/s to m/s",
            "DEPTH_Z: has the standard name depth but is positive up; not used",
        ),
    ),
    "socib": Form(
        "socib",
        made.socib,
        notes=(
            "depth: positive up (by its negative values), sign reversed",
            "heading: no value above 1.50, so taken as radians although its unit is degrees",
        ),
    ),
    "slocum-glide": Form("slocum-glide", made.slocum_glide, numbered=True),
    "slocum": Form(
        "slocum",
        made.slocum,
        notes=(
            "m_lon, m_lat, m_gps_lon, m_gps_lat: degrees and minutes (ddmm.mmm) converted",
            "m_heading: converted from rad to degrees",
            "m_gps_lat: 118 values outside -90..90 degrees taken as missing",
            "mean current: 1 of exactly (0, 0) taken as missing",
        ),
    ),
}
_DAYS = "days since 2023-01-01", "2023-01-01", 86400.0, "f8"
_WHOLE = "seconds since 2023-01-01 00:00:00 UTC", "2023-01-01", 1.0, "i4"
_NANO = "nanoseconds since 1970-01-01", "1970-01-01", 1e-9, "i8"
VARIANTS = {
    "lower case": Form("og1", made.bodc, _lower),
    "packed": Form("og1", made.bodc, _packed),
    "days": Form("socib", made.socib, _time(*_DAYS)),
    "whole seconds": Form("socib", made.socib, _time(*_WHOLE)),
    "nanoseconds": Form("socib", made.socib, _time(*_NANO)),
    "no epoch": Form("socib", made.socib, _time("", "1970-01-01", 1.0, "f8")),
    "characters": Form("socib", made.socib, _text(True)),
    "texts": Form("socib", made.socib, _text(False)),
    "numbers in texts": Form("socib", made.socib, _texts),
    "decimal degrees": Form("slocum", made.slocum, _decimal),
    # a report at the surface is of the dive between samples at the surface
    "no fixes": Form(
        "pyglider",
        made.socib,
        _as_pyglider,
        fixes=False,
        notes=("4 of 4 ends are not fixes of the file",),
    ),
    "ragged": Form(
        "erddap", _ragged, notes=("2 profiles of 118 samples: values stated once",), **_IN
    ),
}


@pytest.mark.parametrize("form", [*DIALECTS, *VARIANTS])
def test_fixes_mean_currents_and_their_ends_come_back(tmp_path, form):
    row = (DIALECTS | VARIANTS)[form]
    said = read(row.written(tmp_path / "a.nc"))
    assert (said.report.format, said.report.undecodable) == (row.format, {})
    for dive, mean in enumerate(said.of("/dac")):
        known = (mean["dac_eastward"], mean["dac_northward"])
        assert known == pytest.approx(made.mean(dive), abs=1e-12)
        before, after = made.FIXES[2 * dive : 2 * dive + 2]
        step = np.array([1.0, *((after - before)[1:] / made.DIVE)]) * row.inside
        for end, place in (("start_fix", before + step), ("end_fix", after - step)):
            fix = mean[end]
            found = fix["time"]["sec"] - made.START, fix["lon"], fix["lat"]
            assert found == pytest.approx(tuple(place), abs=1e-6)
        assert mean["duration"] == pytest.approx(made.DIVE - 2 * row.inside)
        # where samples come to the surface, their depths number the dives
        assert mean.get("dive") == (dive + 1 if row.numbered else None)
        assert mean["max_depth"] == pytest.approx(row.deepest[dive], abs=1e-9)
    assert dive == 1
    fixes = [(m.time_ns, m.payload) for m in said.messages if m.topic == "/vehicle/fix"]
    assert len(fixes) == 4 * row.fixes
    for (time_ns, fix), (seconds, *place) in zip(fixes, made.FIXES, strict=False):
        assert time_ns == round(made.START + seconds) * 10**9
        assert (fix["longitude"], fix["latitude"]) == pytest.approx(tuple(place), abs=1e-6)
    for words in row.notes:
        assert said.noted(words)
    # and each is observed along its dive
    found = observations(said.messages, MeasurementConfig(use_inverted=False))
    means = [event for event in found if isinstance(event, PathMean)]
    for dive, mean in enumerate(means):
        assert float(mean.weight @ mean.depth) == pytest.approx(row.deepest[dive] / 2, abs=2.0)
        west, east = made.FIXES[2 * dive : 2 * dive + 2, 1] + [-1e-6, 1e-6]
        assert west <= mean.longitude.min() <= mean.longitude.max() <= east
    assert len(means) == 2


@pytest.mark.parametrize("form", ["socib", "slocum"])
def test_headings_come_back_in_degrees(tmp_path, form):
    position = read(DIALECTS[form].written(tmp_path / "a.nc")).of("/vehicle/position")[0]
    metadata = {item["key"]: item["value"] for item in position["metadata"]}
    assert metadata["heading"] == f"{np.rad2deg(1.5):.2f}"
    assert float(metadata["depth"]) == pytest.approx(100.0 / 30.0, abs=1e-3)


def test_latitudes_near_the_equator_are_degrees_and_minutes_where_the_longitudes_are(tmp_path):
    def south(variables):
        for name in ("m_gps_lat", "m_lat"):
            dims, values, attributes = variables[name]
            moved = np.where(values < 1e6, values - 4000.0, values)
            variables[name] = (dims, moved, attributes)
        return variables

    found = read(changed(made.slocum, south, tmp_path / "a.nc")).of("/vehicle/fix")
    expected = (made.FIXES[:, 2] - 40.0).tolist()
    assert [fix["latitude"] for fix in found] == pytest.approx(expected, abs=1e-7)


def test_ends_that_follow_from_the_middle_of_a_dive_cross_the_antimeridian(tmp_path):
    def change(variables):
        for name in ("lon", "lon_uv"):
            dims, values, attributes = variables[name]
            # the first dive from 179.997 E to 179.993 W, its middle west of the antimeridian's other side
            moved = np.asarray(values) + 209.997
            variables[name] = (dims, np.where(moved > 180.0, moved - 360.0, moved), attributes)
        return variables

    first = read(changed(made.spray, change, tmp_path / "a.nc")).of("/dac")[0]
    ends = [first[end]["lon"] for end in ("start_fix", "end_fix")]
    assert [end % 360.0 for end in ends] == pytest.approx([179.997, 180.007], abs=1e-9)
    assert all(-180.0 <= end <= 360.0 for end in ends)


def test_a_folder_and_the_files_in_any_order_are_the_same_log(tmp_path):
    folder = tmp_path / "profiles"
    files = made.gliderdac(folder)
    by_name = read(sorted(files)).messages
    assert by_name == read(files[::-1]).messages == read(folder).messages
    assert len(open_logs([*files, made.erddap(tmp_path / "a.nc")])) == 2
    # each file alone has the mean current of its dive, between its own first and last sample
    assert [mean["duration"] for mean in read(files[0]).of("/dac")] == [1740.0]


def test_values_flagged_bad_are_not_used(tmp_path):
    first, *_ = made.gliderdac(tmp_path / "profiles")
    with h5py.File(first, "r+") as file:
        file["u_qc"][...] = 4
    said = read(first)
    assert not said.of("/dac")
    assert said.report.undecodable == {"/dac": (1, "mean current flagged bad (u_qc)")}
    assert said.noted("u_qc: 1 x 4 (bad_data), not used")


def test_the_parts_of_a_seaexplorer_come_back_with_their_fixes(tmp_path):
    parts = made.seaexplorer(tmp_path / "raw")
    said = read(tmp_path / "raw")
    # every five minutes; two dives of eleven samples, and the fixes
    assert said.counts() == {"/vehicle/fix": 4, "/vehicle/position": 22}
    for fix, (seconds, *place) in zip(said.of("/vehicle/fix"), made.FIXES, strict=True):
        assert fix["timestamp"]["sec"] == round(made.START + seconds)
        assert (fix["longitude"], fix["latitude"]) == pytest.approx(tuple(place), abs=1e-6)
    for words in (
        "Declination: declination 17 degrees",
        "Timestamp: 1 values without a time, excluded",
        # cut off at its end
        "1 line with fewer or more columns than the heading, not used",
    ):
        assert said.noted(words)
    for path in parts:
        heading, *lines = path.read_text().split("\n")
        rows = [line + "1.2;" for line in lines if line.count(";") > 2]
        path.write_text("\n".join([heading + "Roll;", *rows]))
    # small tilts of a raw format are in its unit
    said = read(tmp_path / "raw")
    words = [{d["key"]: d["value"] for d in p["metadata"]} for p in said.of("/vehicle/position")]
    assert {one["roll"] for one in words} == {"1.20"}
    assert not said.noted("taken as radians")


def test_absolute_profiles_of_spray_come_back_with_depth_first(tmp_path):
    messages = read(made.spray(tmp_path / "a.nc")).messages
    found = list(observations(messages, MeasurementConfig()))
    # the same water does not count twice
    assert [type(profile) for profile in found] == [Observation] * 2
    assert [profile.dive for profile in found] == [1, 2]
    for dive, profile in enumerate(found):
        field = np.column_stack(made.current(made.DEPTHS, dive))
        field[made.DEPTHS.size - dive :] = np.nan
        np.testing.assert_allclose(profile.depth, made.DEPTHS)
        np.testing.assert_allclose(profile.velocity, field, atol=5.1e-5)
        seconds, *place = made.middles()[dive]
        assert (profile.reference, profile.time_ns) == ("earth", round(seconds) * 10**9)
        assert (profile.longitude, profile.latitude) == pytest.approx(tuple(place), abs=1e-9)


def test_velocities_of_a_midas_export_come_back_on_true_axes(tmp_path):
    export = made.midas(tmp_path / "sea063_M22.ad2cp.nc", VELOCITY, _BEAMS)
    said = read(export)
    assert said.report.format == "midas"
    assert said.noted("looks up by its accelerometer")
    track = [m for m in read(made.bodc(tmp_path / "track.nc")).messages if m.topic != "/dac"]
    messages = sorted([*track, *said.messages], key=lambda message: message.time_ns)
    pings = list(observations(messages, MeasurementConfig(magnetic_declination=5.0)))
    assert [ping.reference for ping in pings] == ["platform", "platform"]
    for ping, heading in zip(pings, (35.0, 45.0), strict=True):
        # x points along the heading, y to its left, for an instrument that looks up
        turned = (VELOCITY[0] + 1j * VELOCITY[1]) * np.exp(1j * np.deg2rad(90.0 - heading))
        np.testing.assert_allclose(ping.velocity, [[turned.real, turned.imag]] * 5, atol=1e-5)
    # up from 33 dbar
    np.testing.assert_allclose(pings[0].depth, 32.7 - np.arange(2.0, 12.0, 2.0), atol=0.2)


def test_times_of_fixes_that_are_all_fill_do_not_cost_the_file(tmp_path):
    path = made.bodc(tmp_path / "a.nc")
    for change, seconds in (
        # the rows' own times stand for them
        ((slice(None), -1.0), made.FIXES[:, 0].tolist()),
        ((0, made.START + 5.0), [5.0, *made.FIXES[1:, 0]]),
    ):
        with h5py.File(path, "r+") as file:
            file["TIME_GPS"][change[0]] = change[1]
        said = read(path)
        assert [fix["timestamp"]["sec"] - made.START for fix in said.of("/vehicle/fix")] == seconds
        assert said.noted("TIME_GPS: holds no plausible times") == (change[1] < 0.0)
