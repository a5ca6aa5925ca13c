"""The usual faults of velocities and depths: one table of hypotheses, and how each fault is undone.

``hypotheses`` is the table: what velocities may be instead of right. ``pairs.py`` compares all of them with each other, and with none,
where two sources measured one current; the comparison with an ensemble takes those that leave speeds as they are, and the faults of depth.
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

# degrees; smaller turns are biases of a compass, which the estimator can estimate, and not faults
_LEAST_TURN, _STEP = 20, 10
KNOTS = 1.943844
# Factors from m/s to the units for which m/s are mistaken. Ten and two stand for any factor between those of units.
_SCALES = ((KNOTS, "knots"), (2.0, ""), (1.0 / 0.3048, "ft/s"), (3.6, "km/h"), (10.0, ""), (100.0, "cm/s"), (1000.0, "mm/s"))  # fmt: skip
#: By kind of hypothesis, the cause that it shares with others.
CAUSES = {
    "turn": "wrong directions",
    "mirror": "wrong directions",
    "unit": "a wrong scale",
    "scale": "a wrong scale",
    "offset": "a constant offset",
    "drift": "a drift",
}
# Of each turn and each mirror that is no slip: mirrors about an odd bearing need two faults at once.
_NO_SLIP = {"turn": 0.45 / 32.0, "mirror": 0.05 / 33.0}
#: Of hypotheses.
KINDS = tuple(CAUSES)
# Slips of axes and units are the usual ones. Those of one cause share it: turns with mirrors, units with scales.
_PRIORS = {"turn": 0.4, "mirror": 0.4, "unit": 0.4, "scale": 0.4, "offset": 0.15, "drift": 0.05}
#: The cause of units and other scales.
SCALE_CAUSE = CAUSES["unit"]
# Smaller ones are not told from a vehicle's error of its own speed, where velocities are relative to it.
_LEAST_UNIT = 3.0
_MIRRORS = {
    0: "the sign of north is wrong",
    90: "east and north are exchanged",
    180: "the sign of east is wrong",
}
# degrees; a smaller declination is within a compass' error
_LEAST_DECLINATION = 1.0
# By kind and angle of the slip.
_ADVICE = {
    ("mirror", 90): "check which component comes first",
    ("mirror", 180): "check whether the first component grows to the west",
    ("mirror", 0): "check whether the second component grows to the south",
    (
        "turn",
        180,
    ): "check whether directions are where the current comes from, or velocities are the vehicle's through the water",
}


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What the first vectors of pairs may be instead of equal to the second ones.

    A turn, a mirror or a scale is a matrix M with true = M logged; an offset or a drift is added to the true ones.

    Attributes:
        name: What the logged vectors are.
        kind: ``turn``, ``mirror``, ``unit`` (of a factor of 3 and more), ``scale`` (of a smaller one), ``offset`` or ``drift``.
        angle: A turn's, clockwise [degrees]; a mirror's, twice that of its axis from east to north; else 0.
        scale: How many times as fast the first vectors are as the second ones.
        errors: How many times as large as of the second vectors the errors of what it leaves, M a - b, are counted.
        unit: That of the first vectors, or of the second ones where the scale is below 1; empty for a scale that is no unit's.
    """

    name: str
    kind: str
    angle: int = 0
    scale: float = 1.0
    errors: float = 1.0
    unit: str = ""

    @property
    def is_slip(self) -> bool:
        """Whether it is an exchange of axes or of signs."""
        return self.angle == 180 or (self.kind == "mirror" and self.angle in _MIRRORS)

    @property
    def cause(self) -> str:
        """What it has in common with hypotheses that are no rivals of it."""
        return CAUSES[self.kind]

    @property
    def prior(self) -> float:
        """Its probability before any pair, given that something is wrong: of directions half is that of the slips."""
        of_cause = _PRIORS[self.kind]
        if self.kind in ("turn", "mirror"):
            return of_cause * (0.125 if self.is_slip else _NO_SLIP[self.kind])
        return of_cause * (0.5 / (len(_SCALES) + 2) if self.kind in ("unit", "scale") else 1.0)

    @property
    def matrix(self) -> Array:
        """Its matrix M, shape (2, 2); that of equality for what is added."""
        cosine, sine = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
        if self.kind == "mirror":
            return np.array([[cosine, sine], [sine, -cosine]])
        # what was turned clockwise is turned back counter-clockwise
        return np.array([[cosine, -sine], [sine, cosine]]) / self.scale


def kinds_of(cause: str, among: Sequence[str]) -> tuple[str, ...]:
    """Return the kinds of hypotheses of a cause, of some kinds, in their order."""
    return tuple(kind for kind in among if CAUSES[kind] == cause)


@cache
def hypotheses() -> tuple[Hypothesis, ...]:
    """Return the table: turns, mirrors, scales of the first vectors and of the second ones, an offset and a drift."""
    turns = [
        Hypothesis(_turn_name(angle), "turn", angle)
        for angle in range(_LEAST_TURN, 361 - _LEAST_TURN, _STEP)
    ]
    mirrors = [Hypothesis(_mirror_name(angle), "mirror", angle) for angle in range(0, 360, _STEP)]
    scales = [
        Hypothesis(
            f"in {unit}" if unit else "several times too fast",
            "unit" if scale >= _LEAST_UNIT else "scale",
            scale=scale,
            unit=unit,
        )
        for scale, unit in _SCALES
    ]
    # the faster ones, with errors of their unit, or the slower ones with those of the faster: of larger factors both are found
    scales += [replace(each, errors=1.0 / each.scale) for each in scales if each.kind == "scale"]
    slower = [
        replace(
            each,
            name=f"{each.name}, of the other source",
            scale=1.0 / each.scale,
            errors=each.errors * each.scale,
        )
        for each in scales
    ]
    added = [Hypothesis(f"off by {CAUSES[kind]}", kind) for kind in ("offset", "drift")]
    return (*turns, *mirrors, *scales, *slower, *added)


def _turn_name(angle: int) -> str:
    return f"turned by {angle if angle <= 180 else angle - 360:+d} degrees clockwise" + (
        ", both signs wrong" if angle == 180 else ""
    )


def _mirror_name(angle: int) -> str:
    return (
        _MIRRORS.get(angle)
        or f"mirrored about the bearing {(90.0 - 0.5 * angle) % 180.0:g} degrees"
    )


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
        Fault(each.name, _ADVICE[each.kind, each.angle], partial(_mapped, each.matrix))
        for each in hypotheses()
        if each.is_slip
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
