"""Messages put into an MCAP as other programs write them, and read back."""

from io import BytesIO
from pathlib import Path

import orjson
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer

from replay_kit.core.message import Message
from replay_kit.logs import open_log


def read_mcap(folder: Path, data: bytes) -> list[Message]:
    """Return the messages of an MCAP file, all of which must be decodable."""
    (folder / "log.mcap").write_bytes(data)
    reader = open_log(folder / "log.mcap")
    messages = list(reader.messages())
    assert reader.report().undecodable == {}
    assert reader.report().losses == ()
    return messages


def ros2_mcap(schema: str, definition: str, payloads, topic: str = "/x") -> bytes:
    """Return an MCAP of ROS 2 messages in CDR, one a second."""
    out = BytesIO()
    writer = Ros2Writer(out)
    registered = writer.register_msgdef(schema, definition)
    for second, payload in enumerate(payloads):
        writer.write_message(
            topic, registered, payload, log_time=second * 10**9, publish_time=second * 10**9
        )
    writer.finish()
    return out.getvalue()


def json_mcap(entries) -> bytes:
    """Return an MCAP of JSON messages; an entry is (time [s], topic, schema, payload as an object or as bytes)."""
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    channels = {}
    for second, topic, schema, payload in entries:
        if topic not in channels:
            guessed = writer.register_schema(schema, "jsonschema", b'{"type": "object"}')
            channels[topic] = writer.register_channel(topic, "json", guessed)
        data = payload if isinstance(payload, bytes) else orjson.dumps(payload)
        writer.add_message(
            channels[topic],
            log_time=int(second * 10**9),
            data=data,
            publish_time=int(second * 10**9),
        )
    writer.finish()
    return out.getvalue()
