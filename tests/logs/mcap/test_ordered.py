"""An MCAP with an index is read in the order of its log times, however its chunks are written; without one the window is named."""

import tracemalloc
from io import BytesIO

import orjson
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from replay_kit.logs import merge, open_log
from replay_kit.logs.mcap import ordered
from tests.command import run_command
from tests.measurements.carriers import json_mcap as of_rows
from tests.measurements.samples import fix, ping

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


def write(path, order, n=1200, topics=("/a", "/b", "/c"), size=20, **options):
    """Write messages of topics, a second apart, in another order than that of their times."""
    rows = sorted(
        ((order(k, n), t, k) for t in range(len(topics)) for k in range(n)),
        key=lambda row: (row[1], row[0]) if order is _by_topic else (row[0], row[1]),
    )
    out = BytesIO()
    writer = Writer(out, **({"chunk_size": 2000, "compression": CompressionType.ZSTD} | options))
    writer.start()
    schema = writer.register_schema("test.Number", "jsonschema", b"{}")
    channels = [writer.register_channel(topic, "json", schema) for topic in topics]
    writer.add_metadata("about", {"made": "by hand"})
    for place, (_, topic, k) in enumerate(rows):
        data = orjson.dumps({"n": k, "text": "x" * size})
        time_ns = START + k * SECOND + topic
        writer.add_message(channels[topic], time_ns, data, time_ns, place)
    writer.add_attachment(START, START, "note.txt", "text/plain", b"hello")
    writer.finish()
    path.write_bytes(out.getvalue())
    return path


@pytest.mark.parametrize("order", [_by_topic, _in_chunks_that_overlap, _shuffled])
@pytest.mark.parametrize("slices", [1, 30])
@pytest.mark.parametrize("chunk_size", [2000, 10**7])
def test_messages_come_in_order_of_log_time(tmp_path, monkeypatch, order, slices, chunk_size):
    path = write(tmp_path / "log.mcap", order, chunk_size=chunk_size)
    monkeypatch.setattr(ordered, "_SLICE", 300_000 // slices)
    log = open_log(path)
    found = list(log.messages())
    with path.open("rb") as file:
        expected = [
            (message.log_time, channel.topic, orjson.loads(message.data))
            for _, channel, message in make_reader(file).iter_messages(log_time_order=True)
        ]
    assert [(m.time_ns, m.topic, m.payload) for m in found] == expected
    assert log.report().losses == ()
    assert log.report().read == {"/a": 1200, "/b": 1200, "/c": 1200}
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


def test_a_copy_has_the_order_of_time(tmp_path):
    write(tmp_path / "log.mcap", _by_topic)
    assert run_command(tmp_path, "convert log.mcap -o out.mcap").returncode == 0
    with (tmp_path / "out.mcap").open("rb") as file:
        times = [m.log_time for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    assert len(times) == 3600
    assert times == sorted(times)


def test_a_damaged_chunk_is_lost_alone_and_a_clock_that_was_set_back_keeps_the_order_of_the_file(
    tmp_path,
):
    path = write(tmp_path / "log.mcap", _by_topic, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[data.index(b'{"n":700,')] ^= 1
    path.write_bytes(data)
    log = open_log(path)
    found = list(log.messages())
    (loss,) = log.report().losses
    assert loss.messages == 3600 - len(found)
    assert [m.time_ns for m in found] == sorted(m.time_ns for m in found)
    days = 86_400 * SECOND
    times = [START + k * SECOND - 3 * days * (k >= 300) for k in range(600)]
    from tests.logs.log_samples import json_mcap

    path.write_bytes(json_mcap(times))
    assert [m.time_ns for m in open_log(path).messages()] == times
    assert len(list(merge([open_log(path)], 1.0))) == 600


def test_memory_is_bounded_whatever_the_chunks(tmp_path, monkeypatch):
    path = write(tmp_path / "log.mcap", _by_topic, n=4000, size=900, chunk_size=50_000)
    monkeypatch.setattr(ordered, "_SLICE", 200_000)
    tracemalloc.start()
    count = sum(1 for _ in open_log(path).messages())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 12_000
    # ten megabytes of messages
    assert peak < 3_500_000


def test_without_an_index_the_loss_is_named_first_with_the_window_that_keeps_it(tmp_path):
    rows = [(k, "/adcp", "replay_kit.AdcpPing", ping(k).payload) for k in range(5, 1805, 60)]
    place = fix(0)
    rows += [(k, place.topic, place.schema, place.payload) for k in range(0, 1800, 60)]
    path = tmp_path / "log.mcap"
    path.write_bytes(of_rows(rows)[:-40])
    done = run_command(tmp_path, "info log.mcap")
    late = next(line for line in done.stdout.splitlines() if line.startswith("Late"))
    assert done.stdout.index(late) < done.stdout.index("Use: ")
    assert late.endswith("x /vehicle/fix; logs.reorder_window = 1745 keeps them")
    (tmp_path / "run.toml").write_text("[logs]\nreorder_window = 1745\n")
    done = run_command(tmp_path, "info log.mcap --config run.toml")
    assert "Late" not in done.stdout
