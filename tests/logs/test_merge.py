"""Merging: equal to the obvious sort of everything, in bounded memory, with late messages counted and not given."""

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.message import LogReport, Message
from replay_kit.logs import merge

SECOND = 1_000_000_000
quick = settings(max_examples=200, deadline=None, derandomize=True)
logs = st.lists(st.lists(st.integers(0, 50), max_size=30), max_size=4)


class Recorded:
    """A log made of times; it counts how far it was read."""

    path = "made"
    format = "made"

    def __init__(self, times, input):
        self.times, self.input, self.read = times, input, 0

    def messages(self):
        for position, time in enumerate(self.times):
            self.read += 1
            yield Message(time * SECOND, f"/{self.input}", "", {}, self.input, position)

    def report(self):
        return LogReport(self.path, self.format, {}, {}, ())


def recorded(times):
    return [Recorded(row, k) for k, row in enumerate(times)]


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
@given(times=logs, window=st.sampled_from([0.0, 1.0, 5.0]))
def test_as_the_obvious_sort(times, window):
    merged = merge(recorded(times), window)
    expected, late = obvious(times, window)
    assert [key(m) for m in merged] == expected
    assert merged.late == late


@quick
@given(times=logs)
def test_a_wide_window_sorts_everything(times):
    merged = merge(recorded(times), 50.0)
    everything = sorted(
        (time * SECOND, k, position)
        for k, row in enumerate(times)
        for position, time in enumerate(row)
    )
    assert [key(m) for m in merged] == everything
    assert merged.late == {}


@quick
@given(times=logs, start=st.integers(0, 50), end=st.integers(0, 50))
def test_limits_are_a_filter_of_the_whole(times, start, end):
    whole = merge(recorded(times), 2.0)
    part = merge(recorded(times), 2.0, start * SECOND, end * SECOND)
    assert [key(m) for m in part] == [
        key(m) for m in whole if start * SECOND <= m.time_ns <= end * SECOND
    ]


def test_a_late_message_is_counted_by_topic_and_not_given():
    merged = merge(recorded([[0, 10, 20, 3, 30]]), 1.0)
    assert [m.time_ns // SECOND for m in merged] == [0, 10, 20, 30]
    assert merged.late == {"/0": 1}
    assert merge(recorded([[0, 10, 20, 3, 30]]), 1.0, start_ns=5 * SECOND).late == {}


def test_the_window_alone_is_held():
    logs = recorded([range(100_000), range(100_000)])
    stream = iter(merge(logs, 10.0))
    for _ in range(1000):
        next(stream)
    assert all(log.read < 520 for log in logs)


def test_one_stamp_far_in_the_future_is_set_aside():
    merged = merge(recorded([[0, 1, 10**6, 2, 3, 4, 5]]), 1.0)
    assert [m.time_ns // SECOND for m in merged] == [0, 1, 2, 3, 4, 5]
    assert merged.astray == {"/0": 1}
    assert merged.late == {}


def test_nothing_to_merge():
    assert list(merge([], 1.0)) == []
    assert list(merge(recorded([[], []]), 1.0)) == []


def test_what_comes_once_counts_before_the_start():
    class Topics(Recorded):
        def messages(self):
            for position, topic in enumerate(
                (
                    "/tf_static",
                    "/adcp",
                    "/vehicle/config",
                    "mavlink/1/1/PARAM_VALUE",
                    "/adcp",
                    "/tf_static",
                    "/adcp",
                )
            ):
                yield Message(position * SECOND, topic, "", {}, self.input, position)

    given = [
        (message.position, message.topic)
        for message in merge([Topics([], 0)], 0.0, start_ns=4 * SECOND, end_ns=5 * SECOND)
    ]
    assert given == [
        (0, "/tf_static"),
        (2, "/vehicle/config"),
        (3, "mavlink/1/1/PARAM_VALUE"),
        (4, "/adcp"),
        (5, "/tf_static"),
    ]


@quick
@given(times=logs, window=st.integers(0, 5))
def test_a_copy_keeps_late_messages(times, window):
    merged = merge(recorded(times), float(window), keep_late=True)
    assert sorted(map(key, merged)) == sorted(
        (time * SECOND, k, n) for k, row in enumerate(times) for n, time in enumerate(row)
    )
    assert merged.late == {}
