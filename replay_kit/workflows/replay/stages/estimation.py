"""The estimation stage: positions and measurements in, the estimate before and after each of them out."""

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
    PathMean,
    Profiles,
)
from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.events import Aside, Event, Track

# Number of a dive whose mean current has come, after which a measurement of it begins it anew.
_ENDED = -1


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """The dive of a vehicle.

    Attributes:
        start: The estimator's state before its first measurement.
        number: Of the dive.
    """

    # Any: each kind of estimator has a state of its own, which only it reads
    start: Any
    number: int = 0


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
    """An event with the estimate before and after it.

    Attributes:
        event: Positions in a row, a measurement, or one that the estimate is not given.
        before: The estimator's state before it.
        after: The estimator's state after it.
        assimilation: Of a measurement that it is given; None for others.
    """

    event: Event
    before: Any
    after: Any
    assimilation: Assimilation | None = None


#: An event with the number of its vehicle.
Given = tuple[int, Event]


def inputs_of(
    estimator: Estimator[Any] | type[Estimator[Any]],
) -> tuple[type[Measurement], ...]:
    """Return the measurements that an estimator is given."""
    sums = (PathMean, LinearMeasurement) if estimator.supports_path_means else ()
    return (Profiles, *sums)


def assimilate(
    estimators: Sequence[Estimator[Any]],
    current: Any,
    dives: Sequence[Dive],
    given: Sequence[Given],
) -> tuple[Any, list[Dive], list[tuple[int, Step]]]:
    """Return the estimator's state and the dives of all vehicles after events, and the step of each.

    Args:
        estimators: Of each vehicle, all with states of one kind.
        current: The estimator's state before them.
        dives: Of each vehicle, before them.
        given: In order.
    """
    dives, steps = list(dives), list[tuple[int, Step]]()
    # measurements of vehicles with one estimator are assimilated together
    for _, of_estimator in groupby(given, key=lambda one: id(estimators[one[0]])):
        own = list(of_estimator)
        estimator = estimators[own[0][0]]
        # Any: only an estimator that supports mean currents along paths is given some
        measured: list[Any] = [event for _, event in own if not isinstance(event, Track | Aside)]
        results = deque(estimator.assimilate(current, measured)[1])
        for vehicle, event in own:
            if isinstance(event, Track | Aside):
                steps.append((vehicle, Step(event, current, current)))
                continue
            left = len(event) if isinstance(event, Profiles) else 1
            while left:
                # Any: the event is, or is of, what was given
                some: Any
                some, before, current, innovation, against = results.popleft()
                left -= len(some) if isinstance(some, Profiles) else 1
                if some.dive != dives[vehicle].number:
                    dives[vehicle] = Dive(before, some.dive)
                start = dives[vehicle].start
                std, of_dive = None, None if against is None else against(start)
                if isinstance(some, PathMean) and some.kind == "dac":
                    # profiles of the dive itself make the estimate surer than it was before the dive
                    known = innovation
                    if start is not before:
                        known = estimator.assimilate(start, [some])[1][-1].innovation
                    std, of_dive = known.innovation_std, known.innovation
                if of_dive is None or np.isnan(of_dive).all():
                    of_dive = estimator.innovation(start, some)
                found = Assimilation(innovation, of_dive, std)
                steps.append((vehicle, Step(some, before, current, found)))
                if std is not None and len(dives) > 1:
                    # of many vehicles each would keep the state that its last dive began with, tens of megabytes
                    dives[vehicle] = Dive(start, _ENDED)
    ended = [Dive(current, _ENDED) if dive.number == _ENDED else dive for dive in dives]
    return current, ended, steps


def state_after(
    estimators: Sequence[Estimator[Any]], given: Sequence[Given], size: int, unused: int
) -> Any:
    """Return the estimator's state after all measurements but those of a vehicle, whose window goes with it.

    Args:
        estimators: As of ``assimilate``.
        given: All measurements.
        size: Of the blocks in which they are given.
        unused: Number of the vehicle.
    """
    current = estimators[0].initial()
    for begin in range(0, len(given), size):
        block = given[begin : begin + size]
        for _, of_estimator in groupby(block, key=lambda one: id(estimators[one[0]])):
            own = list(of_estimator)
            number, measured = own[0][0], [event for _, event in own]
            estimator: Estimator[Any] = estimators[number]
            if number == unused:
                for event in measured:
                    current = estimator.moved(current, event)  # type: ignore[arg-type]
            else:
                current, _ = estimator.assimilate(current, measured)  # type: ignore[arg-type]
            current = estimator.without_left(current)
    return current


def kept(estimator: Estimator[Any], dive: Dive) -> Dive:
    """Return the dive without windows that vehicles have left: of its start the vehicle's window alone."""
    return replace(dive, start=estimator.of_own(estimator.without_left(dive.start)))
