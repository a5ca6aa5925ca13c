"""A Slocum's binary files: values as the glider wrote them, segments joined, fixes once, mean currents of the dive before."""

import contextlib
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
from replay_kit.logs.slocum.cycles import read_cycles
from replay_kit.logs.slocum.header import SensorLists, read_header, read_sensors, unpacked
from tests.command import run_command
from tests.fuzz.mishap import mishap
from tests.logs.netcdf import glider_samples as made
from tests.logs.slocum import slocum_samples as slocum
from tests.places import DATA, needs
from tests.reference.slocum import cycles as cycles_one_by_one

REAL = DATA / "slocum"
real = needs(REAL)


def _topics(log):
    found = {}
    for message in log.messages():
        found.setdefault(message.topic, []).append(message)
    return found


@real
def test_each_sensor_of_real_files_has_the_values_of_the_usual_reader():
    """Of 22 files 316 sensors: number, first and last value with their times, and sum."""
    expected = json.loads((REAL / "expected.json").read_text())
    lists, compared = SensorLists(), 0
    for name, stated in expected.items():
        data = (REAL / name).read_bytes()
        header = read_header(REAL / name, data)
        cache, text = lists.find(header)
        sensors, _ = read_sensors(header, text, str(cache))
        found = read_cycles(data, header.size, sensors, {sensor.name for sensor in sensors})
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
    (log,) = open_logs([REAL])
    found = _topics(log)
    assert (log.mission, len(log.files), log.report().losses) == ("rosie_713", 22, ())
    ends = [
        (m.payload["start_fix"]["time"]["sec"], m.payload["end_fix"]["time"]["sec"])
        for m in found["/dac"]
    ]
    assert len(ends) == 6
    assert all(3600 < end - start < 7000 for start, end in ends)
    # the last report before the next dive is the glider's best; that of the third dive was corrected while a file was begun
    assert found["/dac"][2].payload["dac_eastward"] == pytest.approx(0.03211885318160057)
    assert found["/dac"][0].payload["dac_eastward"] == pytest.approx(0.03357908874750137)
    assert all(30.0 < m.payload["max_depth"] < 250.0 for m in found["/dac"])
    fixes = [(m.payload["latitude"], m.payload["longitude"]) for m in found["/vehicle/fix"]]
    assert len(fixes) == len({m.time_ns for m in found["/vehicle/fix"]}) == 193
    assert all(
        51.5 < latitude < 51.7 and -128.4 < longitude < -128.2 for latitude, longitude in fixes
    )
    assert found["/vehicle/waypoint"][0].payload["waypoint_latitude"] == pytest.approx(51.65)


@pytest.mark.parametrize("form", ["plain", "caches", "compressed"])
def test_a_made_mission_is_read_as_it_was_flown(tmp_path, form):
    slocum.mission(tmp_path, form != "plain", compress=form == "compressed")
    found = _topics(log := open_log(tmp_path))
    assert log.report().losses == ()
    assert [m.payload["longitude"] for m in found["/vehicle/fix"]] == pytest.approx(
        made.FIXES[:, 1]
    )
    for dive, message in enumerate(found["/dac"]):
        east, north = made.mean(dive)
        assert message.payload["dac_eastward"] == pytest.approx(east, abs=1e-7)
        assert message.payload["dac_northward"] == pytest.approx(north, abs=1e-7)
        ends = [
            message.payload[end]["time"]["sec"] - made.START for end in ("start_fix", "end_fix")
        ]
        assert ends == made.FIXES[2 * dive : 2 * dive + 2, 0].tolist()
    track = made.samples()
    positions = found["/vehicle/position"]
    assert len(positions) == track["time"].size
    for key in ("longitude", "latitude"):
        np.testing.assert_allclose([m.payload[key] for m in positions], track[key], atol=1e-9)
    said = {item["key"]: item["value"] for item in positions[3].payload["metadata"]}
    assert said["dead_reckoned"] == "true"
    assert said["pitch"] == f"{np.rad2deg(-0.4):.2f}"
    assert len(found["/ctd"]) == track["time"].size
    assert found["/ctd"][0].payload["temperature"] == 10.0
    assert len(found["/vehicle/waypoint"]) == 1
    assert found["/vehicle/altimeter"][0].payload["altitude"] == 50.0


values = st.dictionaries(
    st.sampled_from(["a", "b", "c", "d", "e"]),
    st.one_of(st.none(), st.integers(-128, 127).map(float), st.just(float("nan"))),
)
SENSORS = (("a", 1, "u"), ("b", 2, "u"), ("c", 4, "u"), ("d", 8, "u"), ("e", 4, "u"))


def cycles_of(data, wanted):
    """The cycles of a file, and where they begin."""
    header = read_header(Path("a.sbd"), data)
    sensors, length = read_sensors(header, data[header.size :], "a.sbd")
    return read_cycles(data, header.size + length, sensors, wanted), header.size + length


@given(st.lists(values, max_size=12), st.sampled_from("<>"))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_any_cycles_are_read_as_by_the_slow_twin(cycles, order):
    cycles = [
        {
            name: 0.0 if size < 4 and cycle[name] != cycle[name] else cycle[name]
            for name, size, _ in SENSORS
            if name in cycle
        }
        for cycle in cycles
    ]
    data = slocum.file_bytes(SENSORS, cycles, order)
    found, begin = cycles_of(data, set("abcde"))
    expected = cycles_one_by_one(data, begin, SENSORS)
    assert found.lost == ()
    for name, _, _ in SENSORS:
        states = [cycle.get(name, (0, 0.0))[0] for cycle in expected]
        assert found.written[name].tolist() == states
        written = [k for k, state in enumerate(states) if state]
        np.testing.assert_array_equal(
            found.values[name][written], [expected[k][name][1] for k in written]
        )


def test_a_compressed_file_is_the_file():
    data = slocum.file_bytes(slocum.FLIGHT, slocum.cycles_of(0)[0])
    assert unpacked(slocum.compressed(data, 700)).data == data
    cut = unpacked(slocum.compressed(data, 700)[:-5])
    assert data.startswith(cut.data)
    assert cut.lost_at > 0


PLACES = {
    "header": 60,
    "sensor list": 700,
    "known bytes": -1,
    "first cycle": -2,
    "middle": -3,
}


@pytest.mark.parametrize("part", PLACES)
def test_a_file_cut_in_any_part_is_a_named_loss_of_a_mission_that_is_still_read(tmp_path, part):
    paths = slocum.mission(tmp_path)
    data = paths[2].read_bytes()
    known = data.index(b"sa\x124")
    size = {-1: known + 7, -2: known + 30, -3: len(data) // 2 + known // 2}.get(
        PLACES[part], PLACES[part]
    )
    paths[2].write_bytes(data[:size])
    log = open_log(tmp_path)
    found = _topics(log)
    (loss,) = log.report().losses
    assert paths[2].name in loss.what
    assert len(found["/dac"]) == 1


@pytest.mark.parametrize("fill", [b"", b"X\0\0", b"\0" * 7, b"\x1a" * 100])
def test_a_file_that_ends_with_a_whole_cycle_is_whole(tmp_path, fill):
    whole = _topics(open_log(slocum.mission(tmp_path / "whole")[0].parent))
    for path in slocum.mission(tmp_path / "unmarked"):
        path.write_bytes(path.read_bytes()[:-1] + fill)
    found = _topics(log := open_log(tmp_path / "unmarked"))
    assert log.report().losses == ()
    assert [m.payload for m in found["/dac"]] == [m.payload for m in whole["/dac"]]
    assert {topic: len(each) for topic, each in found.items()} == {
        topic: len(each) for topic, each in whole.items()
    }
    # one byte less is a cycle cut
    path.write_bytes(path.read_bytes()[: -1 - len(fill)])
    _topics(log := open_log(tmp_path / "unmarked"))
    (loss,) = log.report().losses
    assert "expected a whole cycle" in loss.what


def test_sensors_that_a_segment_lacks_are_said(tmp_path):
    paths = slocum.mission(tmp_path)
    kept = [sensor for sensor in slocum.FLIGHT if "water_v" not in sensor[0]]
    cycles = [
        {name: value for name, value in cycle.items() if "water_v" not in name}
        for cycle in slocum.cycles_of(1)[0]
    ]
    paths[2].write_bytes(slocum.file_bytes(kept, cycles, segment="unit_1-2023-317-0-1"))
    found = _topics(log := open_log(tmp_path))
    assert len(found["/dac"]) == 1
    (said,) = [note for note in log.report().notes if "not among the sensors" in note]
    assert said.startswith("m_water_vx, m_water_vy, m_final_water_vx, m_final_water_vy: ")
    assert said.endswith(f"1 of 2 files, such as {paths[2].name}; their dives have no mean current")


def test_positions_before_the_first_fix_are_not_where_the_glider_is(tmp_path):
    paths = slocum.mission(tmp_path)
    flight = slocum.cycles_of(0)[0]
    stale = {
        "m_present_time": flight[1]["m_present_time"] - 2.0,
        **{"m_depth": 0.0, "m_lat": slocum.minutes(40.3), "m_lon": slocum.minutes(-30.2)},
    }
    paths[0].write_bytes(slocum.file_bytes(slocum.FLIGHT, [flight[0], stale, *flight[1:]]))
    found = _topics(open_log(tmp_path))
    latitude = [m.payload["latitude"] for m in found["/vehicle/position"]]
    assert max(latitude) < 40.03
    done = run_command(tmp_path, f"info {paths[0].parent}")
    assert "Positions: -30.0000..-29.9790 E, 40.0000..40.0210 N" in done.stdout


def test_a_flipped_state_loses_its_cycles_and_not_those_after(tmp_path):
    paths = slocum.mission(tmp_path)
    data = bytearray(paths[0].read_bytes())
    cycle = slocum.cycle_bytes(slocum.FLIGHT, slocum.cycles_of(0)[0][20])
    data[data.index(cycle) + 1] ^= 0b1100_0000
    paths[0].write_bytes(data)
    log = open_log(tmp_path)
    found = _topics(log)
    (loss,) = log.report().losses
    assert "expected a whole cycle" in loss.what
    assert len(found["/dac"]) == 2
    assert loss.bytes == len(cycle)
    assert log.report().unchecked


def test_missing_caches_are_named_and_a_folder_of_caches_is_a_setting(tmp_path):
    paths = slocum.mission(tmp_path / "log", crc=True)
    (tmp_path / "log" / "cac").rename(tmp_path / "lists")
    with pytest.raises(
        LogError,
        match=r"expected its list of sensors in abcd0001\.cac, there is none in .*log/cac; .* logs\.caches",
    ):
        open_log(paths[0])
    with pytest.raises(LogError, match=r"abcd0001\.cac"):
        open_logs([tmp_path / "log"])
    config = LogConfig(caches=str(tmp_path / "lists"))
    (log,) = open_logs([tmp_path / "log"], config)
    assert len(_topics(log)["/dac"]) == 2
    (tmp_path / "lists" / "ABCD0002.CAC").unlink()
    (log,) = open_logs([tmp_path / "log"], config)
    assert len(_topics(log)["/dac"]) == 2
    losses = log.report().losses
    assert len(losses) == 2
    assert all("abcd0002.cac" in loss.what for loss in losses)


def test_a_cache_of_another_mission_is_refused_with_what_it_lists(tmp_path):
    paths = slocum.mission(tmp_path, crc=True)
    (tmp_path / "cac" / "ABCD0001.CAC").write_bytes(slocum.sensor_list(slocum.SCIENCE))
    with pytest.raises(
        LogError, match=r"ABCD0001\.CAC: expected 18 sensors in 5 bytes .* got 4 in 5 lines"
    ):
        open_log(paths[0])


def test_a_folder_of_two_gliders_is_refused(tmp_path):
    slocum.mission(tmp_path)
    slocum.mission(tmp_path, vehicle="unit_2")
    with pytest.raises(LogError, match=r"holds 2: unit_1 \(unit_1-2023-317-0-\*\), unit_2"):
        open_logs([tmp_path])


@pytest.mark.parametrize(("kept", "lacking"), [("sbd", "science"), ("tbd", "flight")])
def test_the_files_of_one_computer_alone_are_read_and_the_lack_is_noted(tmp_path, kept, lacking):
    for path in slocum.mission(tmp_path):
        if path.suffix != f".{kept}":
            path.unlink()
    log = open_log(tmp_path)
    found = _topics(log)
    assert f"2 of 2 segments without the file of the {lacking} computer" in log.report().notes
    assert ("/dac" in found, "/ctd" in found) == (kept == "sbd", kept == "tbd")


def test_a_subset_of_a_file_that_is_there_whole_is_not_used(tmp_path):
    paths = slocum.mission(tmp_path)
    whole = paths[0].with_suffix(".dbd")
    whole.write_bytes(paths[0].read_bytes())
    log = open_log(tmp_path)
    assert whole in log.files
    assert paths[0] not in log.files
    assert len(_topics(log)["/dac"]) == 2
    assert any("1 files with fewer sensors" in note for note in log.report().notes)


def test_an_empty_file_of_a_mission_is_a_loss(tmp_path):
    slocum.mission(tmp_path)
    (tmp_path / "unit_1-2023-317-0-2.sbd").write_bytes(b"")
    log = open_log(tmp_path)
    assert len(_topics(log)["/dac"]) == 2
    assert "expected the header of a Slocum's file, got 0 lines" in log.report().losses[0].what


def test_the_wrong_clock_of_a_cycle_is_excluded_and_counted(tmp_path):
    flight = slocum.cycles_of(0)[0]
    flight[10] = {**flight[10], "m_present_time": 10.0}
    path = tmp_path / "a.sbd"
    path.write_bytes(slocum.file_bytes(slocum.FLIGHT, flight))
    log = open_log(path)
    assert min(m.time_ns for m in log.messages()) > 10**18
    assert any("1 cycles without a time" in note for note in log.report().notes)


def test_a_list_of_more_sensors_than_there_are_is_refused_before_memory_is_taken():
    many = tuple((f"s{k}", 1, "u") for k in range(9000))
    data = slocum.file_bytes(many, [])
    header = read_header(Path("a.sbd"), data)
    with pytest.raises(LogError, match="got 9000 in"):
        read_sensors(header, data[header.size :], "a.sbd")


@pytest.mark.parametrize("count", [100, pytest.param(5000, marks=pytest.mark.full)])
def test_a_mission_with_a_damaged_file_or_cache_is_read_or_refused(tmp_path, count):
    """Nothing else is raised, and what is not refused tells of the loss or reads to its end."""
    slocum.mission(tmp_path, crc=True)
    files = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*.*")) if path.is_file()}
    assert len(files) == 6
    for number in range(count):
        path, data = list(files.items())[number % len(files)]
        path.write_bytes(mishap(data, number, 7).data)
        with contextlib.suppress(LogError):
            (log,) = open_logs([tmp_path])
            assert sum(1 for _ in log.messages()) > 0
        path.write_bytes(data)


def test_a_hostile_file_of_tags_alone_ends():
    data = slocum.file_bytes(slocum.FLIGHT, [])[:-1] + b"d" * ((1 << 20) - 1)
    assert cycles_of(data, {"m_depth"})[0].lost


def test_a_block_that_claims_to_unpack_to_more_than_it_may_is_cut_there():
    bomb = lz4.block.compress(bytes(1 << 24), store_size=False)
    packed = slocum.compressed(b"dbd_label:    DBD(dinkum_binary_data)file\n")
    found = unpacked(packed + (60_000).to_bytes(2, "big") + bomb[:60_000])
    assert found.lost_at == len(packed)
    assert len(found.data) == 42
