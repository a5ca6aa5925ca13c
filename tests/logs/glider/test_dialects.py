"""The forms of gliders' files without a real sample: the field and the fixes that were written come back, to packing precision."""

import contextlib
import gzip
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation, PathMean
from replay_kit.logs import merge, open_log, open_logs
from replay_kit.logs.glider.ad2cp import _BEAMS
from replay_kit.logs.reader import LogFile
from replay_kit.measurements import observations
from tests.logs.glider import glider_samples as made

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


def _open(given: Path | list[Path]) -> LogFile:
    (log,) = open_logs(given if isinstance(given, list) else [given])
    return log


def _topic(messages: list[Message], topic: str) -> list[Message]:
    return [message for message in messages if message.topic == topic]


@pytest.mark.parametrize("form", DACS)
def test_mean_currents_and_their_ends_come_back(tmp_path: Path, form: str) -> None:
    name, write = DACS[form]
    log = _open(write(tmp_path))
    messages = list(log.messages())
    assert log.report().format == name
    assert [message.time_ns for message in messages] == sorted(message.time_ns for message in messages)
    first, second = (message.payload for message in _topic(messages, "/dac"))
    inside = 60.0 if form in INSIDE else 0.0
    for dive, payload in enumerate((first, second)):
        assert (payload["dac_eastward"], payload["dac_northward"]) == pytest.approx(made.mean(dive), abs=1e-12)
        before, after = made.FIXES[2 * dive : 2 * dive + 2]
        step = (after - before)[1:] * inside / made.DIVE
        ends = payload["start_fix"], payload["end_fix"]
        assert [end["time"]["sec"] - made.START for end in ends] == [before[0] + inside, after[0] - inside]
        assert [(end["lon"], end["lat"]) for end in ends] == [
            pytest.approx(tuple(before[1:] + step), abs=1e-7),
            pytest.approx(tuple(after[1:] - step), abs=1e-7),
        ]
        assert payload["duration"] == pytest.approx(made.DIVE - 2 * inside)
        deepest = {"spray": 100.0 if dive == 0 else 90.0}.get(form, 100.0)
        assert payload["max_depth"] == pytest.approx(deepest, abs=1e-9)
    fixes = _topic(messages, "/vehicle/fix")
    assert len(fixes) == (4 if form in WITH_FIXES else 0)
    for fix, (seconds, longitude, latitude) in zip(fixes, made.FIXES, strict=False):
        assert fix.time_ns == round(made.START + seconds) * 10**9
        assert (fix.payload["longitude"], fix.payload["latitude"]) == pytest.approx((longitude, latitude), abs=1e-7)


@pytest.mark.parametrize("form", DACS)
def test_each_mean_current_is_observed_along_its_dive(tmp_path: Path, form: str) -> None:
    found = list(observations(_open(DACS[form][1](tmp_path)).messages(), MeasurementConfig(use_inverted=False)))
    means = [event for event in found if isinstance(event, PathMean)]
    assert [mean.velocity for mean in means] == [pytest.approx(made.mean(dive), abs=1e-12) for dive in (0, 1)]
    for dive, mean in enumerate(means):
        assert float(mean.weight @ mean.depth) == pytest.approx(50.0 if (form, dive) != ("spray", 1) else 45.0, abs=2.0)
        assert made.FIXES[2 * dive, 1] <= mean.longitude.min() <= mean.longitude.max() <= made.FIXES[2 * dive + 1, 1]


def test_absolute_profiles_of_spray_come_back_with_depth_first(tmp_path: Path) -> None:
    log = _open(made.spray(tmp_path / "a.nc"))
    profiles = [event for event in observations(log.messages(), MeasurementConfig()) if isinstance(event, Observation)]
    assert len(profiles) == 2
    for dive, profile in enumerate(profiles):
        east, north = made.current(made.DEPTHS, dive)
        if dive == 1:
            east[-1] = north[-1] = np.nan
        np.testing.assert_allclose(profile.depth, made.DEPTHS)
        np.testing.assert_allclose(profile.velocity, np.column_stack([east, north]), atol=5.1e-5)
        assert (profile.reference, profile.time_ns) == ("earth", round(made.middles()[dive, 0]) * 10**9)
        assert (profile.longitude, profile.latitude) == pytest.approx(tuple(made.middles()[dive, 1:]), abs=1e-9)
    # the same water does not count twice
    assert not [event for event in observations(log.messages(), MeasurementConfig()) if isinstance(event, PathMean)]


def test_what_was_assumed_is_noted(tmp_path: Path) -> None:
    notes = {form: _open(DACS[form][1](tmp_path)).report().notes for form in DACS}
    assert "IOOS GliderDAC: 4 files are one log" in notes["gliderdac"]
    assert "mean current: 2 in 118 values, each counted once" in notes["gliderdac"]
    assert "WATERCURRENTS_U: converted from cm/s to m/s" in notes["bodc"]
    assert "DEPTH_Z: bears the standard name of a depth and counts upwards; not used" in notes["bodc"]
    assert "depth: counts upwards (its values are negative), sign reversed" in notes["socib"]
    radians = "heading: no value above 1.50, so taken as radians although its unit is degrees; converted to degrees"
    assert radians in notes["socib"]
    assert "m_lat: degrees and minutes (ddmm.mmm) converted to degrees" in notes["slocum"]
    assert "m_heading: converted from rad to degrees" in notes["slocum"]
    assert "m_gps_lat: 118 values outside -90..90 degrees taken as missing" in notes["slocum"]
    assert "mean current: 1 values of exactly (0, 0) taken as missing" in notes["slocum"]


@pytest.mark.parametrize("form", ["socib", "slocum"])
def test_headings_come_back_in_degrees(tmp_path: Path, form: str) -> None:
    position = _topic(list(_open(DACS[form][1](tmp_path)).messages()), "/vehicle/position")[0]
    metadata = {item["key"]: item["value"] for item in position.payload["metadata"]}
    assert metadata["heading"] == f"{np.rad2deg(1.5):.2f}"
    assert float(metadata["depth"]) == pytest.approx(100.0 / 30.0, abs=1e-3)


def test_a_folder_and_the_files_in_any_order_are_the_same_log(tmp_path: Path) -> None:
    files = made.gliderdac(tmp_path / "profiles")
    by_name = [message.payload for message in _open(sorted(files)).messages()]
    assert by_name == [message.payload for message in _open(files[::-1]).messages()]
    assert by_name == [message.payload for message in open_log(tmp_path / "profiles").messages()]
    assert len(open_logs([*files, made.erddap(tmp_path / "a.nc")])) == 2
    # each file alone has the mean current of its dive, between its own first and last sample
    assert [message.payload["duration"] for message in _topic(list(open_log(files[0]).messages()), "/dac")] == [1740.0]


def test_values_flagged_bad_are_not_used(tmp_path: Path) -> None:
    files = made.gliderdac(tmp_path / "profiles")
    import h5py

    with h5py.File(files[0], "r+") as file:
        file["u_qc"][...] = 4
    log = open_log(files[0])
    assert not _topic(list(log.messages()), "/dac")
    assert log.report().undecodable == {"/dac": (1, "mean current flagged bad (u_qc)")}
    assert "u_qc: 1 x 4 (bad_data), not used" in log.report().notes


def test_the_parts_of_a_seaexplorer_come_back_with_their_fixes(tmp_path: Path) -> None:
    made.seaexplorer(tmp_path / "raw")
    log = open_log(tmp_path / "raw")
    messages = list(log.messages())
    counts = Counter(message.topic for message in messages)
    # every five minutes; two dives of eleven samples, and the fixes
    assert counts == {"/vehicle/fix": 4, "/vehicle/position": 22}
    for fix, (seconds, longitude, latitude) in zip(_topic(messages, "/vehicle/fix"), made.FIXES, strict=True):
        assert fix.time_ns == round(made.START + seconds) * 10**9
        assert (fix.payload["longitude"], fix.payload["latitude"]) == pytest.approx((longitude, latitude), abs=1e-6)
    assert "Declination: declination 17 degrees" in " ".join(log.report().notes)
    assert "Timestamp: 1 values without a time, left out" in log.report().notes


VELOCITY = np.array([0.3, -0.1, 0.05])


def test_velocities_of_a_midas_export_come_back_on_true_axes(tmp_path: Path) -> None:
    export = made.midas(tmp_path / "sea063_M22.ad2cp.nc", VELOCITY, _BEAMS)
    track = made.bodc(tmp_path / "track.nc")
    logs = open_logs([export, track])
    assert [log.format for log in logs] == ["midas", "og1"]
    config = MeasurementConfig(magnetic_declination=5.0, use_dac=False)
    pings = [event for event in observations(merge(logs, 1.0), config) if isinstance(event, Observation)]
    assert [ping.reference for ping in pings] == ["platform", "platform"]
    for ping, heading in zip(pings, (35.0, 45.0), strict=True):
        # x points along the heading, y to its left, for an instrument that looks up
        along, left = VELOCITY[:2]
        angle = np.deg2rad(90.0 - heading)
        east, north = along * np.cos(angle) - left * np.sin(angle), along * np.sin(angle) + left * np.cos(angle)
        np.testing.assert_allclose(ping.velocity, np.tile([east, north], (5, 1)), atol=1e-5)
    # up from 33 dbar
    np.testing.assert_allclose(pings[0].depth, 32.7 - np.arange(2.0, 12.0, 2.0), atol=0.2)
    assert any("looks up, by its accelerometer" in note for note in logs[0].report().notes)


def test_a_forecast_and_a_file_without_time_are_no_logs(tmp_path: Path) -> None:
    grid = np.zeros((2, 3, 3))
    time: Any = (("time",), [made.START, made.START + 60.0], made.EPOCH)
    field = (("time", "y", "x"), grid, {"standard_name": "eastward_sea_water_velocity"})
    with pytest.raises(LogError, match="currents on a grid: time, uo; a forecast is given with --ensemble"):
        open_log(made.write(tmp_path / "f.nc", {"time": time, "uo": field}))
    with pytest.raises(LogError, match=r"a variable of time .*; got variables lat"):
        open_log(made.write(tmp_path / "n.nc", {"lat": (("n",), np.zeros(3), {})}))


def test_rows_of_an_unknown_file_are_read_by_a_mapping(tmp_path: Path) -> None:
    """Three cells along a second dimension, time last: each row over the time is a message."""
    track = made.samples(600.0)
    n = track["time"].size
    levels = np.array([10.0, 20.0, 30.0])
    east, north = made.current(levels, 0)
    path = made.write(
        tmp_path / "lab.nc",
        {
            "when": (("obs",), track["time"], made.EPOCH),
            "x": (("obs",), track["longitude"], {}),
            "y": (("obs",), track["latitude"], {}),
            "bins": (("bin",), levels, {}),
            "ve": (("bin", "obs"), *_packed_rows(east, n)),
            "vn": (("bin", "obs"), *_packed_rows(north, n)),
        },
    )
    log = open_log(path)
    assert log.report().notes[0] == (
        "of no known glider dialect: each row over when is a message on netcdf/when, with x, y, ve, vn, and at each row bins"
    )
    messages = list(log.messages())
    assert len(messages) == n == 10
    entry = {"topic": "netcdf/when", "kind": "profile", "reference": "earth", "frame": "enu", "east": "ve", "north": "vn", "depths": "bins"}
    config = MeasurementConfig.model_validate({"map": [entry | {"longitude": "x", "latitude": "y"}]})
    profiles = [event for event in observations(messages, config) if isinstance(event, Observation)]
    assert len(profiles) == 10
    np.testing.assert_allclose(profiles[3].velocity, np.column_stack([east, north]), atol=5.1e-5)
    np.testing.assert_allclose(profiles[3].depth, levels)
    assert (profiles[3].longitude, profiles[3].latitude) == (track["longitude"][3], track["latitude"][3])
    unknown = config.model_copy(update={"map": (config.map[0].model_copy(update={"reference": "unknown"}),)})
    assert not [event for event in observations(messages, unknown) if isinstance(event, Observation)]


def _packed_rows(values: np.ndarray, n: int) -> tuple[np.ndarray, dict[str, Any]]:
    return made.packed(np.tile(values[:, None], (1, n)), 1e-4)


@pytest.mark.parametrize("form", [*DACS, "midas"])
@pytest.mark.parametrize("seed", range(6))
def test_files_that_lack_variables_or_hold_nonsense_are_read_or_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, seed: int
) -> None:
    """One variable each is left out, emptied, reversed, made large, cut to half on a dimension of its own, or of an impossible unit."""
    rng = np.random.default_rng([seed, *form.encode()])
    write = made.write

    def damaged(path: Path, variables: made.Variables, *rest: Any, **named: Any) -> Path:
        name = str(rng.choice(list(variables)))
        dims, values, attributes = variables[name]
        values = np.asarray(values)
        number = values.dtype.kind == "f"
        changed = [
            None,
            (dims, np.full(values.shape, np.nan) if number else values, attributes),
            (dims, values[::-1] if values.ndim else values, attributes),
            (dims, values * 1e30 if number else values, attributes),
            (tuple(f"own{k}" for k in range(values.ndim)), values[: len(values) // 2] if values.ndim else values, attributes),
            (dims, values, attributes | {"units": "days since 2000-13-45"}),
        ][seed]
        kept = {key: value for key, value in variables.items() if key != name and not (values.ndim and key in dims and seed == 4)}
        return write(path, kept | ({} if changed is None else {name: changed}), *rest, **named)

    monkeypatch.setattr(made, "write", damaged)
    given = made.midas(tmp_path / "a.nc", VELOCITY, _BEAMS) if form == "midas" else DACS[form][1](tmp_path)
    found = []
    with contextlib.suppress(LogError):
        found = list(observations(merge(open_logs(given if isinstance(given, list) else [given]), 1.0), MeasurementConfig()))
    # nothing that is not finite leaves the reader, and no error but our own
    assert all(np.isfinite(event.velocity).all() for event in found if isinstance(event, PathMean))


def test_beams_of_other_cells_are_refused(tmp_path: Path) -> None:
    path = made.midas(tmp_path / "a.nc", VELOCITY, _BEAMS)
    import h5py

    with h5py.File(path, "r+") as file:
        del file["Data/Average/VelocityBeam2"]
        file["Data/Average/VelocityBeam2"] = np.zeros((2, 4))
    with pytest.raises(LogError, match=r"expected beams with the same cells at each of 2 times, got VelocityBeam1 \(2, 5\), VelocityBeam2"):
        open_log(path)


def test_times_of_fixes_that_are_all_fill_do_not_cost_the_file(tmp_path: Path) -> None:
    import h5py

    path = made.bodc(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file["TIME_GPS"][...] = -1.0
    log = open_log(path)
    # the rows' own times stand for them
    assert [message.time_ns for message in log.messages() if message.topic == "/vehicle/fix"] == [
        round(made.START + seconds) * 10**9 for seconds in made.FIXES[:, 0]
    ]
    assert "TIME_GPS: holds no time of a mission, not used" in log.report().notes
    with h5py.File(path, "r+") as file:
        file["TIME_GPS"][0] = made.START + 5.0
    assert [message.time_ns - round(made.START) * 10**9 for message in open_log(path).messages() if message.topic == "/vehicle/fix"] == [
        seconds * 10**9 for seconds in (5, 3600, 4200, 7800)
    ]
    with h5py.File(path, "r+") as file:
        file["TIME"][...] = -1.0
    with pytest.raises(LogError, match="TIME: expected units"):
        open_log(path)


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_compressed_file_is_an_error_of_ours(tmp_path: Path, damage: str) -> None:
    first, _ = made.seaexplorer(tmp_path / "raw")
    data = bytearray(gzip.compress(first.read_bytes(), mtime=0))
    path = tmp_path / "sea063.22.gli.sub.9.gz"
    path.write_bytes(bytes(data))
    assert len(list(open_log(path).messages())) == 13
    # cut in the middle, or with one bit of its checksum changed
    data[-6] ^= 1
    path.write_bytes(bytes(data[: len(data) // 2]) if damage == "cut" else bytes(data))
    with pytest.raises(LogError, match="cannot be read as a SeaExplorer's file"):
        open_log(path)
