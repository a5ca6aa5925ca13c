"""Faults that a log may have been made with, and how each is undone.

Every fault turns true velocities or depths into those logged; ``undo`` is its inverse. What a fault needs to know beside the profile
is in a ``Sounding``.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.measurements.events import MALFORMED
from replay_kit.measurements.messages.fields import number
from replay_kit.measurements.messages.kinds import statement
from replay_kit.measurements.messages.mavlink_ping import PingFrame, declination_in
from replay_kit.measurements.messages.profiles import StatedPing

# degrees; a smaller declination is within a compass' error
_LEAST_DECLINATION = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Sounding:
    """A profile with what its message and its vehicle state beside.

    Attributes:
        observation: The profile as it was read.
        declination: [degrees east], NaN when the log does not say.
        vehicle_depth: [m], NaN when the log does not say.
    """

    observation: Observation
    declination: float
    vehicle_depth: float


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """One way in which a log can be wrong.

    Attributes:
        name: A few words that tell it from the others.
        advice: What a person should look at.
        undo: The profile as it would be without the fault.
        log_scale: Natural logarithm of how many times too large the speeds are.
        moves: Whether it changes depths or stated errors, not velocities alone.
    """

    name: str
    advice: str
    undo: Callable[[Sounding], Observation]
    log_scale: float = 0.0
    moves: bool = False


def declination_of(message: Message) -> float:
    """Return the magnetic declination [degrees east] that a ping states; NaN for any other message, and for a malformed one."""
    try:
        stated = statement(message)
    except (MeasurementError, *MALFORMED):
        return math.nan
    if isinstance(stated, PingFrame):
        return declination_in(stated)
    return number(stated.payload.get("magnetic_declination")) if isinstance(stated, StatedPing) else math.nan


def direction_faults(soundings: Sequence[Sounding]) -> list[Fault]:
    """Return the faults that leave speeds as they are: axes, signs, and the declination where the log states one.

    Args:
        soundings: The log's profiles.
    """
    faults = [
        Fault("east and north are exchanged", "check which component comes first", partial(_mirrored, [[0.0, 1.0], [1.0, 0.0]])),
        Fault(
            "the sign of east is wrong",
            "check whether the first component grows to the west",
            partial(_mirrored, [[-1.0, 0.0], [0.0, 1.0]]),
        ),
        Fault(
            "the sign of north is wrong",
            "check whether the second component grows to the south",
            partial(_mirrored, [[1.0, 0.0], [0.0, -1.0]]),
        ),
        Fault(
            "both signs are wrong",
            "check whether directions are where the current comes from, or velocities are the vehicle's through the water",
            partial(_mirrored, [[-1.0, 0.0], [0.0, -1.0]]),
        ),
    ]
    stated = [abs(sounding.declination) for sounding in soundings if math.isfinite(sounding.declination)]
    if stated and float(np.median(stated)) >= _LEAST_DECLINATION:
        faults += [
            Fault("the declination was not applied", "check the compass' settings and declination_applied", partial(_turned, 1.0)),
            Fault("the declination was applied twice", "check whether the instrument and the logger both apply it", partial(_turned, -1.0)),
        ]
    return faults


def scale_faults() -> list[Fault]:
    """Return the faults of units, each with the stated errors in metres per second and in the fault's own unit."""
    units = (
        ("speeds are in cm/s", "state the unit, or divide by 100", 100.0),
        ("speeds are in mm/s", "state the unit, or divide by 1000", 1000.0),
        ("speeds are 100 times too small", "check whether m/s were divided as if they were cm/s", 0.01),
        ("speeds are 1000 times too small", "check whether m/s were divided as if they were mm/s", 0.001),
    )
    return [
        Fault(name, advice, partial(_rescaled, 1.0 / factor, with_errors), math.log(factor), with_errors)
        for name, advice, factor in units
        for with_errors in (False, True)
    ]


def depth_faults() -> list[Fault]:
    """Return the faults of the depth's sign: of the cells, of the instrument, and of where the instrument looks."""
    name, advice = "the sign of depth is wrong", "check whether depths and z grow downwards, and whether the instrument looks up"
    return [
        Fault(name, advice, lambda sounding: _at(sounding, -sounding.observation.depth), moves=True),
        Fault(name, advice, lambda s: _at(s, s.observation.depth + 2.0 * _known(s.vehicle_depth)), moves=True),
        Fault(name, advice, lambda s: _at(s, 2.0 * _known(s.vehicle_depth) - s.observation.depth), moves=True),
    ]


def _known(vehicle_depth: float) -> float:
    """Return how deep the vehicle is, whatever the sign it was logged with; a log that never says is a surface vessel's."""
    return abs(vehicle_depth) if math.isfinite(vehicle_depth) else 0.0


def _mirrored(matrix: Sequence[Sequence[float]], sounding: Sounding) -> Observation:
    # each of these matrices is its own inverse
    return replace(sounding.observation, velocity=sounding.observation.velocity @ np.array(matrix).T)


def _turned(turns: float, sounding: Sounding) -> Observation:
    declination = sounding.declination if math.isfinite(sounding.declination) else 0.0
    return replace(sounding.observation, velocity=turned_clockwise(sounding.observation.velocity, turns * declination))


def turned_clockwise(velocity: Array, degrees: float) -> Array:
    """Return vectors, shape (n, 2), turned clockwise: from magnetic to true axes by the declination [degrees east]."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.asarray(velocity @ np.array([[cosine, -sine], [sine, cosine]]))


def _rescaled(factor: float, with_errors: bool, sounding: Sounding) -> Observation:
    observation = sounding.observation
    errors = observation.error_std * factor if with_errors else observation.error_std
    return replace(observation, velocity=observation.velocity * factor, error_std=errors)


def _at(sounding: Sounding, depth: Array) -> Observation:
    return replace(sounding.observation, depth=depth)
