"""One known mission in the form of each dialect, and as writers vary them: the fixes and the field that were written come back."""

import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import Observation, PathMean
from replay_kit.logs import open_log, open_logs
from replay_kit.measurements import observations
from tests import synthetic
from tests.command import run_command
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read
from tests.logs.slocum import slocum_samples as slocum


class Form(NamedTuple):
    """A form of the mission: its format, its writer, and what changes its variables.

    Attributes:
        fixes: Whether it holds the four fixes.
        inside: Seconds by which the ends of a dive are its first and last sample.
        numbered: Whether the dives have numbers.
        deepest: Of the second dive [m].
        exact: How near its mean currents are [m/s].
        lost: Fixes without a place, which are counted.
        notes: Parts of what is noted.
    """

    format: str
    write: Callable[[Path], Path | list[Path]]
    change: Callable[[dict[str, Any]], dict[str, Any]] = dict
    fixes: bool = True
    inside: float = 0.0
    numbered: bool = False
    deepest: float = 100.0
    exact: float = 1e-12
    lost: int = 0
    notes: tuple[str, ...] = ()

    def written(self, path: Path) -> Path | list[Path]:
        return changed(self.write, self.change, path)


def changed(write, change, path):
    """Write a form with its variables changed."""
    plain = made.write
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            made, "write", lambda at, held, *rest, **k: plain(at, change(held), *rest, **k)
        )
        return write(path)


def _lower(variables):
    return {
        name.lower(): (tuple(map(str.lower, dims)), *held)
        for name, (dims, *held) in variables.items()
    }


def _packed(variables):
    missing = np.int32(-(2**31))
    for name, scale, offset in (
        ("TIME", 10.0, made.START),
        ("LONGITUDE_GPS", 1e-6, 0.0),
        ("LATITUDE_GPS", 1e-6, 0.0),
    ):
        dims, values, attributes = variables[name]
        whole = np.nan_to_num(np.round((values - offset) / scale), nan=missing).astype(np.int32)
        packing = {"scale_factor": scale, "add_offset": offset, "_FillValue": missing}
        variables[name] = dims, whole, attributes | packing
    del variables["TIME_GPS"]
    return variables


def _characters(variables):
    dims, time, _ = variables["time"]
    texts = np.array([f"{np.datetime64(round(t), 's')}Z" for t in time], "S20")
    return variables | {"time": ((*dims, "n_char"), texts.view("S1").reshape(-1, 20), {})}


def _as_pyglider(variables):
    del variables["dead_reckoning"]
    return variables | {"profile_index": (("time",), np.repeat([0.0, 1.0], 61), {})}


def _texts(variables):
    """Latitudes as texts, one of which is no number."""
    dims, values, attributes = variables["latitude"]
    texts = np.array([f"{value:.6f}" for value in values], "S12")
    texts[1] = b"none"
    return variables | {"latitude": (dims, texts, attributes)}


def _ego(path):
    with h5py.File(made.bodc(path), "a") as file:
        file.attrs["Conventions"] = "CF-1.4 EGO-1.2"
        file["PHASE"] = file["PHASE_NUMBER"] = np.zeros(file["TIME"].size)
    return path


def _plain_slocum(path):
    return made.slocum(path, np.asarray)


_IN = {"fixes": False, "inside": 60.0, "numbered": True}
DIALECTS = {
    "spray": Form("spray", made.spray, fixes=False, numbered=True, deepest=90.0),
    "gliderdac": Form(
        "gliderdac",
        made.gliderdac,
        notes=("IOOS GliderDAC: 4 files are one log", "2 in 118 values, each counted once"),
        **_IN,
    ),
    "erddap": Form("erddap", made.erddap, **_IN),
    "bodc": Form(
        "og1", made.bodc, notes=("WATERCURRENTS_U, WATERCURRENTS_V: converted from cm/s to m/s",)
    ),
    "socib": Form(
        "socib",
        made.socib,
        notes=(
            "depth: positive up (by its negative values), sign reversed",
            "heading: no value above 1.50: taken as radians, although its unit is degrees",
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


def _binary(**form):
    def write(path):
        return slocum.mission(path, **form)[0].parent

    return Form("slocum-binary", write, exact=1e-7, lost=2)


_STATED_ONCE = "2 profiles of 118 samples: values stated once"
VARIANTS = {
    "lower case": Form("og1", made.bodc, _lower),
    "packed": Form("og1", made.bodc, _packed),
    "EGO": Form("og1", _ego),
    "characters": Form("socib", made.socib, _characters),
    "numbers in texts": Form("socib", made.socib, _texts),
    "decimal degrees": Form("slocum", _plain_slocum),
    # a report at the surface is of the dive between samples at the surface
    "no fixes": Form(
        "pyglider",
        made.socib,
        _as_pyglider,
        fixes=False,
        notes=("4 of 4 ends are not fixes of the file",),
    ),
    "binary": _binary(),
    "caches": _binary(crc=True),
    "compressed": _binary(crc=True, compress=True),
    "ragged": Form("erddap", made.ragged, notes=(_STATED_ONCE,), **_IN),
}


@pytest.mark.parametrize("form", [*DIALECTS, *VARIANTS])
def test_fixes_mean_currents_and_their_ends_come_back(tmp_path, form):
    row = (DIALECTS | VARIANTS)[form]
    said = read(row.written(tmp_path / "a.nc"))
    assert (said.report.format, said.report.losses) == (row.format, ())
    lost = {"/vehicle/fix": (row.lost, "GPS fix without time or position")}
    assert said.report.undecodable == (lost if row.lost else {})
    assert len(said.of("/dac")) == 2
    for dive, mean in enumerate(said.of("/dac")):
        known = (mean["dac_eastward"], mean["dac_northward"])
        assert known == pytest.approx(made.mean(dive), abs=row.exact)
        before, after = made.FIXES[2 * dive : 2 * dive + 2]
        step = np.array([1.0, *((after - before)[1:] / made.DIVE)]) * row.inside
        for end, place in (("start_fix", before + step), ("end_fix", after - step)):
            found = mean[end]["time"]["sec"] - made.START, mean[end]["lon"], mean[end]["lat"]
            assert found == pytest.approx(tuple(place), abs=1e-6)
        assert mean["duration"] == pytest.approx(made.DIVE - 2 * row.inside)
        # where samples come to the surface, their depths number the dives
        assert mean.get("dive") == (dive + 1 if row.numbered else None)
        assert mean["max_depth"] == pytest.approx((100.0, row.deepest)[dive], abs=1e3 * row.exact)
    assert said.fixes() == pytest.approx(made.PLACES[: 4 * row.fixes], abs=1e-6)
    for words in row.notes:
        assert said.noted(words)
    # and each is observed along its dive
    found = observations(said.messages, MeasurementConfig(use_inverted=False))
    means = [event for event in found if isinstance(event, PathMean)]
    for dive, mean in enumerate(means):
        depth = (100.0, row.deepest)[dive]
        assert float(mean.weight @ mean.depth) == pytest.approx(depth / 2, abs=2.0)
        west, east = made.FIXES[2 * dive : 2 * dive + 2, 1] + [-1e-6, 1e-6]
        assert west <= mean.longitude.min() <= mean.longitude.max() <= east
    assert len(means) == 2
    if "heading" in " ".join(row.notes):
        position = said.of("/vehicle/position")[0]
        words = {item["key"]: item["value"] for item in position["metadata"]}
        assert words["heading"] == f"{np.rad2deg(1.5):.2f}"
        assert float(words["depth"]) == pytest.approx(100.0 / 30.0, abs=1e-3)


def _moved(names, change):
    """Return a change of variables that moves the values of some."""

    def moved(variables):
        for name in names:
            dims, values, attributes = variables[name]
            variables[name] = dims, change(np.asarray(values)), attributes
        return variables

    return moved


def test_ends_that_follow_from_the_middle_of_a_dive_cross_the_antimeridian(tmp_path):
    # the first dive from 179.997 E to 179.993 W, its middle west of the antimeridian's other side
    east = _moved(("lon", "lon_uv"), lambda v: (v + 209.997 + 180.0) % 360.0 - 180.0)
    first = read(changed(made.spray, east, tmp_path / "a.nc")).of("/dac")[0]
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
    with h5py.File(files[0], "r+") as file:
        file["u_qc"][...] = 4
    said = read(files[0])
    assert not said.of("/dac")
    assert said.report.undecodable == {"/dac": (1, "mean current flagged bad (u_qc)")}
    assert said.noted("u_qc: 1 x 4 (bad_data), not used")


def test_the_parts_of_a_seaexplorer_come_back_with_their_fixes(tmp_path):
    parts = made.seaexplorer(tmp_path / "raw")
    said = read(tmp_path / "raw")
    # every five minutes; two dives of eleven samples, and the fixes
    assert said.counts() == {"/vehicle/fix": 4, "/vehicle/position": 22}
    assert said.fixes() == pytest.approx(made.PLACES, abs=1e-6)
    for words in (
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
    # compressed, and then cut, or with one bit of its checksum changed
    data = bytearray(gzip.compress(parts[0].read_bytes(), mtime=0))
    path = tmp_path / "sea063.22.gli.sub.9.gz"
    path.write_bytes(data)
    assert len(read(path).messages) == 13
    data[-6] ^= 1
    for damaged in (data[: len(data) // 2], data):
        path.write_bytes(damaged)
        with pytest.raises(LogError, match="is the file complete"):
            open_log(path)


def test_absolute_profiles_of_spray_come_back_with_depth_first(tmp_path):
    messages = read(made.spray(tmp_path / "a.nc")).messages
    found = list(observations(messages, MeasurementConfig()))
    # the same water does not count twice
    assert [type(profile) for profile in found] == [Observation] * 2
    for dive, profile in enumerate(found):
        field = np.column_stack(made.current(made.DEPTHS, dive))
        field[made.DEPTHS.size - dive :] = np.nan
        np.testing.assert_allclose(profile.depth, made.DEPTHS)
        np.testing.assert_allclose(profile.velocity, field, atol=5.1e-5)
        seconds, *place = made.middles()[dive]
        known = profile.dive, profile.reference, profile.time_ns
        assert known == (dive + 1, "earth", round(seconds) * 10**9)
        assert (profile.longitude, profile.latitude) == pytest.approx(tuple(place), abs=1e-9)


def test_velocities_of_a_midas_export_come_back_on_true_axes(tmp_path):
    said = read(made.midas(tmp_path / "sea063_M22.ad2cp.nc"))
    assert said.report.format == "midas"
    assert said.noted("looks up by its accelerometer")
    track = [m for m in read(made.bodc(tmp_path / "track.nc")).messages if m.topic != "/dac"]
    messages = sorted([*track, *said.messages], key=lambda message: message.time_ns)
    pings = list(observations(messages, MeasurementConfig(magnetic_declination=5.0)))
    assert [ping.reference for ping in pings] == ["platform", "platform"]
    for ping, heading in zip(pings, (35.0, 45.0), strict=True):
        # x points along the heading, y to its left, for an instrument that looks up
        turned = (made.SEEN[0] + 1j * made.SEEN[1]) * np.exp(1j * np.deg2rad(90.0 - heading))
        np.testing.assert_allclose(ping.velocity, [[turned.real, turned.imag]] * 5, atol=1e-5)
    # up from 33 dbar
    np.testing.assert_allclose(pings[0].depth, 32.7 - np.arange(2.0, 12.0, 2.0), atol=0.2)


TO = ("eastward_sea_water_velocity", "northward_sea_water_velocity")


def _stated(form, tmp_path, standard, renamed=None):
    """Return the files of a form whose mean currents have other standard names, and perhaps names."""
    written = DIALECTS[form].written(tmp_path / "a.nc")
    paths = written if isinstance(written, list) else [written]
    words = " ".join(read(paths).report.notes)
    names = [re.search(rf"dac_{to}: (\w+)", words)[1] for to in ("east", "north")]
    for path in paths:
        with h5py.File(path, "a") as file:
            for name, stated, to in zip(names, standard, renamed or names, strict=True):
                if to != name:
                    file.move(name, to)
                if stated:
                    file[to].attrs["standard_name"] = stated
    return paths


def _means(said):
    return [(mean["dac_eastward"], mean["dac_northward"]) for mean in said.of("/dac")]


@pytest.mark.parametrize("form", DIALECTS)
@pytest.mark.parametrize("stated", [TO[::-1], (TO[1], ""), ("", TO[0])])
def test_standard_names_that_contradict_names_decide(tmp_path, form, stated):
    said = read(_stated(form, tmp_path, stated))
    assert _means(said) == [pytest.approx(made.mean(k)[::-1], abs=1e-12) for k in (0, 1)]
    assert said.noted("read as their standard names state")


@pytest.mark.parametrize("form", ["bodc", "gliderdac", "erddap", "slocum-glide", "slocum"])
def test_unlisted_names_are_known_by_their_standard_names(tmp_path, form):
    said = read(_stated(form, tmp_path, TO, ("final_a", "final_b")))
    assert _means(said) == [pytest.approx(made.mean(k), abs=1e-12) for k in (0, 1)]


def test_unlisted_names_without_standard_names_are_candidates(tmp_path):
    _stated("bodc", tmp_path, ("", ""), ("final_a", "final_b"))
    levels = np.array([5.0, 100.0])
    sea = synthetic.dataset(3, 8, (6, 10), levels, west=-30.1, south=39.9)
    sea.to_netcdf(tmp_path / "ensemble.nc", engine="h5netcdf")
    info = run_command(tmp_path, "info a.nc")
    replayed = run_command(tmp_path, "replay a.nc --ensemble ensemble.nc -o out.mcap")
    assert replayed.returncode == 3
    for words in ("final_a, final_b may be them", "--dead-reckoning through_water"):
        assert words in info.stdout
        assert words in replayed.stderr
