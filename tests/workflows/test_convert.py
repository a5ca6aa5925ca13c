import json
from collections import Counter
from io import StringIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.logs import merge, open_log
from replay_kit.logs.mavlink.reader import TlogReader
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.show.text import SafeConsole
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.convert import convert, convert_json, print_converted
from tests.command import invoke
from tests.logs.log_samples import tlog
from tests.measurements.samples import events_of
from tests.places import DATA
from tests.studies.twins.truths import make_truth

SEAGLIDER = sorted((DATA / "seaglider").glob("p17101*.nc"))


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "glider.mcap", tmp_path / "vessel.tlog"]
    make_twin(make_truth(), Twin("glider", 30, 0.09, 0), paths[0])
    make_twin(make_truth(), Twin("vessel", 20, 0.09, 1), paths[1])
    return paths


def test_logs_are_merged_in_order_and_read_by_the_stock_reader(tmp_path, logs):
    out = tmp_path / "out.mcap"
    summary = convert(logs, out, False, LogConfig())
    with out.open("rb") as file:
        read = [
            (message.log_time, channel.topic, channel.message_encoding)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert {encoding for _, topic, encoding in read if topic != "mavlink/frames/1"} == {"json"}
    frames = [time for time, topic, _ in read if topic == "mavlink/frames/1"]
    read = read[: -len(frames)]
    assert [time for time, _, _ in read] == sorted(time for time, _, _ in read)
    assert (
        Counter(topic for _, topic, _ in read) | {"mavlink/frames/1": len(frames)}
        == summary.messages
    )
    assert summary.messages["/adcp"] == 30
    assert summary.messages["mavlink/1/1/DEBUG_FLOAT_ARRAY"] == 100
    assert (summary.losses, summary.undecodable) == ((), {})


def _profiles(path: Path, component: int | None = None) -> list[Observation]:
    found = events_of(merge([open_log(path)], 1.0), MeasurementConfig(), component=component)
    return [each for events in found for each in events if isinstance(each, Observation)]


@pytest.mark.parametrize("which", [0, 1])
def test_a_converted_log_gives_the_same_observations(tmp_path, logs, which):
    out = tmp_path / "out.mcap"
    convert([logs[which]], out, False, LogConfig())
    pairs = [_profiles(path) for path in (logs[which], out)]
    assert len(pairs[0]) > 0
    for before, after in zip(*pairs, strict=True):
        assert (before.time_ns, before.longitude, before.latitude) == (
            after.time_ns,
            after.longitude,
            after.latitude,
        )
        assert before.velocity.tobytes() == after.velocity.tobytes()


def test_the_same_input_gives_the_same_bytes(tmp_path, logs):
    for name in ("a.mcap", "b.mcap"):
        convert(logs, tmp_path / name, False, LogConfig())
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_start_and_end_limit_what_is_written(tmp_path, logs):
    config = LogConfig(start="2018-11-16T01:00:00Z", end="2018-11-16T02:00:00Z")
    summary = convert(logs[:1], tmp_path / "out.mcap", False, config)
    assert summary.messages["/adcp"] == 7


def test_the_command_ends_with_4_where_bytes_were_lost_and_with_0_where_none_were(tmp_path, logs):
    data = logs[1].read_bytes()
    (tmp_path / "sound.tlog").write_bytes(data)
    (tmp_path / "cut.tlog").write_bytes(data[:5000] + b"\x00" * 50 + data[5000:])
    for name, code in (("sound", 0), ("cut", 4)):
        out, answer = tmp_path / f"{name}.mcap", tmp_path / f"{name}.json"
        done = invoke(f"convert {tmp_path}/{name}.tlog -o {out} --json {answer}")
        assert done.exit_code == code, done.exception
        # what could be read is written all the same
        assert out.exists()
        assert (
            ("LOST" in done.stdout) == bool(json.loads(answer.read_text())["losses"]) == (code == 4)
        )


def test_bad_inputs_are_refused_before_anything_is_written(tmp_path, logs):
    with pytest.raises(LogError, match="file not found"):
        convert([*logs, tmp_path / "missing.mcap"], tmp_path / "out.mcap", False, LogConfig())
    with pytest.raises(ConfigError, match="at least one log"):
        convert([], tmp_path / "out.mcap", False, LogConfig())
    assert not list(tmp_path.glob("out.mcap*"))


def _stamps(path: Path) -> list[int]:
    return [frame.time_ns // 1000 for frame in TlogReader(path).frames()]


@pytest.mark.parametrize("by_way_of_mcap", [False, True])
def test_a_telemetry_log_takes_frames_and_what_has_none(tmp_path, logs, by_way_of_mcap):
    given = logs
    if by_way_of_mcap:
        given = [tmp_path / "both.mcap"]
        convert(logs, given[0], False, LogConfig())
    summary = convert(given, tmp_path / "out.tlog", False, LogConfig())
    assert summary.messages["DEBUG_FLOAT_ARRAY"] == 5 * 30
    assert sum(
        count for topic, count in summary.messages.items() if topic.startswith("mavlink/frames")
    ) == len(_stamps(logs[1]))
    # of two vehicles' tracks in one system that of one component is used
    for component, path in ((191, logs[0]), (1, logs[1])):
        placed = {each.time_ns // 1000 for each in _profiles(tmp_path / "out.tlog", component)}
        assert placed >= {each.time_ns // 1000 for each in _profiles(path)}
    assert _stamps(tmp_path / "out.tlog") == sorted(_stamps(tmp_path / "out.tlog"))
    currents = sum(message.topic == "/dac" for message in open_log(logs[0]).messages())
    assert currents > 0
    assert summary.left_out == {
        ("/dac", "there is no frame for replay_kit.DepthAveragedCurrent"): currents
    }


def test_what_a_telemetry_log_cannot_hold_is_said(tmp_path):
    ping = {
        **{
            "coordinate_system": "beam",
            "reference": "platform",
            "orientation": "down",
            "n_cells": 1,
            "cell_size": 1.0,
        },
        **{
            "bin0_distance": 2.0,
            "velocity": [[0.1, 0.2, 0.3]],
            "beam_unit_vectors": [[0.0, 0.0, 1.0]] * 3,
            "tilt_applied": False,
        },
    }
    sent = [
        ("/adcp", ping),
        ("/adcp4", ping | {"velocity": [[0.1, 0.2, 0.3, 0.4]]}),
        ("/adcp", ping),
    ]
    messages = [
        Message(k, topic, "replay_kit.AdcpPing", payload, 0, k)
        for k, (topic, payload) in enumerate(sent)
    ]
    write_mcap_log(tmp_path / "in.mcap", [*messages, Message(9, "/plan", "", {"a": 1}, 0, 9)])
    summary = convert([tmp_path / "in.mcap"], tmp_path / "out.tlog", False, LogConfig())
    assert summary.left_out == {
        ("/adcp", "beam_unit_vectors, tilt_applied: a frame has no field for each"): 2,
        ("/adcp4", "no frame can be made: it has 4 beams, of which the frames hold 3"): 1,
        ("/plan", "there is no frame for a message without a schema"): 1,
    }
    assert summary.messages["DEBUG_FLOAT_ARRAY"] == 2 * 5
    plan = {
        "code": "there_is_no_frame_for_a_message_without_a_schema",
        "why": "there is no frame for a message without a schema",
    }
    assert {"topic": "/plan", "messages": 1, **plan} in convert_json(summary)["left_out"]
    console = SafeConsole(record=True, file=StringIO())
    print_converted(summary, console)
    assert "Excluded: 2 x /adcp: beam_unit_vectors" in console.export_text()


def test_the_help_names_every_format():
    for command in ("replay", "convert"):
        said = " ".join(invoke(f"{command} --help", columns=400).output.split())
        assert (
            "MCAP, MAVLink .tlog, DataFlash .BIN, Seaglider NetCDF, raw ADCP (PD0, AD2CP)" in said
        )


def test_frames_of_several_logs_are_merged_by_time_by_way_of_mcap_too(tmp_path):
    given, both = [tmp_path / "a.tlog", tmp_path / "b.tlog"], tmp_path / "both.mcap"
    given[0].write_bytes(b"".join(tlog(5)))
    given[1].write_bytes(b"".join(tlog(5, _stamps(given[0])[1] + 1)))
    convert(given, both, False, LogConfig())
    convert([both], tmp_path / "out.tlog", False, LogConfig())
    assert _stamps(tmp_path / "out.tlog") == sorted(_stamps(given[0]) + _stamps(given[1]))
