"""Estimation stage: positions and observations in, the estimate before and after each out."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
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
    VehicleState,
)
from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.events import Aside, Event, Track

# Number of a dive whose mean current has come, after which a measurement of it begins it anew.
_ENDED = -1


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """Present dive of a vehicle.

    Attributes:
        start: Estimator's state before its first observation.
        number: Number of the dive.
    """

    # Any: each kind of estimator has a state of its own, which only it reads
    start: Any
    number: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Event with the estimate before and after it.

    Attributes:
        event: Consecutive positions or one of them, an observation or a group of profiles, or a DAC that is not assimilated.
        before: Estimator's state before it.
        after: Estimator's state after it.
        innovation: Innovation of an observation or group, and decision of the gate; None for others.
        dive_innovation: shape (n, 2) [m/s], innovation against the estimate before the observation's dive; for a group all bins of all
            profiles.
        dive_std: shape (1, 2) [m/s], predicted standard deviation of ``dive_innovation`` for a DAC; None for others.
    """

    event: Event | VehicleState
    before: Any
    after: Any
    innovation: Innovation | None = None
    dive_innovation: Array = field(default_factory=lambda: np.empty((0, 2)))
    dive_std: Array | None = None


#: An event with the number of its vehicle.
Given = tuple[int, Event]


def inputs_of(
    estimator: Estimator[Any] | type[Estimator[Any]],
) -> tuple[type[Measurement], ...]:
    """Return the types of observations that an estimator accepts."""
    sums = (PathMean, LinearMeasurement) if estimator.supports_path_means else ()
    return (Profiles, *sums)


def assimilate(
    estimators: Sequence[Estimator[Any]],
    current: Any,
    dives: Sequence[Dive],
    given: Sequence[Given],
) -> tuple[Any, list[Dive], list[tuple[int, Step]]]:
    """Return the estimator's state, the dives of all vehicles and the steps after events.

    Args:
        estimators: Estimator of each vehicle, all with one type of state.
        current: Estimator's state before.
        dives: Dive of each vehicle before.
        given: Events in order.
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
                if isinstance(some, PathMean):
                    # profiles of the dive itself make the estimate surer than it was before the dive
                    known = innovation
                    if start is not before:
                        known = estimator.assimilate(start, [some])[1][-1].innovation
                    std, of_dive = known.innovation_std, known.innovation
                if of_dive is None or np.isnan(of_dive).all():
                    of_dive = estimator.innovation(start, some)
                steps.append((vehicle, Step(some, before, current, innovation, of_dive, std)))
                if std is not None and len(dives) > 1:
                    # of many vehicles each would keep the state that its last dive began with, tens of megabytes
                    dives[vehicle] = Dive(start, _ENDED)
    ended = [Dive(current, _ENDED) if dive.number == _ENDED else dive for dive in dives]
    return current, ended, steps


def kept(estimator: Estimator[Any], dive: Dive) -> Dive:
    """Return the dive without the start of windows that vehicles have left; keeps the vehicle's window."""
    return replace(dive, start=estimator.of_own(estimator.without_left(dive.start)))
