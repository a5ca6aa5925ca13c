"""MCAP files read in bulk and by their index, against the reader that takes message by message."""

from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from replay_kit.config.run import LogConfig
from replay_kit.logs.mcap import overview as overviews
from replay_kit.logs.mcap.contents import messages_alone, walk
from replay_kit.logs.mcap.reader import McapReader
from replay_kit.logs.mcap.records import chunk_contents, file_records, parse_chunk
from replay_kit.logs.shared.blocks import Overview, TopicExtent
from tests.logs.log_samples import json_mcap

TIMES = [1_000 + 10 * n for n in range(300)]


def write(folder, data):
    (folder / "log.mcap").write_bytes(data)
    return McapReader(folder / "log.mcap")


def first_contents(data):
    for record in file_records(BytesIO(data), 8, len(data)):
        if record.opcode == 6:
            return chunk_contents(parse_chunk(record.body))
    raise AssertionError


def test_columns_are_what_the_stock_reader_finds():
    data = json_mcap(TIMES, CompressionType.NONE, chunk_size=10**6)
    walked = walk(first_contents(data))
    found = walked.part
    stock = [
        message for _, _, message in make_reader(BytesIO(data)).iter_messages(log_time_order=False)
    ]
    for name, field in (
        ("channel", "channel_id"),
        ("sequence", "sequence"),
        ("log_ns", "log_time"),
        ("publish_ns", "publish_time"),
    ):
        assert found.head[name].tolist() == [getattr(message, field) for message in stock]
    contents = first_contents(data)
    bodies = [
        contents[start + 31 : stop]
        for start, stop in zip(found.offset.tolist(), found.stop.tolist(), strict=True)
    ]
    assert bodies == [message.data for message in stock]
    assert [opcode for opcode, _, _ in walked.declared] == [3, 4, 4]
    assert walked.end == len(contents)


@pytest.mark.parametrize("spoil", ["cut", "opcode", "short", "long"])
def test_the_walk_ends_where_no_whole_record_follows(spoil):
    contents = bytearray(first_contents(json_mcap(TIMES, CompressionType.NONE, chunk_size=10**6)))
    last = int(walk(bytes(contents)).part.offset[-1])
    if spoil == "cut":
        contents = contents[:-1]
    elif spoil == "opcode":
        contents[last] = 0x0F
    elif spoil == "short":
        contents = contents[:last] + b"\x05" + (21).to_bytes(8, "little") + bytes(21)
    else:
        contents[last + 1] += 1
    found = walk(bytes(contents), strict=True)
    assert found.part.offset.size == len(TIMES) - 1
    assert (found.end, found.short) == ((len(contents), [21]) if spoil == "short" else (last, []))
    with pytest.raises(ValueError, match="more than schemas, channels and messages"):
        messages_alone(bytes(contents))
    # the shortest that is whole has no payload
    shortest = bytes(contents[:last] + b"\x05" + (22).to_bytes(8, "little") + bytes(22))
    assert walk(shortest).part.offset.size == len(TIMES)


def both(reader, wanted=lambda topic, schema: True):
    """The messages and report of the one way, and of the other."""
    single, report = list(reader.messages()), reader.report()
    blocks = list(reader.blocks(wanted))
    return single, report, blocks, reader.report()


@pytest.mark.parametrize("clock", ["log", "publish", "header"])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_blocks_hold_what_single_messages_say(tmp_path, compression, clock):
    reader = write(tmp_path, json_mcap(TIMES, compression))
    reader = McapReader(tmp_path / "log.mcap", 2, LogConfig(clock=clock, remap={"/a": "/c"}))
    single, report, blocks, again = both(reader)
    assert [message for block in blocks for message in block.messages] == single
    assert {message.topic for message in single} == {"/c", "/b"}
    assert np.concatenate([block.time_ns for block in blocks]).tolist() == [
        message.time_ns for message in single
    ]
    assert again == report


def test_of_a_topic_that_is_not_wanted_one_message_is_decoded_and_all_are_counted(tmp_path):
    reader = write(tmp_path, json_mcap(TIMES))
    single, report, blocks, again = both(
        reader, lambda topic, schema: (topic, schema) == ("/b", "test.Number")
    )
    expected = [message for message in single if message.topic == "/b" or message.position == 0]
    assert [message for block in blocks for message in block.messages] == expected
    assert again == report
    assert sum(block.kind.size for block in blocks) == len(TIMES)


def test_a_sample_is_the_first_message_that_can_be_decoded(tmp_path):
    out = BytesIO()
    writer = Writer(out)
    writer.start()
    number = writer.register_channel("/a", "json", writer.register_schema("S", "jsonschema", b""))
    for n, payload in enumerate((b"{", b'{"n": 1}', b"{")):
        writer.add_message(number, n, payload, n)
    lost = writer.register_channel("/b", "unheard of", 0)
    writer.add_message(lost, 3, b"", 3)
    writer.finish()
    reader = write(tmp_path, out.getvalue())
    (block,) = reader.blocks(lambda topic, schema: False)
    assert [message.payload for message in block.messages] == [{"n": 1}]
    report = reader.report()
    assert report.read == {"/a": 3, "/b": 1}
    # the third was not tried
    assert {topic: count for topic, (count, _) in report.undecodable.items()} == {"/a": 1, "/b": 1}


def test_a_damaged_file_is_reported_in_the_same_words(tmp_path):
    data = json_mcap(TIMES, CompressionType.NONE)
    rng = np.random.default_rng(5)
    told = 0
    for place in rng.integers(8, len(data), 60).tolist():
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        single, report, blocks, again = both(write(tmp_path, bytes(damaged)))
        assert [message for block in blocks for message in block.messages] == single
        assert again == report
        told += bool(report.losses)
    assert told > 20


@pytest.mark.parametrize("times", [TIMES, [2**63 + n for n in range(20)]])
def test_chunks_without_a_checksum_and_times_that_cannot_be_are_treated_alike(tmp_path, times):
    out = BytesIO()
    writer = Writer(out, enable_crcs=False, chunk_size=300)
    writer.start()
    number = writer.register_channel("/a", "json", 0)
    for time in times:
        writer.add_message(number, time, b"{}", time)
    writer.finish()
    single, report, blocks, again = both(write(tmp_path, out.getvalue()))
    assert [message for block in blocks for message in block.messages] == single
    assert again == report
    assert report.unchecked["chunks without a checksum"] > 0


@pytest.fixture
def large(monkeypatch):
    """Small files count as large."""
    monkeypatch.setattr(overviews, "FEW_MESSAGES", 10)


def test_an_overview_states_counts_and_times_and_has_first_messages_of_each_topic(tmp_path, large):
    times = [t + 5 * (k % 7) for k, t in enumerate(TIMES)]
    reader = write(tmp_path, json_mcap(times, CompressionType.ZSTD))
    single = list(reader.messages())
    found = McapReader(tmp_path / "log.mcap", 0, LogConfig(remap={"/a": "/c"})).overview()
    assert isinstance(found, Overview)
    for topic, name in (("/a", "/c"), ("/b", "/b")):
        stamps = [message.time_ns for message in single if message.topic == topic]
        assert found.topics[name] == TopicExtent("test.Number", 150, min(stamps), max(stamps))
    assert found.messages == 300
    # four chunks of some five messages each
    first = sorted(single[: len(found.first)], key=lambda message: message.time_ns)
    assert [message.payload for message in found.first] == [message.payload for message in first]
    assert 10 < len(found.first) < 40
    assert found.undecodable == {}


def test_a_hundred_messages_of_each_topic_are_enough(tmp_path, large):
    found = write(tmp_path, json_mcap(TIMES, chunk_size=10**6)).overview()
    assert [message.payload["n"] for message in found.first] == list(range(200))


def test_chunks_that_overlap_leave_times_open_rather_than_wrong(tmp_path, large):
    # each chunk of five messages begins before all others end
    times = [10**6 * (k % 5) + (k // 5) for k in range(300)]
    found = write(tmp_path, json_mcap(times)).overview()
    assert {(topic.first_ns, topic.last_ns) for topic in found.topics.values()} <= {
        (None, None)
    } | {(min(times[n::2]), max(times[n::2])) for n in (0, 1)}
    joined = TopicExtent("S", 2, 5, 9).joined(TopicExtent("T", 3, 4, 7))
    assert joined == TopicExtent("S", 5, 4, 9)
    assert joined.joined(TopicExtent("S", 1, None, 11)) == TopicExtent("S", 6, None, 11)


def sizes(**options):
    out = BytesIO()
    writer = Writer(out, chunk_size=200, **options)
    writer.start()
    number = writer.register_channel("/a", "json", 0)
    for n in range(50):
        writer.add_message(number, n, b"{}", n)
    writer.finish()
    return out.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (sizes()[:-20], "it has no index, or its end is missing"),
        (sizes(use_statistics=False), "it has no index, or its end is missing"),
        (sizes(repeat_channels=False), "does not declare all topics"),
        (sizes(use_chunking=False), "does not locate the messages"),
        (sizes(index_types=IndexType.NONE), "does not locate the messages"),
    ],
    ids=["cut", "no statistics", "no channels", "no chunks", "no indexes"],
)
def test_an_index_that_says_too_little_is_told(tmp_path, large, data, words):
    found = write(tmp_path, data).overview()
    assert isinstance(found, str)
    assert words in found


def test_a_damaged_first_chunk_is_told(tmp_path, large):
    data = bytearray(json_mcap(TIMES, CompressionType.NONE))
    data[data.index(b'{"n":0') + 3] ^= 1
    assert (
        "first chunks is damaged: its checksum does not match"
        in write(tmp_path, bytes(data)).overview()
    )


def test_an_index_has_log_times_alone(tmp_path, large):
    write(tmp_path, json_mcap(TIMES))
    assert McapReader(tmp_path / "log.mcap", 0, LogConfig(clock="publish")).overview() == (
        "the index holds log times alone, and the clock is publish"
    )


def test_a_small_file_is_read_whole_without_a_word(tmp_path, monkeypatch):
    reader = write(tmp_path, json_mcap(TIMES))
    assert reader.overview() == ""
    monkeypatch.setattr(overviews, "FEW_MESSAGES", 300)
    assert isinstance(reader.overview(), Overview)
    monkeypatch.setattr(overviews, "FEW_MESSAGES", 301)
    assert reader.overview() == ""
    monkeypatch.setattr(overviews, "FEW_BYTES", 1000)
    assert isinstance(reader.overview(), Overview)
