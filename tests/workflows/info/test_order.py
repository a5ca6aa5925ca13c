"""Times of topics as ``merge`` settles them, however the log is cut into blocks."""

from types import SimpleNamespace

import numpy as np
import pytest

from replay_kit.core.message import Message
from replay_kit.logs import merge
from replay_kit.logs.blocks import blocks_of
from replay_kit.workflows.info.inspect import Spans
from replay_kit.workflows.info.listing import asks_for_replay

SECOND, DAY = 10**9, 86_400.0


def messages(times_s, topics="a"):
    return [
        Message(round(t * SECOND), topics[k % len(topics)], "S", {}, 0, k)
        for k, t in enumerate(times_s)
    ]


def spanned(said, size):
    spans = Spans()
    for begin in range(0, len(said), size):
        spans.add(*blocks_of(said[begin : begin + size]))
    spans.finish()
    return spans.topics


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
    ("times", "topics"),
    [
        (jittered(0.4), "abc"),
        (jittered(30.0), "abc"),
        # a latched message's stamp stays as it is where it is far
        (changed(([0, 5, 150], [90.0, 400.0, -30.0])), ("a", "config", "b")),
        (changed(BACK), "ab"),
        (changed(BACK, (slice(200, None), -7.0), ([50, 130], -5.0 / DAY)), "ab"),
    ],
)
def test_times_of_topics_are_those_of_a_replay_that_waits_for_every_message(size, times, topics):
    said = messages(times, topics)
    merged = merge([SimpleNamespace(messages=lambda: iter(said))], 1e6)
    kept = list(merged)
    assert merged.late == {}
    found = spanned(said, size)
    for topic, info in found.items():
        own = [one.time_ns for one in kept if one.topic == topic]
        assert (info.first_ns, info.last_ns) == (min(own), max(own))


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
