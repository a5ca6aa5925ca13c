"""A Slocum's binary files: values as the glider wrote them, segments joined, fixes once, mean currents of the dive before."""

import json
from pathlib import Path

import lz4.block
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log, open_logs
from replay_kit.logs.slocum.cycles import read_cycles, read_header, sensors_of, unpacked_file
from tests.command import run_command
from tests.logs.netcdf import glider_samples as made
from tests.logs.said import read
from tests.logs.slocum import slocum_samples as slocum
from tests.places import DATA, needs

REAL = DATA / "slocum"
real = needs(REAL)


@real
def test_each_sensor_of_real_files_has_the_values_of_the_usual_reader():
    """Number, first and last value with their times, and sum."""
    expected = json.loads((REAL / "expected.json").read_text())
    compared = 0
    for name, stated in expected.items():
        data = (REAL / name).read_bytes()
        header = read_header(REAL / name, data)
        sensors, at = sensors_of(header, data)
        found = read_cycles(data, at, sensors, {sensor.name for sensor in sensors})
        assert not found.lost
        assert len(sensors) == stated["sensors"]
        time = found.values["sci_m_present_time" if header.is_science else "m_present_time"]
        for sensor in sensors:
            written = found.written[sensor.name] > 0
            # what sensors held when the file was opened is no measurement
            written[:1] = False
            values, times = found.values[sensor.name][written], time[written]
            if sensor.name not in stated["values"]:
                assert not values.size
                continue
            said = stated["values"][sensor.name]
            assert (sensor.unit, values.size) == (said["unit"], said["count"])
            assert [times[0], values[0]] == said["first"]
            assert [times[-1], values[-1]] == said["last"]
            np.testing.assert_allclose(values.sum(), said["sum"], rtol=1e-13)
            compared += 1
    assert compared == 316


@real
def test_a_real_folder_is_one_log_with_the_mean_current_of_each_dive():
    (log,), said = open_logs([REAL]), read(REAL)
    assert (log.mission, len(log.files), said.report.losses) == ("rosie_713", 22, ())
    assert said.noted(": 22 files are one log")
    ends = [(m["start_fix"]["time"]["sec"], m["end_fix"]["time"]["sec"]) for m in said.of("/dac")]
    assert len(ends) == 6
    assert all(3600 < end - start < 7000 for start, end in ends)
    # the last report before the next dive is the glider's best; that of the third dive was corrected while a file was begun
    east = [m["dac_eastward"] for m in said.of("/dac")[:3:2]]
    assert east == pytest.approx([0.03357908874750137, 0.03211885318160057])
    assert all(30.0 < m["max_depth"] < 250.0 for m in said.of("/dac"))
    fixes = [(m["latitude"], m["longitude"]) for m in said.of("/vehicle/fix")]
    assert len(fixes) == len({repr(m["timestamp"]) for m in said.of("/vehicle/fix")}) == 193
    assert all(
        51.5 < latitude < 51.7 and -128.4 < longitude < -128.2 for latitude, longitude in fixes
    )
    assert said.of("/vehicle/waypoint")[0]["waypoint_latitude"] == pytest.approx(51.65)


def test_samples_of_a_made_mission_are_those_that_were_written(tmp_path):
    slocum.mission(tmp_path)
    said = read(tmp_path)
    track = made.samples()
    positions = said.of("/vehicle/position")
    for key in ("longitude", "latitude"):
        found = [position[key] for position in positions]
        np.testing.assert_allclose(found, track[key], atol=1e-9)
    words = {item["key"]: item["value"] for item in positions[3]["metadata"]}
    assert (words["dead_reckoned"], words["pitch"]) == ("true", f"{np.rad2deg(-0.4):.2f}")
    counts = {"/ctd": track["time"].size, "/vehicle/waypoint": 1}
    assert {topic: len(said.of(topic)) for topic in counts} == counts
    assert said.of("/ctd")[0]["temperature"] == 10.0
    assert said.of("/vehicle/altimeter")[0]["altitude"] == 50.0


SENSORS = (("a", 1, "u"), ("b", 2, "u"), ("c", 4, "u"), ("d", 8, "u"), ("e", 4, "u"))
_WHOLE_NUMBERS = st.integers(-128, 127).map(float)
#: Of a sensor in a cycle: as before, or a new value.
_VALUES = {
    name: st.one_of(st.none(), _WHOLE_NUMBERS, *([st.just(np.nan)] if size > 2 else []))
    for name, size, _ in SENSORS
}


def cycles_of(data, wanted):
    """The cycles of a file."""
    sensors, at = sensors_of(read_header(Path("a.sbd"), data), data)
    return read_cycles(data, at, sensors, wanted)


@given(st.lists(st.fixed_dictionaries({}, optional=_VALUES), max_size=12), st.sampled_from("<>"))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_any_cycles_come_back(cycles, order):
    found = cycles_of(slocum.file_bytes(SENSORS, cycles, order), _VALUES.keys())
    assert not found.lost
    for name in _VALUES:
        states, values, last = [], [], np.nan
        for cycle in cycles:
            states.append((1 if cycle[name] is None else 2) if name in cycle else 0)
            last = last if cycle.get(name) is None else cycle[name]
            values += [last] if name in cycle else []
        assert found.written[name].tolist() == states
        np.testing.assert_array_equal(found.values[name][found.written[name] > 0], values)


def _cut(at):
    """Cut the second segment's flight file: at a byte, or in the middle."""

    def edit(paths):
        data = paths[2].read_bytes()
        paths[2].write_bytes(data[: at or len(data) // 2])

    return edit


def _without_currents(paths):
    kept = [sensor for sensor in slocum.FLIGHT if "water_v" not in sensor[0]]
    cycles = [
        {name: value for name, value in cycle.items() if "water_v" not in name}
        for cycle in slocum.cycles_of(1)[0]
    ]
    paths[2].write_bytes(slocum.file_bytes(kept, cycles, segment="unit_1-2023-317-0-1"))


def _flipped(paths):
    data = bytearray(paths[0].read_bytes())
    cycle = slocum.cycle_bytes(slocum.FLIGHT, slocum.cycles_of(0)[0][20])
    data[data.index(cycle) + 1] ^= 0b1100_0000
    paths[0].write_bytes(data)


def _whole_beside(paths):
    paths[0].with_suffix(".dbd").write_bytes(paths[0].read_bytes())


def _empty_beside(paths):
    (paths[0].parent / "unit_1-2023-317-0-2.sbd").write_bytes(b"")


def _wrong_clock(paths):
    flight = slocum.cycles_of(0)[0]
    flight[10] = {**flight[10], "m_present_time": 10.0}
    paths[0].write_bytes(slocum.file_bytes(slocum.FLIGHT, flight))


def _only(suffix):
    def edit(paths):
        for path in paths:
            if path.suffix != suffix:
                path.unlink()

    return edit


_WHOLE, _LACKING = "expected a whole cycle", "segments without the file of the"
_NO_CURRENTS = "m_final_water_vx, m_final_water_vy: not among the sensors of 1 of 2 files, such as "


@pytest.mark.parametrize(
    ("edit", "means", "lost", "note"),
    [
        pytest.param(_cut(60), 1, "", "", id="cut in the header"),
        pytest.param(_cut(0), 1, "", "", id="cut in the middle"),
        pytest.param(_flipped, 2, _WHOLE, "", id="a state flipped"),
        pytest.param(_empty_beside, 2, "header of a Slocum's file, got 0 lines", "", id="empty"),
        pytest.param(_without_currents, 1, None, _NO_CURRENTS, id="sensors lacking"),
        pytest.param(_whole_beside, 2, None, "1 files with fewer sensors", id="a subset"),
        pytest.param(_wrong_clock, 2, None, "1 cycles without a time", id="a wrong clock"),
        pytest.param(_only(".sbd"), 2, None, f"2 of 2 {_LACKING} science computer", id="flight"),
        pytest.param(_only(".tbd"), 0, None, f"2 of 2 {_LACKING} flight computer", id="science"),
    ],
)
def test_a_mission_of_which_a_file_was_changed_is_read_and_says_so(
    tmp_path, edit, means, lost, note
):
    """What a damage costs is its own cycles, or the mean current of its dive, and one loss that names the file."""
    edit(slocum.mission(tmp_path))
    said = read(tmp_path)
    assert len(said.of("/dac")) == means
    assert said.noted(note)
    assert min(message.time_ns for message in said.messages) > 10**18
    losses = said.report.losses
    assert len(losses) == (lost is not None)
    assert all(lost in loss.what and "unit_1-2023-317-0-" in loss.what for loss in losses)
    if edit is _flipped:
        cycle = slocum.cycle_bytes(slocum.FLIGHT, slocum.cycles_of(0)[0][20])
        assert losses[0].bytes == len(cycle)


@pytest.mark.parametrize("fill", [b"", b"X\0\0", b"\0" * 7, b"\x1a" * 100])
def test_a_file_that_ends_with_a_whole_cycle_is_whole(tmp_path, fill):
    whole = read(slocum.mission(tmp_path / "whole")[0].parent)
    for path in slocum.mission(tmp_path / "unmarked"):
        path.write_bytes(path.read_bytes()[:-1] + fill)
    said = read(tmp_path / "unmarked")
    assert said.report.losses == ()
    assert (said.of("/dac"), said.counts()) == (whole.of("/dac"), whole.counts())
    # one byte less is a cycle cut
    path.write_bytes(path.read_bytes()[: -1 - len(fill)])
    (loss,) = read(tmp_path / "unmarked").report.losses
    assert _WHOLE in loss.what


def test_positions_before_the_first_fix_are_not_where_the_glider_is(tmp_path):
    paths = slocum.mission(tmp_path)
    flight = slocum.cycles_of(0)[0]
    stale = {
        "m_present_time": flight[1]["m_present_time"] - 2.0,
        **{"m_depth": 0.0, "m_lat": slocum.minutes(40.3), "m_lon": slocum.minutes(-30.2)},
    }
    paths[0].write_bytes(slocum.file_bytes(slocum.FLIGHT, [flight[0], stale, *flight[1:]]))
    assert max(fix["latitude"] for fix in read(tmp_path).of("/vehicle/position")) < 40.03
    done = run_command(tmp_path, f"info {paths[0].parent}")
    assert "Positions: -30.0000..-29.9790 E, 40.0000..40.0210 N" in done.stdout


def test_missing_caches_are_named_and_a_folder_of_caches_is_a_setting(tmp_path):
    paths = slocum.mission(tmp_path / "log", crc=True)
    lists = (tmp_path / "log" / "cac").rename(tmp_path / "lists")
    with pytest.raises(
        LogError,
        match=r"expected its list of sensors in abcd0001\.cac, there is none in .*log/cac; .* logs\.caches",
    ):
        open_log(paths[0])
    with pytest.raises(LogError, match=r"abcd0001\.cac"):
        open_logs([tmp_path / "log"])
    config = LogConfig(caches=str(lists))
    assert len(read(tmp_path / "log", config).of("/dac")) == 2
    (lists / "ABCD0002.CAC").unlink()
    said = read(tmp_path / "log", config)
    assert len(said.of("/dac")) == 2
    assert ["abcd0002.cac" in loss.what for loss in said.report.losses] == [True, True]


def test_files_that_do_not_belong_together_are_refused(tmp_path):
    paths = slocum.mission(tmp_path / "a", crc=True)
    (tmp_path / "a" / "cac" / "ABCD0001.CAC").write_bytes(slocum.sensor_list(slocum.SCIENCE))
    with pytest.raises(
        LogError, match=r"ABCD0001\.CAC: expected 18 sensors in 5 bytes .* got 4 in"
    ):
        open_log(paths[0])
    for vehicle in ("unit_1", "unit_2"):
        slocum.mission(tmp_path / "b", vehicle=vehicle)
    with pytest.raises(LogError, match=r"holds 2: unit_1 \(unit_1-2023-317-0-\*\), unit_2"):
        open_logs([tmp_path / "b"])


def test_a_hostile_file_of_tags_alone_ends():
    data = slocum.file_bytes(slocum.FLIGHT, [])[:-1] + b"d" * ((1 << 20) - 1)
    assert cycles_of(data, {"m_depth"}).lost


def test_a_block_that_claims_to_unpack_to_more_than_it_may_is_cut_there():
    bomb = lz4.block.compress(bytes(1 << 24), store_size=False)
    packed = slocum.compressed(b"dbd_label:    DBD(dinkum_binary_data)file\n")
    found, lost_at = unpacked_file(packed + (60_000).to_bytes(2, "big") + bomb[:60_000])
    assert (len(found), lost_at) == (42, len(packed))
