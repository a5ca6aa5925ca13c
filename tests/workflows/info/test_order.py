"""Late messages as ``merge`` counts them, and gaps, however the log is cut into blocks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.message import Message
from replay_kit.logs import merge
from replay_kit.logs.blocks import blocks_of
from replay_kit.workflows.info.listing import asks_for_replay, gap_lines
from replay_kit.workflows.info.reading import Order, TopicInfo

SECOND, DAY = 10**9, 86_400.0


@dataclass
class Said:
    """A log that says these messages."""

    said: list[Message]

    def messages(self):
        return iter(self.said)


def messages(times_s, topics="a"):
    return [
        Message(round(t * SECOND), topics[k % len(topics)], "S", {}, 0, k)
        for k, t in enumerate(times_s)
    ]


def ordered(said, size, window_s=1.0):
    order = Order(window_s)
    for begin in range(0, len(said), size):
        order.add(*blocks_of(said[begin : begin + size]))
    order.finish()
    return order.topics


def jittered(by_s):
    rng = np.random.default_rng(3)
    return 100.0 + 0.1 * np.arange(400) - by_s * (rng.random(400) < 0.2) * rng.random(400)


def set_back(twice):
    times = 1000.0 * DAY + np.arange(300.0)
    times[100:] -= 20.0 * DAY
    if twice:
        times[200:] -= 7.0 * DAY
        times[[50, 130]] -= 5.0
    return times


STRAY = 1000.0 * DAY + np.arange(300.0)
STRAY[[0, 5, 150]] += [90.0 * DAY, 400.0 * DAY, -30.0 * DAY]


@pytest.mark.parametrize("size", [1, 7, 64, 1000])
@pytest.mark.parametrize(
    ("times", "topics", "late"),
    [
        (jittered(0.0), "abc", False),
        (jittered(0.4), "abc", False),
        (jittered(3.0), "abc", True),
        (jittered(30.0), "abc", True),
        # a latched message's stamp stays as it is where it is far
        (STRAY, ("a", "config", "b"), False),
        (set_back(twice=False), "ab", False),
        (set_back(twice=True), "ab", True),
    ],
)
def test_late_messages_are_those_that_a_replay_leaves_out(size, times, topics, late):
    said = messages(times, topics)
    merged = merge([Said(said)], 1.0)
    kept = list(merged)
    found = ordered(said, size)
    assert {topic: info.late for topic, info in found.items() if info.late} == merged.late
    assert bool(merged.late) == late
    for topic, info in found.items():
        own, used = (
            [message.time_ns for message in each if message.topic == topic] for each in (said, kept)
        )
        # those that are late count for a topic's span, those set aside do not
        assert (info.first_ns, info.last_ns) == (min(own if times[0] < DAY else used), max(used))
        astray = merged.astray.get(topic, 0)
        assert len(used) + info.late + astray == len(own)


def test_a_message_as_old_as_the_window_is_not_late_and_a_nanosecond_more_is():
    for extra, late in ((0, 0), (1, 1)):
        times = [0, 10 * SECOND, 20 * SECOND, 10 * SECOND - extra]
        said = [Message(time, "a", "S", {}, 0, k) for k, time in enumerate(times)]
        assert ordered(said, 4)["a"].late == late


@pytest.mark.parametrize("size", [1, 2, 5, 100])
def test_the_longest_gap_is_counted_from_the_newest_message_before_it(size):
    # the message of 3 s comes after that of 10 s and shortens nothing
    found = ordered(messages([0.0, 1.0, 10.0, 3.0, 110.0, 112.0]), size, 1000.0)["a"]
    assert (found.gap_ns, found.gap_from_ns) == (100 * SECOND, 10 * SECOND)


@pytest.mark.parametrize(
    ("gap_s", "messages", "span_s", "stands_out"),
    [
        (60.0, 101, 600.0, True),
        (59.0, 101, 500.0, False),
        (60.0, 101, 601.0, False),
        (60.0, 1, 0.0, False),
    ],
)
def test_a_gap_stands_out_from_a_minute_and_ten_times_the_mean_on(
    gap_s, messages, span_s, stands_out
):
    info = TopicInfo("S", messages, 0, round(span_s * SECOND), 0, round(gap_s * SECOND), 0)
    assert info.has_gap is stands_out


def test_the_longest_gaps_are_said():
    gappy = {
        f"/t{k}": TopicInfo("S", 101, 0, 600 * SECOND, 0, (60 + k) * SECOND, 5 * SECOND)
        for k in range(7)
    }
    lines = list(gap_lines(gappy))
    assert lines[0] == "Gap: /t6 has no message for 66 s from 1970-01-01T00:00:05Z"
    assert lines[4:] == [
        "Gap: /t2 has no message for 62 s from 1970-01-01T00:00:05Z",
        "Gaps on 2 more topics; --json lists them",
    ]


@pytest.mark.parametrize(
    ("missions", "kind", "asked"),
    [
        (["", ""], "bins", True),
        (["a", "a"], "surface", True),
        (["a", ""], "mean_currents", True),
        (["a", "b"], "bins", False),
        (["a"], "positions", False),
    ],
)
def test_a_replay_comes_next_where_one_mission_measures_a_current(missions, kind, asked):
    counts = dict.fromkeys(("bins", "mean_currents", "surface", "positions"), 0) | {kind: 3}
    logs = [
        SimpleNamespace(report=SimpleNamespace(mission=one), judged=SimpleNamespace(**counts))
        for one in missions
    ]
    assert asks_for_replay(logs) == asked
