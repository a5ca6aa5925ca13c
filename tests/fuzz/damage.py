"""Logs cut and with single bits flipped: what must come of them, checked against the sound file.

The oracle reads the sound file with the stock ``mcap`` library and with the lengths of its records alone, so that it shares
nothing with the reader under test.
"""

import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, McapRecord, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from replay_kit.core.errors import LogError
from replay_kit.core.message import LogReport
from replay_kit.logs.mcap.reader import McapReader
from tests.places import ROOT

#: Topic, log time, publish time, sequence, payload.
Said = tuple[str, int, int, int, bytes]


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
    """Return the MCAP logs of this machine: the samples, and the shared ones where they are."""
    return sorted(
        [
            *(ROOT / "sample_logs").glob("*.mcap"),
            *(ROOT.parent / "shared" / "data" / "logs").rglob("*.mcap"),
        ]
    )


def damage(file: Path, count: int) -> list[str]:
    """Return what is wrong with reading a log that is cut, and has a bit flipped, at that many places each."""
    data = file.read_bytes()
    rng = np.random.default_rng(zlib.crc32(file.name.encode()))
    flips = [(place, int(rng.integers(8))) for place in places(len(data), count, seed=2)]
    return check_cuts(data, places(len(data), count, seed=1)) + check_flips(data, flips)


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
    from mcap.data_stream import RecordBuilder

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


def data_crc(data: bytes) -> bool:
    """Return whether a checksum covers all of the data section, or the summary says nothing that a flip could spoil."""
    for record in StreamReader(BytesIO(data), emit_chunks=True).records:
        if type(record).__name__ == "DataEnd":
            return bool(record.data_section_crc)
        if isinstance(record, Footer):
            return False
    return False


def read_raw(path: Path) -> tuple[list[Said], LogReport]:
    """Return what our reader gives of a file, undecoded."""
    reader = McapReader(path)
    said = [
        (m.topic, m.log_ns, m.publish_ns, m.sequence, bytes(m.data)) for m in reader.raw_messages()
    ]
    # the decoded way must end well too
    list(reader.messages())
    return said, reader.report()


def places(size: int, count: int, seed: int) -> list[int]:
    """Return that many places of a file [bytes]: its ends, and others by chance."""
    rng = np.random.default_rng(seed)
    some = {0, 7, 8, size - 1, size - 9, size // 2} | set(rng.integers(0, size, 2 * count).tolist())
    return sorted(
        rng.permutation(sorted(place for place in some if 0 <= place < size))[:count].tolist()
    )


def check_cuts(data: bytes, where: list[int]) -> list[str]:
    """Return what is wrong with what our reader makes of a file cut at some places; nothing, if all is well."""
    sound = sound_messages(data)
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        for cut in where:
            path.write_bytes(data[:cut])
            try:
                said, report = read_raw(path)
            except LogError:
                if cut >= 8:
                    wrong.append(f"cut at {cut}: refused although the magic bytes are there")
                continue
            whole = [message.said for message in sound if message.end <= cut]
            if said[: len(whole)] != whole:
                wrong.append(
                    f"cut at {cut}: {len(whole)} messages are whole before it, {len(said)} came"
                )
            if said != [message.said for message in sound[: len(said)]]:
                wrong.append(f"cut at {cut}: something came that the file does not say")
            if not report.losses:
                wrong.append(f"cut at {cut}: no loss said")
    return wrong


def check_flips(data: bytes, where: list[tuple[int, int]]) -> list[str]:
    """Return what is wrong with what our reader makes of a file with one bit flipped; nothing, if all is well.

    Args:
        data: The sound file.
        where: Byte and bit of each flip.
    """
    sound = sound_messages(data)
    all_said = Counter(message.said for message in sound)
    covered = data_crc(data)
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        for byte, bit in where:
            damaged = bytearray(data)
            damaged[byte] ^= 1 << bit
            path.write_bytes(damaged)
            name = f"bit {bit} of byte {byte}"
            try:
                said, report = read_raw(path)
            except LogError:
                if byte >= 8:
                    wrong.append(f"{name}: refused although the magic bytes are there")
                continue
            told = bool(report.losses or report.undecodable)
            before = Counter(
                message.said
                for message in sound
                if (message.unit_end if message.checked else message.end) <= byte
            )
            if before - Counter(said):
                wrong.append(
                    f"{name}: {(before - Counter(said)).total()} messages before it did not come"
                )
            new = Counter(said) - all_said
            inside_checked = any(
                message.checked and message.start <= byte < message.unit_end for message in sound
            )
            if new and inside_checked:
                wrong.append(
                    f"{name}: {new.total()} messages came wrong under a checksum: {next(iter(new))}"
                )
            if (new or all_said - Counter(said)) and not told and (covered or inside_checked):
                wrong.append(f"{name}: messages changed or went without a word")
            if all_said - Counter(said) and not new and not told:
                wrong.append(
                    f"{name}: {(all_said - Counter(said)).total()} messages went without a word"
                )
    return wrong
