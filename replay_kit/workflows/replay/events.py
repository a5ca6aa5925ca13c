"""Events of a vehicle in columns, and their groups for assimilation, in an order that depends on events only.

Profiles that repeat each other wait until another profile or a late position arrives; positions in between wait too and follow the group.
The division of a log into blocks therefore has no effect.

Events of a vehicle arrive in log order, those of a dive after its surfacing. If several vehicles share an estimate, an event is due no
earlier than its predecessors, and events are merged by due time, then vehicle.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Indices, Times
from replay_kit.core.observation import (
    OF_BINS,
    PROFILE,
    LinearMeasurement,
    PathMean,
    Profiles,
    Source,
    VehicleState,
)
from replay_kit.core.observation.table import LINEAR, PING, POSITION, Block, Columns, chosen_rows
from replay_kit.estimator.update.grouping import Grouping
from replay_kit.measurements.profiles.pings import MISSING, padded

_OF_POSITION = (
    *("time", "longitude", "latitude", "depth", "dead_reckoned"),
    *("input", "topic", "ordinal"),
)
_COLUMNS = {
    POSITION: _OF_POSITION,
    PING: (*PROFILE, "bins", *OF_BINS),
    LINEAR: ("time", "event"),
}
# Events among which the end of a group is looked for at first.
_LOOKED = 256
_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Consecutive positions.

    Attributes:
        columns: Columns as in ``Block.position``.
        topics: Names of topics, by their numbers in ``columns``.
    """

    columns: Columns
    topics: Sequence[str]

    def __len__(self) -> int:
        """Return the number of positions."""
        return len(self.columns["time"])

    def __getitem__(self, i: int) -> VehicleState:
        """Return one position."""
        return next(
            iter(Track({name: self.columns[name][[i]] for name in _OF_POSITION}, self.topics))
        )

    def __iter__(self) -> Iterator[VehicleState]:
        """Yield the positions."""
        for row in zip(*(self.columns[name].tolist() for name in _OF_POSITION), strict=True):
            time, longitude, latitude, depth, reckoned, number, topic, ordinal = row
            source = Source(number, self.topics[topic], ordinal, time)
            yield VehicleState(time, longitude, latitude, depth, reckoned, source)

    @property
    def time_ns(self) -> int:
        """Time of the first position [ns, UTC]."""
        return int(self.columns["time"][0])


@dataclass(frozen=True, slots=True, eq=False)
class Aside:
    """DAC that is not assimilated.

    Attributes:
        mean: The DAC.
    """

    mean: PathMean

    @property
    def time_ns(self) -> int:
        """Time of the DAC [ns, UTC]."""
        return self.mean.time_ns


#: What the estimate takes as one, and what it passes: positions, and mean currents of no use to it.
Event = Track | Aside | Profiles | PathMean | LinearMeasurement
_Other = Aside | PathMean | LinearMeasurement


def lightened(event: Event) -> Event:
    """Return an observation without data needed only by its checks or a result, detached from its block."""
    if isinstance(event, LinearMeasurement):
        return replace(event, label=replace(event.label, vectors=None))
    if isinstance(event, Profiles):
        columns = {name: column.copy() for name, column in event.columns.items()}
        return Profiles(columns, event.topics)
    return event


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """Waiting events of a vehicle, in order.

    Attributes:
        time: shape (N,) [ns, UTC], times.
        due: shape (N,) [ns, UTC], the latest time up to each.
        kind: shape (N,), ``POSITION``, ``PING``, or ``LINEAR`` for all others.
        rows: Columns of each kind: of positions and profiles as in ``Block``, of others ``time`` and ``event``; empty for none.
        topics: Names of topics, by number.
    """

    time: Times
    due: Times
    kind: NDArray[np.int64]
    rows: Mapping[int, Columns]
    topics: Sequence[str] = ()

    @staticmethod
    def none() -> "Events":
        """Return an empty instance."""
        empty = np.empty(0, np.int64)
        return Events(empty, empty, empty, {number: {} for number in _COLUMNS})

    @staticmethod
    def of(block: Block, others: Sequence[_Other]) -> "Events":
        """Return the events of a block; ``others`` are neither positions nor profiles, in order."""
        _, kind, row = block.events.T
        kind = np.where((kind == POSITION) | (kind == PING), kind, LINEAR)
        row = np.where(kind == LINEAR, np.cumsum(kind == LINEAR) - 1, row)
        times = np.array([one.time_ns for one in others], np.int64)
        given = {"time": times, "event": np.fromiter(others, np.object_, len(others))}
        rows, time = dict[int, Columns](), np.empty(len(kind), np.int64)
        for number, columns in ((POSITION, block.position), (PING, block.ping), (LINEAR, given)):
            own = kind == number
            held = {name: columns[name] for name in _COLUMNS[number]} if own.any() else {}
            rows[number] = chosen_rows(held, row[own])
            if held:
                time[own] = rows[number]["time"]
        return Events(time, np.maximum.accumulate(time), kind, rows, block.topics)

    def __len__(self) -> int:
        """Return the number of events."""
        return len(self.time)

    def part(self, begin: int, end: int) -> "Events":
        """Return the events from ``begin`` to before ``end``."""
        if begin == 0 and end >= len(self):
            return self
        at = np.arange(len(self))
        return self.without((at < begin) | (at >= end))

    def followed_by(self, more: "Events", due_ns: int | None) -> "Events":
        """Return these events followed by others, of which the event before them was due at a given time [ns, UTC]."""
        if due_ns is not None:
            more = replace(more, due=np.maximum(more.due, due_ns))
        if not len(self):
            return more
        time, due, kind = (
            np.concatenate([getattr(self, name), getattr(more, name)])
            for name in ("time", "due", "kind")
        )
        rows = {number: _joined(self.rows[number], more.rows[number]) for number in _COLUMNS}
        return Events(time, due, kind, rows, more.topics)

    def without(self, unused: NDArray[np.bool_]) -> "Events":
        """Return the events without some, shape (N,)."""
        kept = ~unused
        rows = {
            number: {name: column[kept[self.kind == number]] for name, column in columns.items()}
            for number, columns in self.rows.items()
        }
        return Events(self.time[kept], self.due[kept], self.kind[kept], rows, self.topics)

    def profiles(self, begin: int, end: int) -> Profiles:
        """Return rows of profiles with equal numbers of bins."""
        ping = self.rows[PING]
        bins = int(ping["bins"][begin])
        columns = {name: ping[name][begin:end] for name in PROFILE}
        columns |= {name: ping[name][begin:end, :bins] for name in OF_BINS}
        return Profiles(columns, self.topics)

    def track(self, begin: int, end: int) -> Track:
        """Return rows of positions."""
        columns = {name: column[begin:end] for name, column in self.rows[POSITION].items()}
        return Track(columns, self.topics)


def _joined(first: Columns, more: Columns) -> Columns:
    """Return concatenated rows; bins absent from some are missing there."""
    if not first or not more:
        return more or first
    return {name: padded([first[name], more[name]], MISSING.get(name, 0)) for name in more}


class Item(NamedTuple):
    """Unit of assimilation, or consecutive positions.

    Attributes:
        due_ns: Due time of the event that completes it [ns, UTC].
        closed_by: Number of the vehicle of that event.
        vehicle: Number of its vehicle.
        event: The observation, group or positions.
    """

    due_ns: float
    closed_by: int
    vehicle: int
    event: Event


def ready_items(
    events: Events,
    grouping: Grouping | None,
    vehicle: int,
    beside: Sequence[tuple[int, int]] = (),
    last: bool = False,
) -> tuple[list[Item], int]:
    """Return the items ready for assimilation, and the number of their events; the others belong to a group that may grow.

    Args:
        events: Events of one vehicle.
        grouping: Rule for combining profiles; None combines none.
        vehicle: Number of the vehicle.
        beside: Due times of other vehicles' events [ns, UTC] and their vehicles, in order; they limit the wait of a group.
        last: Whether no events follow.
    """
    found, i, n = list[Item](), 0, len(events)
    rows = {number: np.cumsum(events.kind == number) for number in _COLUMNS}
    kind, due = events.kind.tolist(), events.due.tolist()
    alone = _alone(events, grouping)
    breaks = np.append(np.flatnonzero(np.diff(events.kind)) + 1, n)

    def tracks(begin: int, end: int, at: tuple[float, int] | None = None) -> None:
        """Add the positions among some events; one by one for several vehicles, as those may alternate."""
        first, number = rows[POSITION][begin] - (kind[begin] == POSITION), rows[POSITION][end - 1]
        if at is None and beside:
            at_each = zip(range(begin, end), range(first, number), strict=True)
            found.extend(
                Item(due[k], vehicle, vehicle, events.track(row, row + 1)) for k, row in at_each
            )
        elif number > first:
            due_ns, owner = at or (due[end - 1], vehicle)
            found.append(Item(due_ns, owner, vehicle, events.track(first, number)))

    while i < n:
        if kind[i] == POSITION:
            end = int(breaks[np.searchsorted(breaks, i, side="right")])
            tracks(i, end)
        elif kind[i] == LINEAR:
            other = events.rows[LINEAR]["event"][rows[LINEAR][i] - 1]
            found.append(Item(due[i], vehicle, vehicle, other))
            end = i + 1
        else:
            first, end = int(rows[PING][i]) - 1, i + 1
            at: tuple[float, int] = due[i], vehicle
            if grouping is not None:
                if not alone[i]:
                    end = _group_end(events, grouping, i, rows[PING])
                closed = [(float(due[end]), vehicle)] if end < n else []
                latest = events.time[i] + grouping.seconds * _NS
                closed += next(([(float(at), owner)] for at, owner in beside if at > latest), [])
                if last:
                    closed.append((np.inf, vehicle))
                if not closed:
                    return found, i
                at = min(closed)
            found.append(Item(*at, vehicle, events.profiles(first, int(rows[PING][end - 1]))))
            tracks(i, end, at)
        i = end
    return found, n


def _go_on(
    events: Events, grouping: Grouping, row: Indices, begin: Indices, at: Indices
) -> NDArray[np.bool_]:
    """Return whether events, shape (n,), belong to the groups that profiles begin, shape (n,), if all between do.

    Args:
        events: Events of one vehicle.
        grouping: Rule for combining profiles.
        row: Number of profiles up to each event.
        begin: Events that begin the groups.
        at: The events.
    """
    ping, elapsed = events.kind[at] == PING, (events.time[at] - events.time[begin]) / _NS
    found: NDArray[np.bool_] = (events.kind[at] == POSITION) & grouping.lasts(elapsed)
    if ping.any():
        first, later = row[begin[ping]], row[at[ping]]
        found[ping] = grouping.fit(events.rows[PING], first - 1, later - 1, later - first)
    return found


def _alone(events: Events, grouping: Grouping | None) -> list[bool]:
    """Return for each event whether the next one ends the group that it begins."""
    found = np.zeros(len(events), np.bool_)
    begin = np.flatnonzero(events.kind[:-1] == PING)
    if grouping is not None and begin.size:
        row = np.cumsum(events.kind == PING)
        found[begin] = ~_go_on(events, grouping, row, begin, begin + 1)
    return found.tolist()


def _group_end(events: Events, grouping: Grouping, begin: int, row: Indices) -> int:
    """Return the event that ends the group of a profile, or the number of events."""
    looked, n = _LOOKED, len(events)
    while True:
        at = np.arange(begin + 1, min(begin + 1 + looked, n))
        ends = np.flatnonzero(~_go_on(events, grouping, row, np.full(at.size, begin), at))
        if ends.size or at.size < looked:
            return int(at[ends[0]]) if ends.size else n
        looked *= 4
