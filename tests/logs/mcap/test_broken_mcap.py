"""Broken MCAP files: valid records and a Loss; random damage is in ``tests/fuzz``."""

import struct
import tracemalloc
import zlib

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from replay_kit.logs import open_log
from replay_kit.logs.mcap.records import MAGIC, MAX_CONTENTS, MAX_SIZE
from tests.logs.log_samples import json_mcap
from tests.logs.log_samples import read_log as read

SAMPLES = {
    "none": json_mcap(range(40)),
    "zstd": json_mcap(range(40), CompressionType.ZSTD),
    "lz4": json_mcap(range(40), CompressionType.LZ4),
    "one chunk": json_mcap(range(40), chunk_size=1 << 20),
    "unchunked": json_mcap(range(40), use_chunking=False, data_crcs=True),
}


def numbers(messages):
    return [m.payload["n"] for m in messages]


def chunk_record(data, claimed, compression=b"", crc=0):
    head = (
        struct.pack("<QQQII", 0, 0, claimed, crc, len(compression))
        + compression
        + struct.pack("<Q", len(data))
    )
    return struct.pack("<BQ", Opcode.CHUNK, len(head) + len(data)) + head + data


def with_chunk_first(whole, chunk):
    """Return a file with one more chunk, and without a summary, whose offsets would no longer be true."""
    first, end = record_offsets(whole, Opcode.CHUNK)[0], record_offsets(whole, Opcode.DATA_END)[0]
    tail = (
        struct.pack("<BQI", Opcode.DATA_END, 4, 0)
        + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)
        + MAGIC
    )
    return whole[:first] + chunk + whole[first:end] + tail


def record_offsets(data, opcode):
    offsets, offset = [], len(MAGIC)
    while offset + 9 <= len(data):
        found, length = struct.unpack_from("<BQ", data, offset)
        if found == opcode:
            offsets.append(offset)
        offset += 9 + length
    return offsets


@pytest.mark.parametrize("sample", ["none", "one chunk", "unchunked"])
def test_every_whole_record_before_the_cut_is_used(tmp_path, sample):
    whole = SAMPLES[sample]
    end = whole.index(b'{"n":25') + len(b'{"n":25,"text":""}') + 20
    messages, report = read(tmp_path, whole[:end])
    assert numbers(messages) == list(range(26))
    assert report.losses[0].offset == end
    messages, report = read(tmp_path, whole[: end - 1])
    assert numbers(messages) == list(range(25))
    assert 0 < report.losses[0].bytes < 100


def test_a_cut_compressed_chunk_gives_what_can_be_decompressed(tmp_path):
    whole = json_mcap(range(20_000), CompressionType.ZSTD, chunk_size=1 << 30)
    chunk = record_offsets(whole, Opcode.CHUNK)[0]
    (length,) = struct.unpack_from("<Q", whole, chunk + 1)
    messages, report = read(tmp_path, whole[: chunk + length // 2])
    assert 2000 < len(messages) < 18_000
    assert numbers(messages) == list(range(len(messages)))
    assert len(report.losses) == 1


def test_reading_goes_on_at_the_next_chunk_after_a_wrong_length(tmp_path):
    whole = SAMPLES["none"]
    chunks = record_offsets(whole, Opcode.CHUNK)
    damaged = bytearray(whole)
    damaged[chunks[2] + 6] = 0xFF
    messages, report = read(tmp_path, bytes(damaged))
    assert numbers(messages) == list(range(40))
    assert len(report.losses) == 1
    # the chunk's own lengths and checksum fit: nothing is lost but its length, and its index is read too
    index = next(at for at in record_offsets(whole, Opcode.MESSAGE_INDEX) if at > chunks[2])
    assert report.losses[0].what.endswith(f"reading resumes at byte {index}")
    assert (report.losses[0].offset, report.losses[0].bytes, report.losses[0].messages) == (
        chunks[2],
        9,
        0,
    )


def test_zeros_after_a_power_cut(tmp_path):
    whole = SAMPLES["none"]
    end = record_offsets(whole, Opcode.CHUNK)[3]
    messages, report = read(tmp_path, whole[:end] + bytes(100_000))
    assert numbers(messages) == list(range(len(messages)))
    assert [(loss.offset, loss.bytes) for loss in report.losses] == [(end, 100_000)]


@pytest.mark.parametrize(
    "chunk",
    [
        chunk_record(b"", MAX_SIZE + 1),
        chunk_record(zstandard.compress(bytes(1 << 26)), MAX_CONTENTS + 1, b"zstd"),
        chunk_record(zstandard.compress(bytes(1 << 26)), 1000, b"zstd"),
        chunk_record(
            zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1 << 26)),
            1000,
            b"zstd",
        ),
        chunk_record(b"not lz4", 1000, b"lz4"),
        chunk_record(b"abc", 3, b"brotli"),
        chunk_record(b"abc", 3, crc=zlib.crc32(b"abd")),
        chunk_record(b"abc", 4),
        chunk_record(b"", 5, b"\xff\xfe"),
    ],
)
def test_a_chunk_that_claims_too_much_is_not_allocated(tmp_path, chunk):
    data = with_chunk_first(SAMPLES["none"], chunk)
    tracemalloc.start()
    messages, report = read(tmp_path, data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert numbers(messages) == list(range(40))
    assert [loss.bytes for loss in report.losses] == [len(chunk)]
    assert "chunk skipped" in report.losses[0].what
    assert peak < 20_000_000


@pytest.mark.full
def test_memory_is_one_chunk(tmp_path):
    file = tmp_path / "log"
    file.write_bytes(json_mcap(range(60_000), chunk_size=100_000))
    reader = open_log(file)
    tracemalloc.start()
    count = sum(1 for _ in reader.messages())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 60_000
    assert file.stat().st_size > 3_000_000
    assert peak < 2_000_000


def test_many_losses_are_summed(tmp_path):
    chunk = chunk_record(b"abc", 4)
    _, report = read(tmp_path, with_chunk_first(SAMPLES["none"], chunk * 50))
    assert len(report.losses) == 21
    assert report.losses[-1].what.startswith("30 further")
    assert sum(loss.bytes for loss in report.losses) == 50 * len(chunk)
