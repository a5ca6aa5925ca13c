"""Oracles of logs: what a sound file holds by the rules of its format alone, and what our readers make of any file.

Those of MCAP use the stock ``mcap`` library and the lengths of records, those of a telemetry log pymavlink's own parser, frame by frame,
those of other formats their lengths and checksums: none shares anything with the readers under test.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import breakup_chunk
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.message import LogReport
from replay_kit.logs import open_log
from replay_kit.logs.mavlink.reader import TlogReader
from replay_kit.logs.mcap.reader import McapReader
from tests.places import ROOT
from tests.reference.adcp_records import slow_records

#: Topic, log time, publish time, sequence, payload.
Said = tuple[str, int, int, int, bytes]
#: Start, end, and what the piece says; None of a piece that says nothing itself.
Piece = tuple[int, int, Any]


class Sound(NamedTuple):
    """One message of a sound MCAP file, where its record or the chunk with it begins and ends, and whether a checksum covers it."""

    said: Said
    start: int
    end: int
    checked: bool


def logs() -> list[Path]:
    """Return the logs of this machine: the samples, and the shared ones where they are."""
    shared = ROOT.parent / "shared" / "data" / "logs"
    found = [*(ROOT / "sample_logs").iterdir(), *shared.rglob("*")]
    return sorted(path for path in found if path.suffix in (".mcap", ".tlog", ".BIN"))


def sound_messages(data: bytes) -> list[Sound]:
    """Return the messages of a sound file, in its order."""
    topics: dict[int, str] = {}
    found: list[Sound] = []
    for opcode, start, end in _records(data):
        stream, checked = ReadDataStream(BytesIO(data[start + 9 : end])), False
        records: list[Any] = []
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(stream)
            records, checked = breakup_chunk(chunk), chunk.uncompressed_crc != 0
        elif opcode == Opcode.CHANNEL:
            records = [Channel.read(stream)]
        elif opcode == Opcode.MESSAGE:
            records = [Message.read(stream, end - start - 9)]
        topics |= {record.id: record.topic for record in records if isinstance(record, Channel)}
        for one in records:
            if isinstance(one, Message):
                times = one.log_time, one.publish_time, one.sequence
                said = topics[one.channel_id], *times, bytes(one.data)
                found.append(Sound(said, start, end, checked))
    return found


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, start, end) of the records of the data section, to its end or the file's."""
    offset = 8
    while offset < len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        yield opcode, offset, offset + 9 + length
        offset += 9 + length


def read_raw(path: Path) -> tuple[list[Said], LogReport]:
    """Return what our reader gives of an MCAP file, undecoded; the decoded way must end well too."""
    reader = McapReader(path)
    said = [
        (m.topic, m.log_ns, m.publish_ns, m.sequence, bytes(m.data)) for m in reader.raw_messages()
    ]
    list(reader.messages())
    return said, reader.report()


def frames(data: bytes) -> list[Piece]:
    """Return the entries of a telemetry log that pymavlink's parser takes, found by trying at every byte."""
    parser, found, at = dialect.MAVLink(None), [], 0
    while at + 8 < len(data):
        piece = _frame(parser, data, at)
        end = at + 8 + len(piece) if piece else at + 1
        if piece:
            found.append((at, end, piece))
        at = end
    return found


def _frame(parser: dialect.MAVLink, data: bytes, at: int) -> bytes | None:
    markers = dialect.PROTOCOL_MARKER_V1, dialect.PROTOCOL_MARKER_V2
    # stamps of this century
    if data[at] != 0 or data[at + 1] > 0x20 or data[at + 8] not in markers:
        return None
    second = data[at + 8] == dialect.PROTOCOL_MARKER_V2
    least = 12 if second else 8
    if len(data) < at + 8 + least:
        return None
    signed = second and data[at + 10] & dialect.MAVLINK_IFLAG_SIGNED
    piece = data[at + 8 : at + 8 + data[at + 9] + least + (13 if signed else 0)]
    try:
        message = parser.decode(bytearray(piece))
    except dialect.MAVError:
        return None
    # of a message that the parser does not know it cannot check the checksum
    return None if isinstance(message, dialect.MAVLink_unknown) else piece


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
    second = frame[0] == dialect.PROTOCOL_MARKER_V2
    return int.from_bytes(frame[7:10], "little") if second else frame[5]


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


def read_messages(path: Path) -> tuple[list[str], LogReport]:
    """Return the messages of a log as text, and its report."""
    log = open_log(path)
    return [f"{message.schema} {message.payload}" for message in log.messages()], log.report()


def read_pings(path: Path) -> tuple[list[Any], LogReport]:
    """Return the velocities of the pings of a raw ADCP file [mm/s]."""
    log = open_log(path)
    pings = [message.payload["velocity"] for message in log.messages() if message.topic == "/adcp"]
    said = [
        [[None if value is None else round(1000 * value) for value in cell] for cell in ping]
        for ping in pings
    ]
    return said, log.report()


def ensembles(data: bytes) -> list[Piece]:
    """Return the PD0 ensembles of any bytes: start, end, and velocities [mm/s]."""
    found = []
    for at, end, kind in slow_records(data, nortek=False):
        body = data[at:end]
        if kind == 0:
            offsets = struct.unpack_from(f"<{body[5]}H", body, 6)
            blocks = {body[place : place + 2]: place for place in offsets}
            cells = body[blocks[b"\x00\x00"] + 9]
            values = np.frombuffer(body, "<i2", 4 * cells, blocks[b"\x00\x01"] + 2)
            found.append((at, end, _none_if_missing(values.reshape(cells, 4))))
    return found


def bursts(data: bytes) -> list[Piece]:
    """Return the AD2CP records of any bytes: start, end, and a burst's velocities in beam coordinates [mm/s]; None of other records."""
    found = []
    for at, end, kind in slow_records(data, nortek=True):
        what = None
        # a burst
        if kind == 0x15:
            cells = struct.unpack_from("<H", data, at + 40)[0] & 1023
            values = np.frombuffer(data, "<i2", 4 * cells, at + 86)
            what = _none_if_missing(values.reshape(4, cells).T)
        found.append((at, end, what))
    return found


def _none_if_missing(values: np.ndarray) -> list[list[int | None]]:
    return [[None if value == -32768 else int(value) for value in row] for row in values.tolist()]
