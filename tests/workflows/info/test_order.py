"""Late messages as ``merge`` counts them, and gaps, however the log is cut into blocks."""

from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.message import Message
from replay_kit.logs import merge
from replay_kit.logs.blocks import blocks_of
from replay_kit.workflows.info.listing import asks_for_replay, gap_lines
from replay_kit.workflows.info.reading import Order, TopicInfo

SECOND, DAY = 10**9, 86_400.0


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


def changed(*changes):
    """Times of a thousand days on, some of them changed by days."""
    times = 1000.0 * DAY + np.arange(300.0)
    for rows, days in changes:
        times[rows] += np.multiply(days, DAY)
    return times


BACK = (slice(100, None), -20.0)


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize(
    ("times", "topics", "late"),
    [
        (jittered(0.4), "abc", False),
        (jittered(3.0), "abc", True),
        (jittered(30.0), "abc", True),
        # a latched message's stamp stays as it is where it is far
        (changed(([0, 5, 150], [90.0, 400.0, -30.0])), ("a", "config", "b"), False),
        (changed(BACK), "ab", False),
        (changed(BACK, (slice(200, None), -7.0), ([50, 130], -5.0 / DAY)), "ab", True),
        # as old as what a replay has passed on is not late and a nanosecond more is
        ([0.0, 10.0, 20.0, 10.0], "a", False),
        ([0.0, 10.0, 20.0, 10.0 - 1e-9], "a", True),
    ],
)
def test_late_messages_are_those_that_a_replay_leaves_out(size, times, topics, late):
    said = messages(times, topics)
    merged = merge([SimpleNamespace(messages=lambda: iter(said))], 1.0)
    kept = list(merged)
    found = ordered(said, size)
    assert {topic: info.late for topic, info in found.items() if info.late} == merged.late
    assert bool(merged.late) == late
    for topic, info in found.items():
        own, used = ([one.time_ns for one in each if one.topic == topic] for each in (said, kept))
        # those that are late count for a topic's span, those set aside do not
        assert (info.first_ns, info.last_ns) == (min(own if times[0] < DAY else used), max(used))
        assert len(used) + info.late + merged.astray.get(topic, 0) == len(own)


@pytest.mark.parametrize("size", [1, 2, 5, 100])
def test_the_longest_gap_is_counted_from_the_newest_message_before_it(size):
    # the message of 3 s comes after that of 10 s and shortens nothing
    found = ordered(messages([0.0, 1.0, 10.0, 3.0, 110.0, 112.0]), size, 1000.0)["a"]
    assert (found.gap_ns, found.gap_from_ns) == (100 * SECOND, 10 * SECOND)


def gappy(gap_s, messages=101, span_s=600.0):
    return TopicInfo("S", messages, 0, round(span_s * SECOND), 0, round(gap_s * SECOND), 5 * SECOND)


@pytest.mark.parametrize(
    ("topic", "stands_out"),
    [
        (gappy(60.0), True),
        (gappy(59.0, span_s=500.0), False),
        (gappy(60.0, span_s=601.0), False),
        (gappy(60.0, 1, 0.0), False),
    ],
)
def test_a_gap_stands_out_from_a_minute_and_ten_times_the_mean_on(topic, stands_out):
    assert topic.has_gap is stands_out


def test_the_longest_gaps_are_said():
    lines = list(gap_lines({f"/t{k}": gappy(60.0 + k) for k in range(7)}))
    assert lines[0] == "Gap: /t6 has no message for 66 s from 1970-01-01T00:00:05Z"
    assert lines[4].startswith("Gap: /t2 has no message for 62 s")
    assert lines[5].startswith("Gaps on 2 more topics")


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
    judged = SimpleNamespace(**counts)
    logs = [SimpleNamespace(report=SimpleNamespace(mission=one), judged=judged) for one in missions]
    assert asks_for_replay(logs) == asked
