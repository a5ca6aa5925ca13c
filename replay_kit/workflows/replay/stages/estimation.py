"""The estimation stage: blocks of positions and measurements in, the estimate before and after each of them out.

Profiles that repeat each other wait until one comes that does not, or a position that is too late, and are then assimilated as one group;
positions that come in between wait with them and follow the group. What waits is part of the state, so that it makes no difference how a
log is cut into blocks.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from replay_kit.core.arrays import Array
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
        weights: shape (r Z,), mean weights after the measurement; None for an estimator without weights of the run's basis.
        dive_std: shape (1, 2) [m/s], predicted, of ``dive_innovation`` of a dive's mean current; None for others.
    """

    innovation: Innovation
    dive_innovation: Array
    weights: Array | None
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
    """Return the state after a block of events, and a step for each of those that wait no longer.

    Args:
        estimator: Assimilates the measurements of the block together.
        state: Before the block.
        events: In the order of the log.
        last: Whether nothing may wait for what follows.
    """
    items, waiting = grouped(estimator.grouping, state.waiting, events)
    if last:
        items, waiting = [*items, *_closed(waiting)], ()
    # Any: only an estimator that supports mean currents along paths is given some
    measurements: list[Any] = [item for item in items if not isinstance(item, VehicleState)]
    done = list(estimator.group_steps(state.current, measurements))
    weights = iter(estimator.weights([each.after for each in done]))
    results = deque(done)
    steps = []
    for item in items:
        if isinstance(item, VehicleState):
            steps.append(Step(item, state.current, state.current))
            continue
        members = len(item.profiles) if isinstance(item, ProfileGroup) else 1
        while members:
            event, before, after, innovation = results.popleft()
            members -= len(event.profiles) if isinstance(event, ProfileGroup) else 1
            if event.dive != state.dive:
                state = replace(state, current=before, dive_start=before, dive=event.dive)
            dive_innovation = (
                estimator.group_innovation(state.dive_start, event)
                if isinstance(event, ProfileGroup)
                else estimator.innovation(state.dive_start, event)
            )
            dive_std = None
            if isinstance(event, PathMean) and event.kind == "dac":
                # profiles of the dive itself make the estimate surer than it was before the dive
                from_start = (
                    innovation
                    if state.dive_start is before
                    else estimator.step(state.dive_start, event)[1]
                )
                dive_std = from_start.innovation_std
            state = replace(state, current=after)
            steps.append(
                Step(
                    event,
                    before,
                    after,
                    Assimilation(innovation, dive_innovation, next(weights), dive_std),
                )
            )
    return replace(state, waiting=waiting), steps


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
