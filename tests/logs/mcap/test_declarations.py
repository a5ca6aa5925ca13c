"""What the schemas and channels of a log may cost in all."""

from collections.abc import Callable

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Schema

from replay_kit.logs.decode.budget import MOST_DECLARED, MOST_SCHEMA, BudgetError
from replay_kit.logs.mcap.summary import Channels, Summary


def body(record):
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def declared(sizes):
    """Return channels, each with a schema of so many bytes of its own."""
    channels = Channels(Summary({}, {}, (), ()), str)
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
    assert (
        decoders[4]
        == "the schemas of this log have more than the 1048576 bytes that are parsed of one log"
    )


def test_channels_of_one_schema_share_a_decoder():
    channels = declared([20])
    channels.declare(
        4, body(Channel(id=2, topic="/again", message_encoding="ros1", metadata={}, schema_id=1))
    )
    assert channels.sink(1).decode is channels.sink(2).decode


def test_a_log_that_declares_too_much_is_refused_further_declarations():
    channels = declared([MOST_DECLARED - 1000])
    with pytest.raises(BudgetError, match="all schemas and channels"):
        channels.declare(3, body(Schema(id=9, name="p/B", encoding="ros1msg", data=bytes(1000))))
