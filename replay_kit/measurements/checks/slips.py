"""Slips of whoever writes velocities and depths: of axes, signs, units and the declination; and how each is undone.

Every fault turns true velocities or depths into those logged; ``undo`` is its inverse. What a fault needs to know beside the profile
is in a ``Sounding``.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.logs.tables.columns import number
from replay_kit.logs.tables.frames import SCHEMA, declination_in
from replay_kit.measurements.checks.likelihood import UNITS, family

# degrees; a smaller declination is within a compass' error
_LEAST_DECLINATION = 1.0
# Factors that stand for any between those of units.
_OTHERS = (2.0, 10.0)
_ADVICE = {
    "east and north are exchanged": "check which component comes first",
    "the sign of east is wrong": "check whether the first component grows to the west",
    "the sign of north is wrong": "check whether the second component grows to the south",
    "turned by +180 degrees clockwise, both signs wrong": "check whether directions are where the current comes from, or velocities are the "
    "vehicle's through the water",
}


@dataclass(frozen=True, slots=True, eq=False)
class Slip:
    """What velocities are instead of the true ones.

    Attributes:
        name: In words.
        matrix: M, shape (2, 2), with true = M logged.
        is_scale: Whether it is a unit, or another scale.
    """

    name: str
    matrix: Array
    is_scale: bool = False


@cache
def slips() -> tuple[Slip, ...]:
    """Return the slips of axes and signs, and of units in which velocities are too fast."""
    found = []
    for kind in ("turn", "mirror"):
        of = family(kind)
        for factor, name in zip(of.factor, of.slip, strict=True):
            if name:
                # a = g b or g b*, for b along either axis
                columns = np.array([1.0, 1j]) / factor
                columns = np.conj(columns) if kind == "mirror" else columns
                found.append(Slip(name, np.array([columns.real, columns.imag])))
    scales = {f"in {name}": factor for name, factor in UNITS.items()}
    scales |= {f"{factor:g} times too fast": factor for factor in _OTHERS}
    return (*found, *(Slip(name, np.eye(2) / factor, True) for name, factor in scales.items()))


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
    """

    name: str
    advice: str
    undo: Callable[[Sounding], Observation]


def declination_of(message: Message) -> float:
    """Return the magnetic declination [degrees east] that a ping states; NaN for any other message, and for a malformed one."""
    if message.schema == SCHEMA:
        return declination_in(message.payload)
    held = message.payload if isinstance(message.payload, Mapping) else {}
    return number(held.get("magnetic_declination"))


def direction_faults(soundings: Sequence[Sounding]) -> list[Fault]:
    """Return the faults that leave speeds as they are: axes, signs, and the declination where the log states one.

    Args:
        soundings: The log's profiles.
    """
    faults = [
        Fault(each.name, _ADVICE[each.name], partial(_mapped, each.matrix))
        for each in slips()
        if not each.is_scale
    ]
    stated = [
        abs(sounding.declination) for sounding in soundings if math.isfinite(sounding.declination)
    ]
    if stated and float(np.median(stated)) >= _LEAST_DECLINATION:
        faults += [
            Fault(
                "the declination was not applied",
                "check the compass' settings and declination_applied",
                partial(_turned, 1.0),
            ),
            Fault(
                "the declination was applied twice",
                "check whether the instrument and the logger both apply it",
                partial(_turned, -1.0),
            ),
        ]
    return faults


def depth_faults() -> list[Fault]:
    """Return the faults of the depth's sign: of the cells, of the instrument, and of where the instrument looks."""
    name, advice = (
        "the sign of depth is wrong",
        "check whether depths and z grow downwards, and whether the instrument looks up",
    )
    return [
        Fault(name, advice, lambda sounding: _at(sounding, -sounding.observation.depth)),
        Fault(name, advice, lambda s: _at(s, s.observation.depth + 2.0 * _known(s.vehicle_depth))),
        Fault(name, advice, lambda s: _at(s, 2.0 * _known(s.vehicle_depth) - s.observation.depth)),
    ]


def _known(vehicle_depth: float) -> float:
    """Return how deep the vehicle is, whatever the sign it was logged with; a log that never says is a surface vessel's."""
    return abs(vehicle_depth) if math.isfinite(vehicle_depth) else 0.0


def _mapped(matrix: Array, sounding: Sounding) -> Observation:
    return replace(sounding.observation, velocity=sounding.observation.velocity @ matrix.T)


def _turned(turns: float, sounding: Sounding) -> Observation:
    declination = sounding.declination if math.isfinite(sounding.declination) else 0.0
    return replace(
        sounding.observation,
        velocity=turned_clockwise(sounding.observation.velocity, turns * declination),
    )


def turned_clockwise(velocity: Array, degrees: float) -> Array:
    """Return vectors, shape (n, 2), turned clockwise: from magnetic to true axes by the declination [degrees east]."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.asarray(velocity @ np.array([[cosine, -sine], [sine, cosine]]))


def _at(sounding: Sounding, depth: Array) -> Observation:
    return replace(sounding.observation, depth=depth)
