"""The forms of gliders' files without a real sample: the field and the fixes that were written come back, to packing precision."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import PathMean
from replay_kit.logs import open_log, open_logs
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made

DACS: dict[str, tuple[str, Callable[[Path], Path | list[Path]]]] = {
    "spray": ("spray", lambda folder: made.spray(folder / "a.nc")),
    "gliderdac": ("gliderdac", lambda folder: made.gliderdac(folder / "profiles")),
    "erddap": ("erddap", lambda folder: made.erddap(folder / "a.nc")),
    "bodc": ("og1", lambda folder: made.bodc(folder / "a.nc")),
    "socib": ("socib", lambda folder: made.socib(folder / "a.nc")),
    "slocum-glide": ("slocum-glide", lambda folder: made.slocum_glide(folder / "a.nc")),
    "slocum": ("slocum", lambda folder: made.slocum(folder / "a.nc")),
}
# of these the ends of a dive are its first and last sample, a minute inside
INSIDE = ("gliderdac", "erddap")
WITH_FIXES = ("bodc", "socib", "slocum-glide", "slocum")


def _open(given):
    (log,) = open_logs(given if isinstance(given, list) else [given])
    return log


def _topic(messages, topic):
    return [message for message in messages if message.topic == topic]


@pytest.mark.parametrize("form", DACS)
def test_mean_currents_and_their_ends_come_back(tmp_path, form):
    name, write = DACS[form]
    log = _open(write(tmp_path))
    messages = list(log.messages())
    assert log.report().format == name
    assert [message.time_ns for message in messages] == sorted(
        message.time_ns for message in messages
    )
    first, second = (message.payload for message in _topic(messages, "/dac"))
    inside = 60.0 if form in INSIDE else 0.0
    for dive, payload in enumerate((first, second)):
        assert (payload["dac_eastward"], payload["dac_northward"]) == pytest.approx(
            made.mean(dive), abs=1e-12
        )
        before, after = made.FIXES[2 * dive : 2 * dive + 2]
        step = (after - before)[1:] * inside / made.DIVE
        ends = payload["start_fix"], payload["end_fix"]
        assert [end["time"]["sec"] - made.START for end in ends] == [
            before[0] + inside,
            after[0] - inside,
        ]
        assert [(end["lon"], end["lat"]) for end in ends] == [
            pytest.approx(tuple(before[1:] + step), abs=1e-7),
            pytest.approx(tuple(after[1:] - step), abs=1e-7),
        ]
        assert payload["duration"] == pytest.approx(made.DIVE - 2 * inside)
        # where samples come to the surface, their depths number the dives
        assert payload.get("dive") == (
            dive + 1 if form in ("spray", "slocum-glide", *INSIDE) else None
        )
        deepest = {"spray": 100.0 if dive == 0 else 90.0}.get(form, 100.0)
        assert payload["max_depth"] == pytest.approx(deepest, abs=1e-9)
    fixes = _topic(messages, "/vehicle/fix")
    assert len(fixes) == (4 if form in WITH_FIXES else 0)
    for fix, (seconds, longitude, latitude) in zip(fixes, made.FIXES, strict=False):
        assert fix.time_ns == round(made.START + seconds) * 10**9
        assert (fix.payload["longitude"], fix.payload["latitude"]) == pytest.approx(
            (longitude, latitude), abs=1e-7
        )


@pytest.mark.parametrize("form", DACS)
def test_each_mean_current_is_observed_along_its_dive(tmp_path, form):
    found = list(
        observations(
            _open(DACS[form][1](tmp_path)).messages(), MeasurementConfig(use_inverted=False)
        )
    )
    means = [event for event in found if isinstance(event, PathMean)]
    assert [mean.velocity for mean in means] == [
        pytest.approx(made.mean(dive), abs=1e-12) for dive in (0, 1)
    ]
    for dive, mean in enumerate(means):
        assert float(mean.weight @ mean.depth) == pytest.approx(
            50.0 if (form, dive) != ("spray", 1) else 45.0, abs=2.0
        )
        assert (
            made.FIXES[2 * dive, 1]
            <= mean.longitude.min()
            <= mean.longitude.max()
            <= made.FIXES[2 * dive + 1, 1]
        )


def test_what_was_assumed_is_noted(tmp_path):
    notes = {form: _open(DACS[form][1](tmp_path)).report().notes for form in DACS}
    assert "IOOS GliderDAC: 4 files are one log" in notes["gliderdac"]
    assert "mean current: 2 in 118 values, each counted once" in notes["gliderdac"]
    assert "WATERCURRENTS_U, WATERCURRENTS_V: converted from cm/s to m/s" in notes["bodc"]
    assert "DEPTH_Z: has the standard name depth but is positive up; not used" in notes["bodc"]
    assert "depth: positive up (by its negative values), sign reversed" in notes["socib"]
    radians = "heading: no value above 1.50, so taken as radians although its unit is degrees; converted to degrees"
    assert radians in notes["socib"]
    assert (
        "m_lon, m_lat, m_gps_lon, m_gps_lat: degrees and minutes (ddmm.mmm) converted to degrees"
        in notes["slocum"]
    )
    assert "m_heading: converted from rad to degrees" in notes["slocum"]
    assert "m_gps_lat: 118 values outside -90..90 degrees taken as missing" in notes["slocum"]
    assert "mean current: 1 of exactly (0, 0) taken as missing" in notes["slocum"]


@pytest.mark.parametrize("form", ["socib", "slocum"])
def test_headings_come_back_in_degrees(tmp_path, form):
    position = _topic(list(_open(DACS[form][1](tmp_path)).messages()), "/vehicle/position")[0]
    metadata = {item["key"]: item["value"] for item in position.payload["metadata"]}
    assert metadata["heading"] == f"{np.rad2deg(1.5):.2f}"
    assert float(metadata["depth"]) == pytest.approx(100.0 / 30.0, abs=1e-3)


def test_a_folder_and_the_files_in_any_order_are_the_same_log(tmp_path):
    files = made.gliderdac(tmp_path / "profiles")
    by_name = [message.payload for message in _open(sorted(files)).messages()]
    assert by_name == [message.payload for message in _open(files[::-1]).messages()]
    assert by_name == [message.payload for message in open_log(tmp_path / "profiles").messages()]
    assert len(open_logs([*files, made.erddap(tmp_path / "a.nc")])) == 2
    # each file alone has the mean current of its dive, between its own first and last sample
    assert [
        message.payload["duration"]
        for message in _topic(list(open_log(files[0]).messages()), "/dac")
    ] == [1740.0]


def test_values_flagged_bad_are_not_used(tmp_path):
    files = made.gliderdac(tmp_path / "profiles")
    import h5py

    with h5py.File(files[0], "r+") as file:
        file["u_qc"][...] = 4
    log = open_log(files[0])
    assert not _topic(list(log.messages()), "/dac")
    assert log.report().undecodable == {"/dac": (1, "mean current flagged bad (u_qc)")}
    assert "u_qc: 1 x 4 (bad_data), not used" in log.report().notes


def test_the_parts_of_a_seaexplorer_come_back_with_their_fixes(tmp_path):
    made.seaexplorer(tmp_path / "raw")
    log = open_log(tmp_path / "raw")
    messages = list(log.messages())
    counts = Counter(message.topic for message in messages)
    # every five minutes; two dives of eleven samples, and the fixes
    assert counts == {"/vehicle/fix": 4, "/vehicle/position": 22}
    for fix, (seconds, longitude, latitude) in zip(
        _topic(messages, "/vehicle/fix"), made.FIXES, strict=True
    ):
        assert fix.time_ns == round(made.START + seconds) * 10**9
        assert (fix.payload["longitude"], fix.payload["latitude"]) == pytest.approx(
            (longitude, latitude), abs=1e-6
        )
    assert "Declination: declination 17 degrees" in " ".join(log.report().notes)
    assert "Timestamp: 1 values without a time, excluded" in log.report().notes
    # cut off at its end
    assert "1 line with fewer or more columns than the heading, not used" in log.report().notes


def test_small_tilts_of_a_raw_format_are_in_its_unit(tmp_path):
    for path in made.seaexplorer(tmp_path / "raw"):
        heading, *lines = path.read_text().split("\n")
        path.write_text(
            "\n".join(
                [heading + "Roll;", *(line + "1.2;" for line in lines if line.count(";") > 2)]
            )
        )
    log = open_log(tmp_path / "raw")
    positions = _topic(log.messages(), "/vehicle/position")
    said = {
        item["value"] for m in positions for item in m.payload["metadata"] if item["key"] == "roll"
    }
    assert said == {"1.20"}
    assert not any("taken as radians" in note for note in log.report().notes)
