"""MCAP files as a whole: order, clocks, what is no log, and what schemas and channels may cost in all."""

from collections.abc import Callable

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema
from mcap.writer import CompressionType

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.decode.budget import MOST_DECLARED, MOST_SCHEMA, BudgetError
from replay_kit.logs.decode.decoders import Channels
from replay_kit.logs.mcap.reader import McapReader
from replay_kit.logs.mcap.records import Summary
from replay_kit.logs.stamps import header_stamp
from tests.logs.log_samples import SECOND, json_mcap, one_channel_mcap
from tests.logs.log_samples import read_log as read


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_json_comes_back_in_file_order(tmp_path, compression, use_chunking):
    times = [5, 3, 3, 9, 1, 8] * 5
    messages, report = read(
        tmp_path, json_mcap(times, compression, use_chunking=use_chunking, data_crcs=True)
    )
    assert [m.time_ns for m in messages] == times
    assert [m.payload["n"] for m in messages] == [m.position for m in messages] == list(range(30))
    assert messages[1].topic == "/b"
    assert {m.schema for m in messages} == {"test.Number"}
    assert {m.input for m in messages} == {1}
    assert report.read == {"/a": 15, "/b": 15}
    assert report.losses == ()
    assert report.undecodable == {}
    assert report.format == "mcap"


def test_clocks(tmp_path):
    stamped = b'{"header": {"stamp": {"sec": 4, "nanosec": 5}}}'
    data = one_channel_mcap("json", None, [stamped, b"{}"])
    file = tmp_path / "log"
    file.write_bytes(data)
    reader = McapReader(file, config=LogConfig.model_validate({"clock": "header"}))
    assert [m.time_ns for m in reader.messages()] == [4 * SECOND + 5, 1]
    assert reader.report().without_stamp == 1
    messages, _ = read(tmp_path, json_mcap([10, 20]), LogConfig(clock="publish"))
    assert [m.time_ns for m in messages] == [17, 27]


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        ({"stamp": {"sec": 1, "nsec": 2}}, SECOND + 2),
        ({"timestamp": {"seconds": 1, "nanos": 2}}, SECOND + 2),
        (
            {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "stamp": {"sec": 3, "nsec": 0}},
            3 * SECOND,
        ),
        ({"header": "text", "stamp": None, "timestamp": 5.0}, None),
        ({"stamp": {"sec": 1.5, "nsec": 0}}, None),
        ({"stamp": {"sec": 10**12, "nsec": 0}}, None),
        ({"stamp": {"sec": -5, "nsec": 0}}, None),
        ({}, None),
    ],
)
def test_header_stamp(payload, expected):
    assert header_stamp(payload) == expected


def test_a_time_that_int64_cannot_hold(tmp_path):
    messages, report = read(tmp_path, json_mcap([1, 2**63, 2**63 - 1]))
    assert [m.time_ns for m in messages] == [1, 2**63 - 1]
    assert report.undecodable["/b"][0] == 1


def test_what_is_no_log(tmp_path):
    cases = {
        "empty": b"",
        "text": b"time,lat,lon\n",
        "bin": b"\xa3\x95\x80" + bytes(100),
        "cut": b"\x89MCAP0",
        "zeros": bytes(70_000),
    }
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(LogError, match=name):
            open_log(tmp_path / name)
    with pytest.raises(LogError, match="file not found"):
        open_log(tmp_path / "missing")
    with pytest.raises(LogError, match="the folder holds"):
        open_log(tmp_path)
    with pytest.raises(LogError, match="it begins with 'MCAP0'"):
        open_log(tmp_path / "cut")
    with pytest.raises(LogError, match="expected an MCAP file"):
        list(McapReader(tmp_path / "text").messages())


def body(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def declared(sizes):
    """Return channels, each with a schema of so many bytes of its own."""
    channels = Channels(Summary(), str)
    for k, size in enumerate(sizes, 1):
        text = f"float64 x{k:04d}".encode().ljust(size)
        channels.declare(3, body(Schema(id=k, name="p/A", encoding="ros1msg", data=text)))
        channels.declare(
            4,
            body(Channel(id=k, topic=f"/t{k}", message_encoding="ros1", metadata={}, schema_id=k)),
        )
    return channels


def test_the_schemas_of_a_log_are_parsed_up_to_a_megabyte():
    channels = declared([MOST_SCHEMA] * 4 + [20])
    decoders = [channels.sink(k).decode for k in range(1, 6)]
    assert all(isinstance(decode, Callable) for decode in decoders[:4])
    assert decoders[4] == "the schemas of this log have more than 1048576 bytes"


def test_a_log_that_declares_too_much_is_refused_further_declarations():
    channels = declared([MOST_DECLARED - 1000])
    with pytest.raises(BudgetError, match="all schemas and channels"):
        channels.declare(3, body(Schema(id=9, name="p/B", encoding="ros1msg", data=bytes(1000))))
