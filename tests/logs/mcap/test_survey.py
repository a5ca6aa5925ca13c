"""MCAP files read in bulk and by their index, against the reader that takes message by message."""

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType

from replay_kit.config.run import LogConfig
from replay_kit.logs import open_log
from replay_kit.logs.mcap import index
from tests.fuzz.mishap import mishap
from tests.logs.log_samples import json_mcap

TIMES = [1_000 + 10 * n for n in range(300)]


def write(folder, data, **config):
    (folder / "log.mcap").write_bytes(data)
    return open_log(folder / "log.mcap", 2, LogConfig(**config))


def assert_alike(reader):
    """Compare the messages and the report of the one way with those of the other, and return them."""
    single, report = list(reader.messages()), reader.report()
    blocks = list(reader.blocks(lambda topic, schema: True))
    assert [message for block in blocks for message in block.messages] == single
    times = np.concatenate([block.time_ns for block in blocks]) if blocks else np.empty(0)
    assert times.tolist() == [message.time_ns for message in single]
    assert reader.report() == report
    return single, report


@pytest.mark.parametrize("clock", ["log", "publish", "header"])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_blocks_hold_what_single_messages_say(tmp_path, compression, clock):
    data = json_mcap(TIMES, compression)
    single, _ = assert_alike(write(tmp_path, data, clock=clock, remap={"/a": "/c"}))
    assert {message.topic for message in single} == {"/c", "/b"}
    told = 0
    for number in range(20):
        damaged = data[:8] + mishap(data[8:], number, 5).data
        _, report = assert_alike(write(tmp_path, damaged, clock=clock))
        told += bool(report.losses)
    assert told > 10
    for times in (TIMES, [2**63 + n for n in range(20)]):
        without = json_mcap(times, enable_crcs=False)
        _, report = assert_alike(write(tmp_path, without, clock=clock))
        assert report.unchecked["chunks without a checksum"] > 0


def test_of_a_topic_that_is_not_wanted_one_message_is_decoded_and_all_are_counted(tmp_path):
    reader = write(tmp_path, json_mcap(TIMES))
    single, report = list(reader.messages()), reader.report()
    blocks = list(reader.blocks(lambda *named: named == ("/b", "test.Number")))
    expected = [message for message in single if message.topic == "/b" or message.position == 0]
    assert [message for block in blocks for message in block.messages] == expected
    assert reader.report() == report
    assert sum(block.kind.size for block in blocks) == len(TIMES)


@pytest.fixture
def large(monkeypatch):
    """Small files count as large."""
    monkeypatch.setattr(index, "FEW_MESSAGES", 10)


@pytest.mark.parametrize(
    "times",
    [
        [t + 5 * (k % 7) for k, t in enumerate(TIMES)],
        # each chunk of five messages begins before all others end
        [10**6 * (k % 5) + (k // 5) for k in range(300)],
    ],
)
def test_an_overview_states_counts_and_times_and_has_first_messages_of_each_topic(
    tmp_path, large, times
):
    log = write(tmp_path, json_mcap(times, CompressionType.ZSTD), remap={"/a": "/c"})
    found = log.overview()
    assert not isinstance(found, str)
    for first, name in enumerate(("/c", "/b")):
        own = found.time_ns[found.kind == found.kinds.index((name, "test.Number"))]
        assert (own.min(), own.max()) == (min(times[first::2]), max(times[first::2]))
    assert (log.report().read, log.report().undecodable) == ({"/c": 150, "/b": 150}, {})
    # four chunks of some five messages each
    assert 10 < len(found.messages) < 40
    stamps = [message.time_ns for message in found.messages]
    assert sorted(times[: len(stamps)]) == stamps


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (json_mcap(TIMES)[:-20], "it has no index, or its end is missing"),
        (json_mcap(TIMES, repeat_channels=False), "does not declare all topics"),
        (json_mcap(TIMES, use_chunking=False), "does not locate the messages"),
        (json_mcap(TIMES, index_types=IndexType.NONE), "does not locate the messages"),
        (
            json_mcap(TIMES).replace(b'{"n":0', b'{"n":1', 1),
            "first chunks is damaged: its checksum does not match",
        ),
    ],
    ids=["cut", "no channels", "no chunks", "no indexes", "damaged"],
)
def test_an_index_that_says_too_little_is_told(tmp_path, large, data, words):
    found = write(tmp_path, data).overview()
    assert isinstance(found, str)
    assert words in found
