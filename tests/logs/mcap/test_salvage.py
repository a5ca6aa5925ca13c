"""Where reading of a damaged MCAP file goes on, and what is said of messages that no checksum covers."""

import struct
import zlib
from io import BytesIO

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from replay_kit.logs.mcap.records import MAGIC
from replay_kit.logs.mcap.salvage import Salvage
from replay_kit.logs.mcap.summary import read_summary
from tests.logs.log_samples import json_mcap
from tests.logs.log_samples import read_log as read
from tests.logs.mcap.test_broken_mcap import chunk_record, numbers, record_offsets

CHUNKED = json_mcap(range(1000, 1040))
PLAIN = json_mcap(range(1000, 1040), use_chunking=False, data_crcs=True)
OUTSIDE, CUT = (
    "messages outside chunks, without a checksum",
    "messages of cut chunks, whose checksum cannot be verified",
)


def without_end(whole):
    """Return a file as it is after a power cut: without end and summary."""
    return whole[: record_offsets(whole, Opcode.DATA_END)[0]]


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def salvage(data):
    file = BytesIO(data)
    return Salvage(file, len(data), read_summary(file, len(data)))


@pytest.mark.parametrize(
    "whole", [PLAIN, without_end(PLAIN)], ids=["with a summary", "without an end"]
)
def test_after_a_lost_boundary_outside_chunks_all_other_messages_are_read(tmp_path, whole):
    messages = record_offsets(whole, Opcode.MESSAGE)
    damaged = bytearray(whole)
    damaged[messages[7] + 5] = 0x40
    found, report = read(tmp_path, bytes(damaged))
    assert numbers(found) == [n for n in range(40) if n != 7]
    loss = report.losses[0]
    assert (loss.offset, loss.bytes, loss.messages) == (
        messages[7],
        messages[8] - messages[7],
        None,
    )
    assert loss.what.endswith(f"reading resumes at byte {messages[8]}")
    # the checksum of the whole section cannot say which of them are sound
    assert report.unchecked == {OUTSIDE: 39}


@pytest.mark.parametrize(
    "whole", [CHUNKED, without_end(CHUNKED)], ids=["with a summary", "without an end"]
)
def test_an_index_that_is_said_to_be_a_chunk_costs_no_message(tmp_path, whole):
    damaged = bytearray(whole)
    # two topics: behind it the other index of the same chunk, which lists messages that are read
    damaged[record_offsets(whole, Opcode.MESSAGE_INDEX)[2]] = Opcode.CHUNK
    found, report = read(tmp_path, bytes(damaged))
    assert numbers(found) == list(range(40))
    assert [loss.messages for loss in report.losses] == ([0] if whole is CHUNKED else [0, None])


def test_a_length_that_is_too_small_or_too_large_by_a_few_bytes_costs_one_message(
    tmp_path,
):
    messages = record_offsets(PLAIN, Opcode.MESSAGE)
    for flip in (0x01, 0x10, 0x40):
        damaged = bytearray(PLAIN)
        damaged[messages[7] + 1] ^= flip
        found, report = read(tmp_path, bytes(damaged))
        assert set(numbers(found)) >= set(range(40)) - {7}
        assert report.losses


def test_a_sound_file_without_chunks_is_verified_by_the_checksum_of_its_section(
    tmp_path,
):
    assert read(tmp_path, PLAIN)[1].unchecked == {}
    assert read(tmp_path, without_end(PLAIN))[1].unchecked == {OUTSIDE: 40}
    damaged = bytearray(PLAIN)
    damaged[record_offsets(PLAIN, Opcode.MESSAGE)[3] + 9] ^= 1
    assert read(tmp_path, bytes(damaged))[1].unchecked == {OUTSIDE: 40}


@pytest.mark.parametrize("where", ["head", "data", "index"])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_the_chunk_after_one_that_lacks_bytes_is_read(tmp_path, compression, where):
    whole = without_end(json_mcap(range(1000, 1040), compression))
    chunks = record_offsets(whole, Opcode.CHUNK)
    index = next(at for at in record_offsets(whole, Opcode.MESSAGE_INDEX) if at > chunks[2])
    at = {"head": chunks[2] + 12, "data": chunks[2] + 80, "index": index + 20}[where]
    found, report = read(tmp_path, whole[:at] + whole[at + 3 :])
    lost = set() if where == "index" else set(range(11, 17))
    assert set(numbers(found)) == set(range(40)) - lost
    assert report.losses[0].messages is None


def test_a_chunk_whose_opcode_or_length_is_damaged_is_used_whole(tmp_path):
    whole = without_end(CHUNKED)
    chunks = record_offsets(whole, Opcode.CHUNK)
    for opcode, size in (
        (Opcode.CHUNK, 0x80),
        (Opcode.CHUNK, 0x01),
        (0x26, 0),
        (Opcode.METADATA, 0),
        (Opcode.CHANNEL, 0),
    ):
        damaged = bytearray(whole)
        damaged[chunks[2]] = opcode
        damaged[chunks[2] + 1] ^= size
        found, report = read(tmp_path, bytes(damaged))
        assert numbers(found) == list(range(40)), opcode
        assert [(loss.offset, loss.bytes, loss.messages) for loss in report.losses[:1]] == [
            (chunks[2], 9, 0)
        ]


def test_messages_of_a_cut_chunk_are_counted_as_unverified(tmp_path):
    chunks = record_offsets(CHUNKED, Opcode.CHUNK)
    found, report = read(tmp_path, CHUNKED[: chunks[2] + 250])
    assert len(found) > 11
    assert report.unchecked == {CUT: len(found) - 11}


def test_the_index_of_a_damaged_chunk_counts_when_a_record_follows_it(tmp_path):
    whole = without_end(CHUNKED)
    chunks = record_offsets(whole, Opcode.CHUNK)
    damaged = bytearray(whole)
    damaged[chunks[2] + 90] ^= 1
    assert read(tmp_path, bytes(damaged))[1].losses[0].messages == 6
    second = [at for at in record_offsets(whole, Opcode.MESSAGE_INDEX) if at > chunks[2]][1]
    damaged[second] = 0x77
    assert read(tmp_path, bytes(damaged))[1].losses[0].messages is None


def test_a_chunk_without_a_checksum_that_is_emptied_is_told(tmp_path):
    whole = without_end(CHUNKED)
    chunk = record_offsets(whole, Opcode.CHUNK)[2]
    damaged = bytearray(whole)
    # size, checksum, name of the compression and length of the data
    damaged[chunk + 25 : chunk + 49] = bytes(24)
    found, report = read(tmp_path, bytes(damaged))
    assert numbers(found) == [n for n in range(40) if n not in range(11, 17)]
    assert [(loss.what, loss.messages) for loss in report.losses[:1]] == [
        ("chunk holds fewer messages than its index lists", 6)
    ]


def test_a_number_of_messages_in_a_damaged_summary_is_not_believed(tmp_path):
    damaged = bytearray(CHUNKED)
    damaged[record_offsets(CHUNKED, Opcode.STATISTICS)[0] + 9 + 4] ^= 4
    found, report = read(tmp_path, bytes(damaged))
    assert len(found) == 40
    assert [loss.messages for loss in report.losses] == [0, None]
    assert report.losses[1].what == "the file states 17179869224 messages, 40 were found"


def test_a_record_begins_where_opcode_and_length_are_those_of_one():
    message, index = (
        record(Opcode.MESSAGE, bytes(22)),
        record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 16) + bytes(16)),
    )
    for data, end in (
        (message, 31),
        (record(Opcode.MESSAGE, bytes(21)), None),
        (message[:-1], None),
        (index, 31),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 15) + bytes(16)), None),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 32) + bytes(16)), None),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 16) + bytes(16 + 39)), 31 + 39),
        (record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, 16) + bytes(16 + 40)), None),
        (record(0x10, bytes(50)), None),
        (record(0, bytes(50)), None),
        (record(Opcode.FOOTER, bytes(20)) + MAGIC, 29),
        (record(Opcode.FOOTER, bytes(20)) + MAGIC + b"\x00", None),
    ):
        assert salvage(b"??" + data).begins_record(2) == (None if end is None else end + 2)


def test_three_records_are_a_chain_and_two_before_bad_bytes_are_none():
    message, footer = record(Opcode.MESSAGE, bytes(22)), record(Opcode.FOOTER, bytes(20))
    for data, chain in (
        (3 * message + b"bad bytes", True),
        (2 * message + b"bad bytes", False),
        (message, True),
        (message + footer + MAGIC, True),
        (message + footer + MAGIC[:-1], False),
        (b"bad bytes", False),
        (b"", False),
    ):
        assert salvage(data).begins_chain(0) is chain, data


def test_the_search_finds_chains_and_chunks_whose_checksum_fits():
    message = record(Opcode.MESSAGE, b"payload" * 4)
    contents = record(Opcode.SCHEMA, bytes(14)) + message
    good, bad = (
        chunk_record(contents, len(contents), crc=zlib.crc32(contents) + k) for k in (0, 1)
    )
    for data, place, outside in (
        (b"bad" + 3 * message + b"bad bytes", 3, None),
        (b"bad" + 2 * message + b"bad bytes", None, None),
        (b"bad" + good + b"bad bytes", 3, 3),
        (b"bad" + bad + b"bad bytes", None, None),
        (bytes(1 << 20) + good + b"bad bytes", 1 << 20, 1 << 20),
        (bytes((1 << 20) - 4) + 3 * message + b"bad", (1 << 20) - 4, None),
    ):
        search = salvage(data)
        assert (
            search.next_record(0, len(data), True),
            search.next_record(0, len(data), False),
        ) == (place, outside), data[:40]
    # nothing that begins at the end of the search or after it
    assert search.next_record(0, (1 << 20) - 4, True) is None


def test_what_is_spent_on_checksums_is_bounded_by_the_size_of_the_file():
    claims = 5000 * struct.pack("<BQQQQIIQ", Opcode.CHUNK, 50_041, 0, 0, 50_000, 7, 0, 50_000)
    data = claims + bytes(60_000)
    search = salvage(data)
    assert search.next_record(0, len(data), False) is None
    assert search.whole_chunk(0) is None
    assert search._left < 50_000
