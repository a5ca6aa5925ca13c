"""An MCAP with an index is read in the order of its log times, however its chunks are written; without one the window is named."""

import struct
import tracemalloc

import orjson
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from replay_kit.logs import merge, open_log
from tests.logs.log_samples import json_mcap as numbers
from tests.logs.log_samples import record_offsets

START = 1_700_000_000 * 10**9
SECOND = 10**9


def _by_topic(k, n):
    return k


def _in_chunks_that_overlap(k, n):
    # blocks of forty, of which every second begins two hundred earlier
    block, within = divmod(k, 40)
    return (block - 5 * (block % 2)) * 40 + within


def _shuffled(k, n):
    return (k * 7919) % n


def write(path, order, n=1200, size=20, chunk_size=2000):
    """Write messages of three topics, a second apart, in another order than that of their times."""
    rows = [(k, topic) for topic in range(3) for k in range(n)]
    if order is not _by_topic:
        rows.sort(key=lambda row: order(row[0], n))
    with path.open("wb") as out:
        writer = Writer(out, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        writer.start()
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/a", "/b", "/c")]
        writer.add_metadata("about", {"made": "by hand"})
        for place, (k, topic) in enumerate(rows):
            data = orjson.dumps({"n": k, "text": "x" * size})
            time_ns = START + k * SECOND + topic
            writer.add_message(channels[topic], time_ns, data, time_ns, place)
        writer.add_attachment(START, START, "note.txt", "text/plain", b"hello")
        writer.finish()
    return path


@pytest.mark.parametrize("order", [_by_topic, _in_chunks_that_overlap, _shuffled])
@pytest.mark.parametrize("chunk_size", [2000, 10**7])
def test_messages_come_in_order_of_log_time(tmp_path, order, chunk_size):
    path = write(tmp_path / "log.mcap", order, chunk_size=chunk_size)
    log = open_log(path)
    found = list(log.messages())
    with path.open("rb") as file:
        expected = [
            (message.log_time, channel.topic, orjson.loads(message.data))
            for _, channel, message in make_reader(file).iter_messages(log_time_order=True)
        ]
    assert [(m.time_ns, m.topic, m.payload) for m in found] == expected
    assert (log.report().losses, log.report().unchecked) == ((), {})
    merged = merge([open_log(path)], 1.0)
    assert len(list(merged)) == 3600
    assert not merged.late
    # blocks, and what a copy takes, are the same
    blocks = [m for b in open_log(path).blocks(lambda *_: True) for m in b.messages]
    assert [(m.time_ns, m.topic) for m in blocks] == [(m.time_ns, m.topic) for m in found]
    extras = []
    raw = list(open_log(path).raw_messages(extras.append))
    assert [(m.log_ns, m.position) for m in raw] == [(m.time_ns, m.position) for m in found]
    assert sorted(type(extra).__name__ for extra in extras) == ["Attachment", "Metadata"]
    assert sorted(m.position for m in raw) == list(range(3600))


def test_a_damaged_message_index_leaves_no_message_out(tmp_path):
    whole = numbers([START + k * SECOND for k in range(60)])
    for index in record_offsets(whole, Opcode.MESSAGE_INDEX):
        # the first and the last time that it lists, a bit of hours and one of years
        (size,) = struct.unpack_from("<I", whole, index + 11)
        for at in (index + 15, index + 15 + size - 16):
            for bit in (44, 56):
                damaged = bytearray(whole)
                damaged[at + bit // 8] ^= 1 << bit % 8
                (tmp_path / "log.mcap").write_bytes(damaged)
                log = open_log(tmp_path / "log.mcap")
                assert len(list(log.messages())) == 60


def test_memory_is_bounded_whatever_the_chunks(tmp_path):
    # three hundred megabytes of messages
    path = write(tmp_path / "log.mcap", _by_topic, n=500, size=200_000, chunk_size=2_000_000)
    tracemalloc.start()
    times = [message.time_ns for message in open_log(path).messages()]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert times == sorted(times)
    assert len(times) == 1500
    assert peak < 240_000_000
