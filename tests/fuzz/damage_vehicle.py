"""Telemetry and DataFlash logs cut and with single bits flipped, checked against the sound file.

The oracle of a telemetry log walks the sound file with pymavlink's own parser, frame by frame; that of a DataFlash log walks it by the
lengths that its own FMT records state. Neither shares anything with the readers under test.
"""

import tempfile
import zlib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.message import LogReport
from replay_kit.logs.dataflash.reader import DataflashReader
from replay_kit.logs.dataflash.records import read_records
from replay_kit.logs.mavlink.reader import TlogReader
from replay_kit.logs.shared.statistics import ReadStatistics
from tests.fuzz.damage import ROOT, places

#: Start, end, and the frame without its stamp, or the record.
Piece = tuple[int, int, bytes]


def logs() -> list[Path]:
    """Return the vehicle's logs of this machine: the samples, and the shared ones where they are."""
    shared = ROOT.parent / "shared" / "data" / "logs"
    return sorted(
        [*(ROOT / "sample_logs").glob("*.tlog"), *shared.rglob("*.tlog"), *shared.rglob("*.BIN")]
    )


def damage(file: Path, count: int) -> list[str]:
    """Return what is wrong with reading a log that is cut, and has a bit flipped, at that many places each."""
    data = file.read_bytes()
    rng = np.random.default_rng(zlib.crc32(file.name.encode()))
    tlog = file.suffix == ".tlog"
    pieces = frames(data) if tlog else records(data)
    read = read_frames if tlog else read_dataflash
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        for cut in places(len(data), count, seed=1):
            path.write_bytes(data[:cut])
            wrong += [
                f"cut at {cut}: {words}"
                for words in check(read(path), [p for p in pieces if p[1] <= cut], [], tlog)
            ]
        for byte in places(len(data), count, seed=2):
            damaged = bytearray(data)
            damaged[byte] ^= 1 << int(rng.integers(8))
            path.write_bytes(damaged)
            hit = [p for p in pieces if p[0] <= byte < p[1]]
            found = check(
                read(path),
                [p for p in pieces if p[1] <= byte],
                [p for p in pieces if p[0] > byte],
                tlog,
                hit,
            )
            wrong += [f"flip in byte {byte}: {words}" for words in found]
    return wrong


def check(
    read: tuple[list[bytes], LogReport],
    before: list[Piece],
    after: list[Piece],
    checked: bool,
    hit: Iterable[Piece] = (),
) -> list[str]:
    """Return what is wrong with what was read of a damaged file.

    Args:
        read: What came, and the report.
        before: What is whole before the damage, which must come first.
        after: What lies behind it: of a telemetry log all must come.
        checked: Whether checksums cover what came, so that nothing else may.
        hit: What the damage lies in.
    """
    said, report = read
    wrong = []
    if said[: len(before)] != [piece for _, _, piece in before]:
        wrong.append(f"{len(before)} are whole before it, and other ones came")
    if checked:
        known = Counter(piece for _, _, piece in (*before, *after, *hit))
        if new := Counter(said) - known:
            wrong.append(f"{new.total()} came that the file does not say")
        if missing := Counter(piece for _, _, piece in (*before, *after)) - Counter(said):
            wrong.append(f"{missing.total()} that are whole did not come")
        if Counter(piece for _, _, piece in hit) - Counter(said) and not (
            report.losses or report.undecodable
        ):
            wrong.append("one was lost without a word")
    return wrong


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


def read_dataflash(path: Path) -> tuple[list[bytes], LogReport]:
    """Return the records that our reader finds, as bytes of the file; decoding them must end well too."""
    reader = DataflashReader(path)
    list(reader.messages())
    said = []
    with path.open("rb") as file:
        for part in read_records(file, ReadStatistics()):
            lengths = [part.formats[kind].length for kind in part.type.tolist()]
            said += [
                bytes(part.data[at : at + length])
                for at, length in zip(part.start.tolist(), lengths, strict=True)
            ]
    return said, reader.report()
