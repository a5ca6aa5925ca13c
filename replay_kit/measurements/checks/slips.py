"""Errors of axes, signs, units and declination in logged velocities; and their correction.

Every fault maps true velocities to logged ones; ``undo`` is its inverse.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.message import Message
from replay_kit.core.observation import Profiles
from replay_kit.logs.tables.columns import number
from replay_kit.logs.tables.instruments import SCHEMA, declination_in
from replay_kit.measurements.checks.likelihood import SIGNS, UNITS

# degrees; a smaller declination is within a compass' error
_LEAST_DECLINATION = 1.0
# Factors that stand for any between those of units.
_OTHERS = (2.0, 10.0)
_DECLINATION = (
    ("not applied", "check the compass' settings and declination_applied", 1.0),
    ("applied twice", "check whether the instrument and the logger both apply it", -1.0),
)


def slips() -> dict[str, Array]:
    """Return M, shape (2, 2), with true = M logged, of errors of axes and signs and of units that are too fast, by description."""
    scales = {f"in {name}": factor for name, factor in UNITS.items()}
    scales |= {f"{factor:g} times too fast": factor for factor in _OTHERS}
    signs = {name: np.reshape(matrix, (2, 2)) for _, _, name, matrix, _ in SIGNS}
    return signs | {name: np.eye(2) / factor for name, factor in scales.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Sounding:
    """Profile with the declination that its message states.

    Attributes:
        profile: Profile as read, alone.
        declination: Magnetic declination [degrees east]; NaN if not stated.
    """

    profile: Profiles
    declination: float


class Fault(NamedTuple):
    """Possible fault of a log.

    Attributes:
        name: Short unique description.
        advice: What to check.
        undo: Returns the profile without the fault.
    """

    name: str
    advice: str
    undo: Callable[[Sounding], Profiles]


def declination_of(message: Message) -> float:
    """Return the magnetic declination [degrees east] in a ping; NaN for other or malformed messages."""
    if message.schema == SCHEMA:
        return declination_in(message.payload)
    held = message.payload if isinstance(message.payload, Mapping) else {}
    return number(held.get("magnetic_declination"))


def direction_faults(soundings: Sequence[Sounding]) -> list[Fault]:
    """Return the faults that keep speeds: axes, signs, and the declination if stated.

    Args:
        soundings: Profiles of the log.
    """
    faults = [
        Fault(name, advice, partial(_mapped, np.reshape(matrix, (2, 2))))
        for _, _, name, matrix, advice in SIGNS
    ]
    stated = [abs(one.declination) for one in soundings if math.isfinite(one.declination)]
    if stated and float(np.median(stated)) >= _LEAST_DECLINATION:
        faults += [
            Fault(f"the declination was {what}", advice, partial(_rotated, turns))
            for what, advice, turns in _DECLINATION
        ]
    return faults


def _mapped(matrix: Array, sounding: Sounding) -> Profiles:
    return sounding.profile.changed(velocity=sounding.profile["velocity"] @ matrix.T)


def _rotated(turns: float, sounding: Sounding) -> Profiles:
    """Return a profile rotated clockwise from magnetic to true axes by the declination, if stated."""
    angle = math.radians(turns * np.nan_to_num(sounding.declination))
    cosine, sine = math.cos(angle), math.sin(angle)
    return _mapped(np.array([[cosine, sine], [-sine, cosine]]), sounding)
