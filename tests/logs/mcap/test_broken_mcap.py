"""Broken MCAP files: what is whole under a checksum comes, and what is lost is told; random damage is in ``tests/fuzz``."""

import struct
import tracemalloc
import zlib

import pytest
import zstandard
from mcap.opcode import Opcode

from replay_kit.logs import open_log
from replay_kit.logs.mcap.index import MAX_CONTENTS
from replay_kit.logs.mcap.records import MAGIC, MAX_SIZE
from replay_kit.results.losses import loss_json, loss_words
from tests.logs.log_samples import SECOND, json_mcap, record_offsets
from tests.logs.log_samples import read_log as read
from tests.places import SAMPLES

TIMES = [k * SECOND for k in range(1, 41)]
CHUNKED = json_mcap(TIMES)
PLAIN = json_mcap(TIMES, use_chunking=False, enable_data_crcs=True)
CHUNKS = record_offsets(CHUNKED, Opcode.CHUNK)
END = record_offsets(CHUNKED, Opcode.DATA_END)[0]
THIRD, THIRD_HOLDS = CHUNKS[2], set(range(11, 17))


def numbers(messages):
    return [m.payload["n"] for m in messages]


def changed(data, *changes):
    """Return a file with bytes at offsets changed."""
    damaged = bytearray(data)
    for at, value in changes:
        damaged[at] = value
    return bytes(damaged)


def chunk_record(data, claimed, compression=b"", crc=0):
    head = struct.pack("<QQQII", 0, 0, claimed, crc, len(compression)) + compression
    body = head + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def with_chunk_first(chunk):
    """Return the file with one more chunk, and without a summary, whose offsets would no longer be true."""
    tail = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
    tail += struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MAGIC
    return CHUNKED[: CHUNKS[0]] + chunk + CHUNKED[CHUNKS[0] : END] + tail


#: Each third byte of the third chunk and its indexes wrong, then its checksum and contents, then most of its head.
WRONG = [[(at, CHUNKED[at] ^ 0xFF)] for at in range(THIRD, CHUNKS[3], 3)]
WRONG += [[*((THIRD + 33 + k, 0) for k in range(4)), (THIRD + 52, 0xFF)]]
WRONG += [[(THIRD + k, 0) for k in range(25, 49)]]


@pytest.mark.parametrize("end", [None, END], ids=["with a summary", "without an end"])
def test_what_is_whole_comes_and_the_loss_is_counted(tmp_path, end):
    for changes in WRONG:
        found, report = read(tmp_path, changed(CHUNKED, *changes)[:end])
        lost = {*range(40)} - {*numbers(found)}
        assert lost in (set(), THIRD_HOLDS)
        # the chunk may hold what the channels are: the summary says it again
        assert report.undecodable == {}
        # opcode and length: what they say is made good, and told
        assert report.losses or not (lost or end or changes[0][0] < THIRD + 9)
        if lost:
            loss = report.losses[0]
            # without a summary nothing says how many a chunk held
            assert (loss.offset, loss.messages) == (THIRD, None if end else 6)
            if not (end and changes is WRONG[-1]):
                assert (loss.first_ns, loss.last_ns) == (TIMES[11], TIMES[16])
                assert "messages of 1970-01-01T" in loss_words(loss)


@pytest.mark.parametrize("cut", [150, 0])
def test_what_a_cut_took_is_said_to_be_unknown(tmp_path, cut):
    found, report = read(tmp_path, CHUNKED[: THIRD + cut])
    (loss,) = report.losses
    # of a cut chunk no checksum says which of its messages are sound
    assert numbers(found) == list(range(11))
    assert (loss.offset, loss.bytes, loss.messages) == (THIRD, cut, None)
    assert loss_json(loss)["messages"] is None
    assert loss.first_ns == (TIMES[11] if cut else None)
    assert "unknown number of messages" in loss_words(loss)


def test_a_question_about_a_cut_log_does_not_forget_what_a_pass_has_lost(tmp_path):
    path, whole = tmp_path / "cut.mcap", (SAMPLES / "glider.mcap").read_bytes()
    path.write_bytes(whole[: len(whole) * 9 // 10])
    with open_log(path) as log:
        found = log.messages()
        next(found)
        assert log.is_gliders()
        assert 1 + len([*found]) == sum(log.report().read.values())
        assert log.report().losses


def test_messages_outside_chunks_are_verified_by_the_checksum_of_their_section(tmp_path):
    assert read(tmp_path, PLAIN)[1].unchecked == {}
    damaged = changed(PLAIN, (record_offsets(PLAIN, Opcode.MESSAGE)[3] + 9, 7))
    for data in (damaged, json_mcap(TIMES, use_chunking=False)):
        words = {"messages outside chunks, without a checksum": 40}
        assert read(tmp_path, data)[1].unchecked == words


def test_chunks_without_a_checksum_are_counted(tmp_path):
    without = changed(CHUNKED, *((chunk + 33 + k, 0) for chunk in CHUNKS for k in range(4)))
    assert read(tmp_path, without)[1].unchecked == {"chunks without a checksum": len(CHUNKS)}
    # a time outside the span that the chunk states
    at = without.index(struct.pack("<Q", TIMES[8]), CHUNKS[1] + 60) + 7
    found, report = read(tmp_path, changed(without, (at, 0x40)))
    assert (len(found), [loss.messages for loss in report.losses]) == (34, [6])
    assert "outside the span that it states" in report.losses[0].what


ZEROS = zstandard.compress(bytes(1 << 26))


@pytest.mark.parametrize(
    "chunk",
    [
        chunk_record(b"", MAX_SIZE + 1),
        chunk_record(ZEROS, MAX_CONTENTS + 1, b"zstd"),
        chunk_record(ZEROS, 1000, b"zstd"),
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
        # a message too short, and another kind of record where no checksum covers it
        chunk_record(struct.pack("<BQ", Opcode.MESSAGE, 21) + bytes(21), 30, crc=1),
        chunk_record(struct.pack("<BQ", Opcode.METADATA, 0), 9),
    ],
)
def test_a_chunk_that_claims_too_much_is_not_allocated(tmp_path, chunk):
    data = with_chunk_first(chunk)
    tracemalloc.start()
    messages, report = read(tmp_path, data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert numbers(messages) == list(range(40))
    assert [loss.bytes for loss in report.losses] == [len(chunk)]
    assert "chunk skipped" in report.losses[0].what
    assert peak < 20_000_000


def test_what_is_spent_on_checksums_is_bounded_by_the_size_of_the_file(tmp_path, monkeypatch):
    checked = []
    crc = zlib.crc32
    monkeypatch.setattr(
        "replay_kit.logs.mcap.index.zlib.crc32",
        lambda *given: checked.append(len(given[0])) or crc(*given),
    )
    claim = struct.pack("<BQQQQIIQ", Opcode.CHUNK, 50_041, 0, 0, 50_000, 7, 0, 50_000)
    data = MAGIC + b"\xff" + 5000 * claim + bytes(60_000)
    assert read(tmp_path, data)[1].losses
    assert sum(checked) < 70 * len(data)


def test_many_losses_are_summed(tmp_path):
    chunk = chunk_record(b"abc", 4)
    _, report = read(tmp_path, with_chunk_first(chunk * 50))
    assert len(report.losses) == 21
    assert report.losses[-1].what.startswith("30 further")
    assert sum(loss.bytes for loss in report.losses) == 50 * len(chunk)
