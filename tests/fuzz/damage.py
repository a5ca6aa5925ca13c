"""Oracles of logs: what a sound file holds by the rules of its format alone, and what our readers make of any file.

Those of MCAP use the stock ``mcap`` library and the lengths of records, those of a telemetry log pymavlink's own parser, frame by frame,
those of a DataFlash log the lengths that its FMT records state: none shares anything with the readers under test.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message
from mcap.stream_reader import breakup_chunk
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.message import LogReport
from replay_kit.logs.mavlink.dataflash import DataflashReader
from replay_kit.logs.mavlink.reader import TlogReader
from replay_kit.logs.mcap.reader import McapReader
from tests.places import ROOT

#: Topic, log time, publish time, sequence, payload.
Said = tuple[str, int, int, int, bytes]
#: Start, end, and the frame without its stamp, or the record.
Piece = tuple[int, int, bytes]


@dataclass(frozen=True)
class Sound:
    """One message of the sound file.

    Attributes:
        said: The message.
        end: Where the last byte needed to have it lies [bytes]: its own record's, or its chunk's when that is compressed.
        start: Where the record begins that holds it, its own or its chunk.
        unit_end: Where its chunk ends, whose checksum says nothing of a part; its own end when it stands outside chunks.
        checked: Whether a checksum covers it before it is delivered.
    """

    said: Said
    start: int
    end: int
    unit_end: int
    checked: bool


def logs() -> list[Path]:
    """Return the logs of this machine: the samples, and the shared ones where they are."""
    shared = ROOT.parent / "shared" / "data" / "logs"
    found = [
        *(ROOT / "sample_logs").iterdir(),
        *(path for kind in ("mcap", "tlog", "BIN") for path in shared.rglob(f"*.{kind}")),
    ]
    return sorted(path for path in found if path.suffix in (".mcap", ".tlog", ".BIN"))


def sound_messages(data: bytes) -> list[Sound]:
    """Return the messages of a sound file, in its order."""
    topics: dict[int, str] = {}
    found: list[Sound] = []
    for opcode, start, end in _records(data):
        body = data[start + 9 : end]
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(body)))
            topics[channel.id] = channel.topic
        elif opcode == Opcode.MESSAGE:
            message = Message.read(ReadDataStream(BytesIO(body)), len(body))
            found.append(Sound(_said(message, topics), start, end, end, False))
        elif opcode == Opcode.CHUNK:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            inside = end - len(chunk.data)
            for record in breakup_chunk(chunk):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                inside += 9 + len(_written(record)) if chunk.compression == "" else 0
                if isinstance(record, Message):
                    needed = inside if chunk.compression == "" else end
                    found.append(
                        Sound(
                            _said(record, topics), start, needed, end, chunk.uncompressed_crc != 0
                        )
                    )
    return found


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, start, end) of the records of the data section."""
    offset = 8
    while True:
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        yield opcode, offset, offset + 9 + length
        offset += 9 + length


def _written(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()[9:]


def _said(message: Message, topics: dict[int, str]) -> Said:
    return (
        topics[message.channel_id],
        message.log_time,
        message.publish_time,
        message.sequence,
        bytes(message.data),
    )


def read_raw(path: Path) -> tuple[list[Said], LogReport]:
    """Return what our reader gives of a file, undecoded."""
    reader = McapReader(path)
    said = [
        (m.topic, m.log_ns, m.publish_ns, m.sequence, bytes(m.data)) for m in reader.raw_messages()
    ]
    # the decoded way must end well too
    list(reader.messages())
    return said, reader.report()


def frames(data: bytes) -> list[Piece]:
    """Return the entries of a telemetry log that pymavlink's parser takes, found by trying at every byte."""
    parser, found, at = dialect.MAVLink(None), [], 0
    while at + 8 < len(data):
        piece = _frame(parser, data, at)
        if piece is None:
            at += 1
        else:
            found.append((at, at + 8 + len(piece), piece))
            at += 8 + len(piece)
    return found


def _frame(parser: dialect.MAVLink, data: bytes, at: int) -> bytes | None:
    # stamps of this century
    if (
        data[at] != 0
        or data[at + 1] > 0x20
        or data[at + 8] not in (dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2)
    ):
        return None
    second = data[at + 8] == dialect.PROTOCOL_MARKER_V2
    if len(data) < at + 8 + (12 if second else 8):
        return None
    signed = second and data[at + 10] & dialect.MAVLINK_IFLAG_SIGNED
    piece = data[at + 8 : at + 8 + data[at + 9] + (12 if second else 8) + (13 if signed else 0)]
    try:
        message = parser.decode(bytearray(piece))
    except dialect.MAVError:
        return None
    # of a message that the parser does not know it cannot check the checksum
    return None if isinstance(message, dialect.MAVLink_unknown) else piece


def records(data: bytes) -> list[Piece]:
    """Return the records of a sound DataFlash log."""
    lengths, found, at = {128: 89}, [], 0
    while at + 3 <= len(data) and data[at : at + 2] == b"\xa3\x95":
        kind = data[at + 2]
        end = at + lengths.get(kind, len(data) + 1)
        if end > len(data):
            break
        if kind == 128:
            lengths[data[at + 3]] = data[at + 4]
        found.append((at, end, data[at:end]))
        at = end
    return found


def read_frames(path: Path) -> tuple[list[bytes], LogReport]:
    """Return the frames that our reader finds and understands; decoding them must end well too.

    A frame of an unknown message, as a flipped id makes one, has no checksum that can be verified: it is counted as undecodable.
    """
    reader = TlogReader(path)
    decoded = sum(1 for _ in reader.messages())
    report = reader.report()
    said = [frame.data for frame in reader.frames()]
    known = [frame for frame in said if _message_id(frame) in dialect.mavlink_map]
    assert decoded == len(known)
    assert sum(count for count, _ in report.undecodable.values()) == len(said) - len(known)
    return known, report


def _message_id(frame: bytes) -> int:
    return (
        frame[7] | frame[8] << 8 | frame[9] << 16
        if frame[0] == dialect.PROTOCOL_MARKER_V2
        else frame[5]
    )


def read_dataflash(path: Path) -> tuple[list[str], LogReport]:
    """Return the records that our reader finds, as text, and its report."""
    reader = DataflashReader(path)
    return [f"{message.schema} {message.payload}" for message in reader.messages()], reader.report()
