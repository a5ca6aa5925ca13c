"""The estimation stage: blocks of positions and measurements in, the estimate before and after each of them out.

Profiles that repeat each other wait until one comes that does not, or a position that is too late, and are then assimilated as one group;
positions that come in between wait with them and follow the group. What waits is part of the state, so that it makes no difference how a
log is cut into blocks.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import (
    Innovation,
    LinearMeasurement,
    Measurement,
    Observation,
    PathMean,
    VehicleState,
)
from replay_kit.estimator import Estimator
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup

# Number of a dive whose mean current has come, after which a measurement of it begins it anew.
_ENDED = -1


@dataclass(frozen=True, slots=True, eq=False)
class EstimationState:
    """The estimate so far.

    Attributes:
        current: The estimator's state.
        dive_start: The estimator's state before the dive's first measurement.
        dive: Number of the dive.
        waiting: Profiles that may still be joined by others, and the positions among them, in the order of the log.
    """

    # Any: each kind of estimator has a state of its own, which only it reads
    current: Any
    dive_start: Any
    dive: int = 0
    waiting: tuple[VehicleState | Measurement, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Assimilation:
    """The assimilation of one measurement, or of a group of profiles.

    Attributes:
        innovation: Measured minus predicted, and the decision.
        dive_innovation: shape (n, 2) [m/s], measured minus predicted from all dives before the measurement's own; of a group all bins of
            all profiles.
        dive_std: shape (1, 2) [m/s], predicted, of ``dive_innovation`` of a dive's mean current; None for others.
    """

    innovation: Innovation
    dive_innovation: Array
    dive_std: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One event of the log, with the estimate before and after it.

    Attributes:
        event: A position, a measurement, or a group of profiles.
        before: The estimator's state before it.
        after: The estimator's state after it.
        assimilation: Of a measurement or a group; None for a position.
    """

    event: VehicleState | Measurement | ProfileGroup
    before: Any
    after: Any
    assimilation: Assimilation | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Contributor:
    """What gives measurements to an estimate: one vehicle of it.

    Attributes:
        estimator: Assimilates its measurements; those of all have states of one kind.
        state: The estimate, the same for all, with what is the vehicle's own.
    """

    estimator: Estimator[Any]
    state: EstimationState


def inputs_of(
    estimator: Estimator[Any] | type[Estimator[Any]],
) -> tuple[type[VehicleState | Measurement], ...]:
    """Return the events that an estimator is given."""
    sums = (PathMean, LinearMeasurement) if estimator.supports_path_means else ()
    return (VehicleState, Observation, *sums)


def assimilate(
    estimator: Estimator[Any],
    state: EstimationState,
    events: Sequence[VehicleState | Measurement],
    last: bool = True,
) -> tuple[EstimationState, list[Step]]:
    """Return the state after a block of events of one vehicle; see ``assimilate_together``."""
    own = [(0, event) for event in events]
    (after,), steps = assimilate_together([Contributor(estimator, state)], own, last)
    return after, [step for _, step in steps]


def assimilate_together(
    vehicles: Sequence[Contributor],
    events: Sequence[tuple[int, VehicleState | Measurement]],
    last: bool = True,
) -> tuple[list[EstimationState], list[tuple[int, Step]]]:
    """Return the states after a block of events, and a step for each of those that wait no longer, with its vehicle.

    Args:
        vehicles: With their states before the block, all of one estimate.
        events: Each with the number of its vehicle: together in order of time, those of each in the order of its log.
        last: Whether nothing may wait for what follows.
    """
    items, waiting = _in_turn(vehicles, events, last)
    states = [
        replace(vehicle.state, waiting=left)
        for vehicle, left in zip(vehicles, waiting, strict=True)
    ]
    current, steps = vehicles[0].state.current, list[tuple[int, Step]]()
    # measurements of vehicles with one estimator are assimilated together
    for _, of_estimator in groupby(items, key=lambda item: id(vehicles[item[0]].estimator)):
        own = list(of_estimator)
        estimator = vehicles[own[0][0]].estimator
        # Any: only an estimator that supports mean currents along paths is given some
        given: list[Any] = [item for _, item in own if not isinstance(item, VehicleState)]
        results = deque(estimator.assimilate(current, given)[1])
        for vehicle, item in own:
            if isinstance(item, VehicleState):
                steps.append((vehicle, Step(item, current, current)))
                continue
            members = len(item.profiles) if isinstance(item, ProfileGroup) else 1
            while members:
                event, before, current, innovation, against = results.popleft()
                members -= len(event.profiles) if isinstance(event, ProfileGroup) else 1
                if event.dive != states[vehicle].dive:
                    states[vehicle] = replace(states[vehicle], dive_start=before, dive=event.dive)
                start = states[vehicle].dive_start
                std, of_dive = None, None if against is None else against(start)
                if isinstance(event, PathMean) and event.kind == "dac":
                    # profiles of the dive itself make the estimate surer than it was before the dive
                    known = innovation
                    if start is not before:
                        known = estimator.assimilate(start, [event])[1][-1].innovation
                    std, of_dive = known.innovation_std, known.innovation
                if of_dive is None or np.isnan(of_dive).all():
                    of_dive = estimator.innovation(start, event)
                found = Assimilation(innovation, of_dive, std)
                steps.append((vehicle, Step(event, before, current, found)))
                if std is not None and len(vehicles) > 1:
                    # of many vehicles each would keep the state that its last dive began with, tens of megabytes
                    states[vehicle] = replace(states[vehicle], dive=_ENDED)
    return [
        replace(
            state,
            current=current,
            dive_start=current if state.dive == _ENDED else state.dive_start,
        )
        for state in states
    ], steps


def state_after(
    vehicles: Sequence[Contributor],
    events: Sequence[tuple[int, Measurement]],
    size: int,
    unused: int | None = None,
) -> Any:
    """Return the estimator's state after measurements, and nothing else; arguments as of ``assimilate_together``.

    Args:
        vehicles: With their states before.
        events: All there are.
        size: Of the blocks in which they are given.
        unused: Vehicle whose window goes with it although its measurements are not used; None for none.
    """
    items, _ = _in_turn(vehicles, events, last=True)
    current = vehicles[0].state.current
    for begin in range(0, len(items), size):
        block = items[begin : begin + size]
        for _, of_estimator in groupby(block, key=lambda item: id(vehicles[item[0]].estimator)):
            own = list(of_estimator)
            given: list[Any] = [item for _, item in own]
            estimator = vehicles[own[0][0]].estimator
            if own[0][0] == unused:
                for item in given:
                    current = estimator.moved(current, item)
            else:
                current, _ = estimator.assimilate(current, given)
            current = estimator.without_left(current)
    return current


def kept(estimator: Estimator[Any], state: EstimationState) -> EstimationState:
    """Return the state without windows that vehicles have left, and of the dive's start the vehicle's window alone."""
    forget = estimator.without_left
    start = estimator.of_own(forget(state.dive_start))
    return replace(state, current=forget(state.current), dive_start=start)


_Item = VehicleState | Measurement | ProfileGroup


def _in_turn(
    vehicles: Sequence[Contributor],
    events: Sequence[tuple[int, VehicleState | Measurement]],
    last: bool,
) -> tuple[list[tuple[int, _Item]], list[tuple[VehicleState | Measurement, ...]]]:
    """Return the events of a block that wait no longer, profiles in groups, in the order in which they are assimilated; and what waits."""
    items, waiting = list[tuple[int, _Item]](), [vehicle.state.waiting for vehicle in vehicles]

    def released(of: int, found: Sequence[_Item]) -> None:
        items.extend((of, item) for item in found)

    holding = {number for number, left in enumerate(waiting) if left}
    for number, run in groupby(events, key=lambda event: event[0]):
        of_vehicle = [event for _, event in run]
        for other in sorted(holding - {number}):
            # what waits for its own vehicle's next event may not be overtaken for long
            grouping, left = vehicles[other].estimator.grouping, waiting[other]
            if grouping and grouping.is_over(left[0], of_vehicle[0].time_ns):
                released(other, _closed(left))
                waiting[other] = ()
                holding.discard(other)
        grouping = vehicles[number].estimator.grouping
        found, waiting[number] = grouped(grouping, waiting[number], of_vehicle)
        released(number, found)
        holding = holding | {number} if waiting[number] else holding - {number}
    if last:
        for number, left in enumerate(waiting):
            released(number, _closed(left))
        waiting = [()] * len(vehicles)
    return items, waiting


def grouped(
    grouping: Grouping | None,
    waiting: tuple[VehicleState | Measurement, ...],
    events: Sequence[VehicleState | Measurement],
) -> tuple[list[VehicleState | Measurement | ProfileGroup], tuple[VehicleState | Measurement, ...]]:
    """Return events with profiles that repeat each other as groups, and the events that still wait for what follows.

    Args:
        grouping: Which profiles belong together; None groups none.
        waiting: Events that wait, a profile first.
        events: Those that follow.
    """
    items: list[VehicleState | Measurement | ProfileGroup] = []
    if grouping is None:
        return list(events), ()
    left = list(waiting)
    number = sum(isinstance(event, Observation) for event in left)
    for event in events:
        first = left[0] if left else None
        if isinstance(first, Observation):
            profile = isinstance(event, Observation)
            if (
                grouping.fits(first, event, number)
                if isinstance(event, Observation)
                else not grouping.ends(first, event)
            ):
                left.append(event)
                number += profile
                continue
            items += _closed(left)
            left, number = [], 0
        if isinstance(event, Observation):
            left, number = [event], 1
        else:
            items.append(event)
    return items, tuple(left)


def _closed(
    waiting: Sequence[VehicleState | Measurement],
) -> list[VehicleState | Measurement | ProfileGroup]:
    """Return what waited: the profiles, as a group where there are several, and the positions after them."""
    profiles = tuple(event for event in waiting if isinstance(event, Observation))
    others = [event for event in waiting if not isinstance(event, Observation)]
    return [*(profiles if len(profiles) < 2 else (ProfileGroup(profiles),)), *others]
