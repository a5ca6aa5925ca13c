"""What a damaged MCAP says of its losses, and what no checksum covers."""

import struct

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from replay_kit.core.message import Loss
from replay_kit.results.losses import loss_json, loss_words, unchecked_lines
from tests.logs.log_samples import SECOND, json_mcap
from tests.logs.mcap.test_broken_mcap import numbers, read, record_offsets

TIMES = [k * SECOND for k in range(1, 41)]


@pytest.mark.parametrize("which", [0, 2])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_lost_chunk_is_counted_in_messages_and_time(tmp_path, compression, which):
    whole = json_mcap(TIMES, compression)
    damaged, chunk = bytearray(whole), record_offsets(whole, Opcode.CHUNK)[which]
    damaged[chunk + 90] ^= 1
    messages, report = read(tmp_path, bytes(damaged))
    # the first chunk also holds what the channels are: the summary says it again
    assert report.undecodable == {}
    missing = sorted(set(range(40)) - set(numbers(messages)))
    (loss,) = report.losses
    assert (loss.offset, loss.messages) == (chunk, len(missing))
    assert 1 < len(missing) < 12
    assert (loss.first_ns, loss.last_ns) == (TIMES[missing[0]], TIMES[missing[-1]])
    assert f"{len(missing)} messages of 1970-01-01T" in loss_words(loss)


def test_what_a_cut_took_is_said_to_be_unknown(tmp_path):
    whole = json_mcap(TIMES)
    third = record_offsets(whole, Opcode.CHUNK)[2]
    _, report = read(tmp_path, whole[: third + 150])
    (loss,) = report.losses
    assert loss.messages is None
    assert loss_json(loss)["messages"] is None
    assert loss.first_ns == TIMES[len(read(tmp_path, whole[:third])[0])]
    assert "unknown number of messages" in loss_words(loss)


def test_a_cut_between_two_records_lost_nobody_knows_how_many(tmp_path):
    whole = json_mcap(TIMES)
    for opcode, n in ((Opcode.DATA_END, 0), (Opcode.CHUNK, 3)):
        cut = record_offsets(whole, opcode)[n]
        messages, report = read(tmp_path, whole[:cut])
        assert [(loss.offset, loss.bytes, loss.messages) for loss in report.losses] == [
            (cut, 0, None)
        ]
        assert len(messages) == (40 if opcode == Opcode.DATA_END else 17)


def test_what_no_checksum_covers_is_said(tmp_path):
    whole = json_mcap(TIMES, use_chunking=False)
    (line,) = unchecked_lines(read(tmp_path, whole)[1])
    begin = f"Without a checksum, so that damage cannot be detected: {tmp_path / 'log'}: "
    assert line == f"{begin}messages outside chunks, without a checksum (40)"
    assert (
        list(
            unchecked_lines(read(tmp_path, json_mcap(TIMES, use_chunking=False, data_crcs=True))[1])
        )
        == []
    )
    without = bytearray(json_mcap(TIMES))
    chunks = record_offsets(bytes(without), Opcode.CHUNK)
    for chunk in chunks:
        struct.pack_into("<I", without, chunk + 9 + 24, 0)
    assert list(unchecked_lines(read(tmp_path, bytes(without))[1])) == [
        f"{begin}chunks without a checksum ({len(chunks)})"
    ]


def test_a_time_outside_an_unchecked_chunks_span_is_left_out(tmp_path):
    damaged = bytearray(json_mcap(TIMES))
    chunk = record_offsets(bytes(damaged), Opcode.CHUNK)[1]
    struct.pack_into("<I", damaged, chunk + 9 + 24, 0)
    damaged[damaged.index(struct.pack("<Q", TIMES[8]), chunk + 60) + 7] ^= 0x40
    messages, report = read(tmp_path, bytes(damaged))
    assert numbers(messages) == [n for n in range(40) if n != 8]
    assert [(loss.messages, "outside its chunk's" in loss.what) for loss in report.losses] == [
        (1, True)
    ]


def test_words_of_a_loss():
    loss = Loss("cut", 10, 20, 3, 0, 1_500_000_000)
    assert (
        loss_words(loss)
        == "cut (20 bytes, from byte 10; 3 messages of 1970-01-01T00:00:00.000Z to 1970-01-01T00:00:01.500Z)"
    )
    assert loss_words(Loss("cut", 10, 20, 0, 0, 1)) == "cut (20 bytes, from byte 10; 0 messages)"
    assert loss_json(Loss("cut", 10, 20, 0, 0, 2**70))["last"].startswith("2262")
