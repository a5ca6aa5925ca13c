"""Small logs made in memory for the tests of the readers."""

import struct
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import orjson
from mcap.writer import CompressionType, Writer
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.config.run import LogConfig
from replay_kit.core.message import LogReport, Message
from replay_kit.logs import open_log
from tests.places import DATA

SHARED = DATA / "logs"
SECOND = 1_000_000_000


def json_mcap(
    times_ns: Sequence[int],
    compression: CompressionType = CompressionType.NONE,
    chunk_size: int = 400,
    **options: Any,
) -> bytes:
    """Return an MCAP file of JSON messages ``{"n": 0}``, ``{"n": 1}``, ... on /a and /b in turn; options are those of its writer."""
    out = BytesIO()
    writer = Writer(out, chunk_size=chunk_size, compression=compression, **options)
    writer.start()
    schema = writer.register_schema("test.Number", "jsonschema", b"{}")
    channels = [writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")]
    for n, time_ns in enumerate(times_ns):
        payload = orjson.dumps({"n": n, "text": "x" * 20})
        writer.add_message(channels[n % 2], time_ns, payload, time_ns + 7, n)
    writer.finish()
    return out.getvalue()


def record_offsets(data: bytes, opcode: int) -> list[int]:
    """Return where the records of a kind begin in an MCAP file."""
    offsets, offset = [], 8
    while offset + 9 <= len(data):
        found, length = struct.unpack_from("<BQ", data, offset)
        if found == opcode:
            offsets.append(offset)
        offset += 9 + length
    return offsets


def one_channel_mcap(
    encoding: str, schema: tuple[str, str, bytes] | None, payloads: Sequence[bytes]
) -> bytes:
    """Return an MCAP file with one channel /x; schema is (name, encoding, data)."""
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    schema_id = writer.register_schema(*schema) if schema else 0
    channel = writer.register_channel("/x", encoding, schema_id)
    for n, payload in enumerate(payloads):
        writer.add_message(channel, log_time=n, data=payload, publish_time=n)
    writer.finish()
    return out.getvalue()


def tlog_entry(stamp_us: int, message: Any, version: int = 2, system: int = 1) -> bytes:
    """Return one entry of a telemetry log."""
    sender = dialect.MAVLink(None, srcSystem=system, srcComponent=1)
    return stamp_us.to_bytes(8, "big") + bytes(message.pack(sender, force_mavlink1=version == 1))


def attitude(boot_ms: int) -> Any:
    """Return an ATTITUDE message, its time since boot telling it from others."""
    return dialect.MAVLink_attitude_message(boot_ms, 0.1, -0.2, 1.5, 0.0, 0.0, 0.25)


def tlog(n: int) -> list[bytes]:
    """Return the entries of a telemetry log, one a second."""
    stamps = (1_700_000_000_000_000 + 1_000_000 * k for k in range(n))
    return [tlog_entry(stamp, attitude(k), 1 + k % 2) for k, stamp in enumerate(stamps)]


def read_log(
    folder: Path, data: bytes, config: LogConfig | None = None, wanted: frozenset[str] | None = None
) -> tuple[list[Message], LogReport]:
    """Return the messages of a log with these bytes, and its report."""
    file = folder / "log"
    file.write_bytes(data)
    reader = open_log(file, 1, config, wanted)
    return list(reader.messages()), reader.report()
