"""Events in columns: what is assimilated as one, by the definition event by event, however the log is cut; and in which order."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.core.observation import Flag, Observation, PathMean, Profiles, Source, VehicleState
from replay_kit.estimator.update.grouping import SHARE, Grouping
from replay_kit.workflows.replay.events import Events, Track, ready_items
from tests.workflows.replay.given import block_of, position

SECOND = 10**9
TOPICS = ["/a", "/b", "/dac", "/fix"]
GROUPINGS = [
    Grouping(1e-5),
    Grouping(1e-5, change=1e-5, seconds=40.0),
    Grouping(1e-5).by_hand(15.0),
    None,
]


def profile(seconds, east, shallow, bins, dive, topic, common):
    depth, n = shallow + 8.0 * np.arange(bins), bins
    return Observation(
        int(seconds * SECOND),
        5.0 + east / 55_600.0,
        60.0,
        depth,
        np.full((n, 2), 0.1),
        np.full(n, 0.1),
        "earth" if np.isfinite(common) else "platform",
        np.full(n, Flag.GOOD, np.int8),
        np.zeros(n, np.int32),
        dive,
        Source(0, topic, int(seconds), int(seconds * SECOND)),
        common,
    )


def mean(seconds):
    two, time = np.ones(2), int(seconds * SECOND)
    path = (time - 5, time)
    source = Source(0, "/dac", int(seconds), time)
    return PathMean(
        time, np.array(path), two, two, two, two / 2.0, (0.1, 0.2), 0.02, "dac", 1, source
    )


@st.composite
def logs(draw):
    """Events of a log, most a second or ten apart; some come late."""
    out, now = [], 1000.0
    for kind in draw(st.lists(st.sampled_from("pppppfffm"), min_size=1, max_size=40)):
        now += draw(st.sampled_from([0.0, 1.0, 1.0, 10.0, 10.0, 100.0, -5.0]))
        if kind == "p":
            changes = (
                st.floats(0.0, 400.0),
                st.sampled_from([10.0, 10.0, 14.0, 30.0]),
                st.sampled_from([5, 5, 5, 4]),
                st.sampled_from([1, 1, 1, 2]),
                st.sampled_from(["/a", "/a", "/a", "/b"]),
                st.sampled_from([0.0, 0.0, np.inf]),
            )
            out.append(profile(now, *map(draw, changes)))
        else:
            out.append(position(now, 5.0, 60.0) if kind == "f" else mean(now))
    return out


def fits(grouping, first, other, number):
    """Whether a profile may join a group that begins with another, by the definition."""
    seconds = (other.time_ns - first.time_ns) / SECOND
    alike = ("dive", "correlation_depth")
    size = abs(first.depth[1] - first.depth[0])
    error = float(np.median(first.error_std))
    error = np.hypot(error, first.common_std) if np.isfinite(first.common_std) else error
    way = 111_200.0 * abs(other.longitude - first.longitude) * np.cos(np.radians(first.latitude))
    off = np.hypot(grouping.gradient * way, np.sqrt(grouping.change * max(seconds, 0.0)))
    return (
        0.0 <= seconds <= grouping.seconds
        and all(getattr(first, name) == getattr(other, name) for name in alike)
        and np.isfinite(first.common_std) == np.isfinite(other.common_std)
        and (first.source.topic, first.depth.size) == (other.source.topic, other.depth.size)
        and abs(first.depth[0] - other.depth[0]) <= size
        and off <= SHARE * error / (np.sqrt(number) if grouping.of_mean else 1.0)
    )


def one_by_one(log, grouping):
    """The events as they are taken: groups as lists of profiles, then the positions that came between."""
    out, held = [], []

    def close():
        profiles = [one for one in held if isinstance(one, Observation)]
        out.extend([profiles] if profiles else [])
        out.extend(one for one in held if not isinstance(one, Observation))
        held.clear()

    for event in log:
        if held:
            first = held[0]
            number = sum(isinstance(one, Observation) for one in held)
            seconds = (event.time_ns - first.time_ns) / SECOND
            joins = isinstance(event, VehicleState) and 0.0 <= seconds <= grouping.seconds
            if isinstance(event, Observation):
                joins = fits(grouping, first, event, number)
            if joins:
                held.append(event)
                continue
            close()
        if isinstance(event, Observation) and grouping is not None:
            held.append(event)
        else:
            out.append([event] if isinstance(event, Observation) else event)
    close()
    return [tell(each) for each in out]


def tell(event):
    """What tells an event from others, of a group its members'."""
    if isinstance(event, list):
        return [(one.source.topic, one.time_ns) for one in event]
    if isinstance(event, Profiles):
        sources = map(event.source_of, range(len(event)))
        return [(source.topic, source.time_ns) for source in sources]
    return event.source.topic, event.time_ns


def told(found):
    """The same of items, positions one by one."""
    for item in found:
        yield from map(tell, item.event) if isinstance(item.event, Track) else [tell(item.event)]


def cut(log, grouping, sizes):
    """The items of a log that comes in parts, each of profiles of as many bins."""
    waiting, found, due_ns = Events.none(), [], None
    part = np.repeat(np.arange(len(log)), np.resize(sizes, len(log)))[: len(log)]
    bins = [one.depth.size if isinstance(one, Observation) else 5 for one in log]
    for _, some in groupby(zip(part, bins, log, strict=True), lambda row: row[:2]):
        block = block_of([one for *_, one in some], TOPICS)
        waiting = waiting.followed_by(Events.of(block, block.linear), due_ns)
        due_ns = int(waiting.due[-1])
        now, n = ready_items(waiting, grouping, 0)
        found += now
        waiting = waiting.part(n, len(waiting))
    return list(told([*found, *ready_items(waiting, grouping, 0, last=True)[0]]))


@settings(max_examples=60, deadline=None)
@given(logs(), st.sampled_from(GROUPINGS), st.lists(st.integers(1, 9), min_size=1, max_size=4))
def test_what_is_assimilated_as_one_is_by_the_definition_however_the_log_is_cut(
    log, grouping, sizes
):
    expected = one_by_one(log, grouping)
    assert cut(log, grouping, [len(log)]) == expected
    assert cut(log, grouping, sizes) == expected


@pytest.mark.parametrize(("metres", "groups"), [(2000.0, 1), (3000.0, 2)])
def test_a_group_reaches_as_far_as_the_current_changes_by_a_quarter_of_the_error(metres, groups):
    log = [profile(k, k * metres, 10.0, 5, 1, "/a", 0.0) for k in (0, 1)]
    found, _ = ready_items(Events.of(block_of(log), ()), Grouping(1e-5), 0, last=True)
    assert len(found) == groups


def test_a_group_ends_where_another_vehicles_event_is_later_than_it_may_last():
    log = [profile(k, 0.0, 10.0, 5, 1, "/a", 0.0) for k in (0, 5, 10)]
    events = Events.of(block_of(log), ())
    grouping = Grouping(1e-6, seconds=60.0)
    assert ready_items(events, grouping, 0, [(70 * SECOND, 1)])[1] == 3
    (item,), _ = ready_items(events, grouping, 0, [(30 * SECOND, 1), (70 * SECOND, 1)])
    assert (item.due_ns, item.closed_by, len(item.event)) == (70 * SECOND, 1, 3)
    found, waiting = ready_items(events, grouping, 0, [(60 * SECOND, 1)])
    assert (found, waiting) == ([], 0)
    late = Events.of(block_of([*log, replace(log[0], time_ns=80 * SECOND)]), ())
    (item, _), _ = ready_items(late, grouping, 0, [(70 * SECOND, 1)], last=True)
    assert (item.due_ns, item.closed_by) == (70 * SECOND, 1)
