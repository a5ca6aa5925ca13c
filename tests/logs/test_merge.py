"""Merging: equal to the obvious sort of everything, in bounded memory; late messages, far stamps and jumps of a clock are counted."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.message import Message
from replay_kit.logs import merge
from tests.reference.stamps import DAY, corrected

SECOND = 1_000_000_000
quick = settings(max_examples=200, deadline=None, derandomize=True)
logs = st.lists(st.lists(st.integers(0, 50), max_size=30), max_size=4)


class Recorded:
    """A log made of stamps [ns]; it counts how far it was read."""

    def __init__(self, stamps, input=0, topics=()):
        self.stamps, self.input, self.topics, self.read = stamps, input, topics, 0

    def messages(self):
        for position, stamp in enumerate(self.stamps):
            self.read += 1
            topic = self.topics[position] if self.topics else f"/{self.input}"
            yield Message(stamp, topic, "", {}, self.input, position)


def recorded(times):
    return [Recorded([time * SECOND for time in row], k) for k, row in enumerate(times)]


def key(message):
    return message.time_ns, message.input, message.position


def obvious(times, window):
    """Give each log's messages the slow way: after each arrival, everything older than the window, in order."""
    kept: list[tuple[int, int, int]] = []
    late: Counter[str] = Counter()
    for k, row in enumerate(times):
        held: list[tuple[int, int]] = []
        given: list[tuple[int, int]] = []
        for position, time in enumerate(row):
            if given and time < given[-1][0]:
                late[f"/{k}"] += 1
                continue
            held.append((time, position))
            newest = max(row[: position + 1])
            for item in sorted(held):
                if newest - item[0] > window:
                    held.remove(item)
                    given.append(item)
        kept += [(time * SECOND, k, position) for time, position in given + sorted(held)]
    return sorted(kept), late


@quick
@given(times=logs, window=st.sampled_from([0.0, 1.0, 5.0, 50.0]))
def test_as_the_obvious_sort(times, window):
    merged = merge(recorded(times), window)
    expected, late = obvious(times, window)
    assert [key(m) for m in merged] == expected
    assert merged.late == late


@quick
@given(times=logs, start=st.integers(0, 50), end=st.integers(0, 50))
def test_limits_are_a_filter_of_the_whole(times, start, end):
    whole = merge(recorded(times), 2.0)
    part = merge(recorded(times), 2.0, start * SECOND, end * SECOND)
    assert [key(m) for m in part] == [
        key(m) for m in whole if start * SECOND <= m.time_ns <= end * SECOND
    ]


def test_the_window_alone_is_held():
    logs = recorded([range(100_000), range(100_000)])
    stream = iter(merge(logs, 10.0))
    for _ in range(1000):
        next(stream)
    assert all(log.read < 520 for log in logs)


def test_what_comes_once_counts_before_the_start():
    topics = ["/tf_static", "/adcp", "/vehicle/config", "mavlink/1/1/PARAM_VALUE", "/adcp"]
    log = Recorded([position * SECOND for position in range(7)], 0, [*topics, topics[0], "/adcp"])
    given = merge([log], 0.0, start_ns=4 * SECOND, end_ns=5 * SECOND)
    assert [message.position for message in given] == [0, 2, 3, 4, 5]


@quick
@given(times=logs, window=st.integers(0, 5))
def test_a_copy_keeps_late_messages(times, window):
    merged = merge(recorded(times), float(window), keep_late=True)
    assert sorted(map(key, merged)) == sorted(
        (time * SECOND, k, n) for k, row in enumerate(times) for n, time in enumerate(row)
    )
    assert merged.late == {}


START = 20_000 * DAY
YEAR_2200 = 84_006 * DAY


def streamed(stamps):
    """Return the time of each message, by its place in the log; a window so wide that none is late."""
    merged = merge([Recorded(stamps)], 1e12)
    times: list[int | None] = [None] * len(stamps)
    for message in merged:
        times[message.position] = message.time_ns
    assert sum(merged.astray.values()) == times.count(None)
    assert merged.late == {}
    # a second pass finds the same
    assert sorted(message.time_ns for message in merged) == sorted(filter(None, times))
    return times


steps = st.lists(
    st.sampled_from(
        [
            *(SECOND, SECOND, SECOND, SECOND, 0, -SECOND, DAY, -DAY, 40 * DAY, -40 * DAY),
            # the edges of the rule
            *(-DAY - 1, DAY + 1, 366 * DAY, 366 * DAY + 1, 500 * DAY, -500 * DAY),
        ]
    ),
    max_size=120,
)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    steps=steps,
    strays=st.dictionaries(st.integers(0, 119), st.sampled_from([YEAR_2200, 0, START + 2 * DAY])),
)
def test_as_the_slow_twin(steps, strays):
    stamps, time = [], START
    for k, step in enumerate(steps):
        time += step
        stamps.append(strays.get(k, time))
    assert streamed(stamps) == corrected(stamps)
