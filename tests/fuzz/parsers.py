"""What is fuzzed: each parser that is ours takes any bytes, and ends with values or an error of its own kind."""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from replay_kit.core.errors import LogError
from replay_kit.logs.dataflash.reader import DataflashReader
from replay_kit.logs.decode.decoders import decode_json
from replay_kit.logs.decode.ros2idl import ros2msg_from_idl
from replay_kit.logs.mavlink.reader import TlogReader
from replay_kit.logs.mcap.reader import McapReader

CORPUS = Path(__file__).parent / "corpus"


@cache
def _file() -> Path:
    return Path(tempfile.mkdtemp(prefix="replay-kit-fuzz-")) / "log"


def mcap(data: bytes) -> None:
    """An MCAP: raw and decoded, and the two agree on how many messages there are."""
    _file().write_bytes(data)
    reader = McapReader(_file())
    try:
        raw = sum(1 for _ in reader.raw_messages())
        list(reader.messages())
    except LogError:
        return
    assert raw == sum(reader.report().read.values())


def tlog(data: bytes) -> None:
    """A telemetry log: frames and losses make up the file."""
    _file().write_bytes(data)
    reader = TlogReader(_file())
    list(reader.messages())
    lost = sum(loss.bytes for loss in reader.report().losses)
    assert 0 <= lost <= len(data)
    assert all(loss.offset + loss.bytes <= len(data) for loss in reader.report().losses[:20])


def dataflash(data: bytes) -> None:
    """A DataFlash log: as messages and as columns."""
    _file().write_bytes(data)
    reader = DataflashReader(_file())
    list(reader.messages())
    reader.tables()
    assert all(loss.offset >= 0 and loss.offset + loss.bytes <= len(data) for loss in reader.report().losses[:20])


def ros2idl(data: bytes) -> None:
    """The IDL of a ROS 2 message."""
    try:
        ros2msg_from_idl("pkg/msg/Name", data.decode("utf-8"))
    except ValueError:
        return


def json(data: bytes) -> None:
    """JSON with bare NaN and infinities."""
    try:
        value = decode_json(data)
    # the json library's own answer to deep nesting, which PAYLOAD_ERRORS holds
    except (ValueError, RecursionError):
        return
    assert isinstance(value, dict)


PARSERS: dict[str, Callable[[bytes], None]] = {"mcap": mcap, "tlog": tlog, "dataflash": dataflash, "ros2idl": ros2idl, "json": json}
