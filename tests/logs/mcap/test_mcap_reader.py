"""MCAP files as a whole: order, clocks, what is no log, and what schemas and channels may cost in all."""

import orjson
import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs.decode.decoders import Channels
from replay_kit.logs.mcap.records import MOST_DECLARED, MOST_SCHEMA, BudgetError, Summary
from tests.logs.log_samples import SECOND, json_mcap, one_channel_mcap
from tests.logs.log_samples import read_log as read


def test_clocks(tmp_path):
    stamped = b'{"header": {"stamp": {"sec": 4, "nanosec": 5}}}'
    both = one_channel_mcap("json", None, [stamped, b"{}"])
    messages, report = read(tmp_path, both, LogConfig(clock="header"))
    assert [m.time_ns for m in messages] == [4 * SECOND + 5, 1]
    assert report.without_stamp == 1
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
        *(({"stamp": {"sec": wrong, "nsec": 0}}, None) for wrong in (1.5, 10**12, -5)),
    ],
)
def test_a_stamp_in_a_message(tmp_path, payload, expected):
    data = one_channel_mcap("json", None, [orjson.dumps(payload)])
    ((message,), report) = read(tmp_path, data, LogConfig(clock="header"))
    assert (message.time_ns, report.without_stamp) == (expected or 0, expected is None)


def test_a_time_that_int64_cannot_hold(tmp_path):
    messages, report = read(tmp_path, json_mcap([1, 2**63, 2**63 - 1]))
    assert [m.time_ns for m in messages] == [1, 2**63 - 1]
    assert report.undecodable["/b"][0] == 1


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "log"),
        (b"time,lat,lon\n", "log"),
        (b"\xa3\x95\x80" + bytes(100), "log"),
        (b"\x89MCAP0", r"it begins with '\\x89MCAP0'"),
        (bytes(70_000), "log"),
    ],
)
def test_what_is_no_log(tmp_path, data, words):
    with pytest.raises(LogError, match=words):
        read(tmp_path, data)


def body(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def declared(sizes):
    """Return channels, each with a schema of so many bytes of its own."""
    channels = Channels(Summary(), str)
    for k, size in enumerate(sizes, 1):
        text = f"float64 x{k:04d}".encode().ljust(size)
        about = {"topic": f"/t{k}", "message_encoding": "ros1", "metadata": {}}
        channels.declare(3, body(Schema(id=k, name="p/A", encoding="ros1msg", data=text)))
        channels.declare(4, body(Channel(id=k, schema_id=k, **about)))
    return channels


def test_the_schemas_of_a_log_are_parsed_up_to_a_megabyte_and_further_ones_are_refused():
    channels = declared([MOST_SCHEMA] * 4 + [20])
    *decoders, last = [channels.sink(k).decode for k in range(1, 6)]
    assert all(map(callable, decoders))
    assert last == "the schemas of this log have more than 1048576 bytes"
    channels = declared([MOST_DECLARED - 1000])
    with pytest.raises(BudgetError, match="all schemas and channels"):
        channels.declare(3, body(Schema(id=9, name="p/B", encoding="ros1msg", data=bytes(1000))))
