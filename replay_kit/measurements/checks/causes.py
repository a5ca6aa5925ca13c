"""Causes of what pairs show: the likeliest, its odds among all, and the finding that names it.

Causes in the vectors relative to the vehicle (compass, mounting) compete with causes in the currents (axes, scale, offset). If heading and
current hardly change, several explain the pairs: nothing is then excluded, and the odds of all are given.
"""

import math
from collections.abc import Iterable

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.measurements.checks.fold import Found, Memory, Rows
from replay_kit.measurements.checks.likelihood import (
    CAUSES,
    KINDS,
    RELATIVE,
    TURNED,
    Explanation,
    Source,
    causes,
    explanation,
    odds,
)
from replay_kit.measurements.checks.profile import SURFACE, UNIT
from replay_kit.measurements.checks.sensors import CLOCK, DEPTHS

COMPASS = "compass or instrument turned"
CONTRADICTION = "two sources of the current contradict each other"
UNDECIDED = "two sources of the current contradict each other, and the cause is not certain"
SCALE = "scale of the velocities"
OFFSET = "constant offset between two sources of the current"
DRIFT = "drift between two sources of the current"
MEANS = "mean currents"
RECKONED = "mean currents and dead reckoning contradict each other"
#: Of an instrument whose profiles are not used.
UNUSED = "profiles are not used"
#: What two sources of the current may be found to be; while none of them is known to be right, the gate rejects neither.
OF_SOURCES = frozenset({CONTRADICTION, UNDECIDED, SCALE, OFFSET, DRIFT})
#: What explains what mean currents show, or says more.
KNOWN = (OF_SOURCES - {UNDECIDED}) | {COMPASS, MEANS, DEPTHS, CLOCK, SURFACE, UNUSED}
# Pairs of mean currents, of dives relative to the vehicle, and of the platform's motion: twice the variance that is expected of a component
# of a dive's mean, of its mean relative to the vehicle, of one block and of a change of motion, and the least number.
CURRENT, OF_DIVES, OF_MOTION = Source(2.0 * 0.02**2, 3), Source(2.0 * 0.035**2, 2), Source(0.02, 4)
# Pairs that tell a gross unit.
_LEAST_UNITS = 2
# Log-likelihood ratio of a turn relative to the vehicle, the probability that the named cause has among all, and pairs from which on a
# contradiction is named without a cause, but with the odds of all.
_TURN_GAIN, LIKELY, _ENOUGH = 7.0, 0.98, 6
# Scale from which no slip but that of a unit explains a ratio; shares below which a cause is not given, and from which rivals are not.
_GROSS, _LEAST_SHARE, _SURE = 8.0, 0.01, 0.99
_OF_VEHICLE = " relative to the vehicle"
_OF_MEANS = "relative to the vehicle, profiles contradict the mean currents of dives"
_CHECK_BOTH = "the gate is relaxed for both; check {}, and withhold the wrong one (--without dac, or profiles)"
# What measurements.velocity_unit can be.
_STATED = ("knots", "cm/s", "mm/s")
HOUR_NS = 3.6e12


def cause_of(pairs: Memory, mean: Rows) -> list[Found]:
    """Return the finding of the likeliest cause at a mean current, if it is likely enough or there are many pairs.

    Args:
        pairs: ``current``, ``vehicle`` and ``blocks``, shapes (up to 128, 6).
        mean: Mean current, with the topic of the profiles.
    """
    current, vehicle = pairs["current"], pairs["vehicle"]
    if turned := explanation(pairs["blocks"], OF_MOTION, TURNED):
        return rotation_finding(mean, turned, _OF_MEANS, KNOWN)
    found = causes(current, CURRENT, KINDS)
    for cause, gain in causes(vehicle, OF_DIVES, RELATIVE).items():
        # a scale is one, whatever it is relative to
        name = cause if cause == CAUSES["scale"] else f"{cause}{_OF_VEHICLE}"
        found[name] = float(np.logaddexp(found.get(name, -math.inf), gain))
    if not found:
        return []
    rivals = odds(found)
    cause, share = rivals[0]
    if cause.endswith(_OF_VEHICLE):
        best = explanation(vehicle, OF_DIVES, TURNED, _TURN_GAIN)
        # what excludes an instrument must be certain
        if best is not None and share >= LIKELY:
            return rotation_finding(mean, best, _OF_MEANS, KNOWN)
    else:
        best = _best(current, vehicle, cause)
    if best is None:
        return []
    if best.kind not in TURNED and not best.is_unit:
        # what excludes a scale or an offset must be what the other leaves, not that its size is not known before
        kinds = ("offset", "drift") if best.kind in ("scale", "unit") else ("scale",)
        fits = causes(current, CURRENT, kinds, by_fit=True)
        rivals = odds({one: max(gain, fits.get(one, gain)) for one, gain in found.items()})
        share = dict(rivals)[cause]
    chances = (f"{one} {100.0 * each:.0f} %" for one, each in rivals if each >= _LEAST_SHARE)
    listed = f"odds of the causes: {', '.join(chances)}"
    if share >= LIKELY:
        return _source_finding(mean, best, "" if rivals[0][1] >= _SURE else f"; {listed}")
    if best.pairs < _ENOUGH:
        return []
    return finding_of(
        mean,
        best,
        UNDECIDED,
        "profiles and mean currents of dives are inconsistent",
        f"not known yet, as the current and the heading hardly change; {listed}",
        _CHECK_BOTH.format("both"),
        KNOWN,
    )


def _best(current: Array, vehicle: Array, cause: str) -> Explanation | None:
    """Return the best explanation of a cause; two pairs show only a gross unit error."""
    if cause != CAUSES["scale"]:
        kinds = [kind for kind in KINDS if CAUSES[kind] == cause]
        return explanation(current, CURRENT, kinds)
    found = (
        explanation(current, CURRENT._replace(least=_LEAST_UNITS), ("scale",)),
        explanation(vehicle, OF_DIVES._replace(least=CURRENT.least), ("unit",)),
    )
    told = [one for one in found if one and (one.pairs >= CURRENT.least or one.is_unit)]
    return max(told, key=lambda one: one.gain, default=None)


def finding_of(
    rows: Rows,
    explained: Explanation,
    name: str,
    evidence: str,
    cause: str,
    advice: str,
    unless: Iterable[str] = (),
) -> list[Found]:
    """Return the finding of an explanation, at its start or at the last of some rows, with its strength.

    Args:
        rows: Rows that established it.
        explained: Explanation.
        name: See ``Finding``.
        evidence: Evidence; its strength is appended.
        cause: See ``Finding``.
        advice: See ``Finding``.
        unless: See ``Found``.
    """
    agree = f"{100.0 * explained.favoured:.0f} % of {explained.pairs} pairs agree"
    return rows.first(
        rows.event == rows.event[-1],
        name,
        lambda _: f"{evidence} (likelihood ratio e^{explained.gain:.0f}, {agree})",
        cause,
        advice,
        "unusable" if name == UNIT else "inconsistent",
        name == COMPASS,
        unless,
        lambda k: round(explained.since * HOUR_NS) or rows["time"][k],
    )


def rotation_finding(
    rows: Rows, explained: Explanation, what: str, unless: Iterable[str] = ()
) -> list[Found]:
    """Return the finding of a rotated instrument from pairs of a kind."""
    return finding_of(
        rows,
        explained,
        COMPASS,
        f"{what}; relative to the vehicle the profiles look {explained.names}",
        "the compass, the sign of the heading or of the declination, the order of the beams, or how the instrument is mounted; "
        "of a DVL its axes, where forward, left and up are taken for forward, starboard and down (measurements.dvl_axes)",
        "its profiles are not used, the estimate is rebuilt without them; correct the instrument's settings and replay again",
        unless,
    )


def _source_finding(mean: Rows, best: Explanation, rivals: str) -> list[Found]:
    """Return the finding that profiles contradict mean currents or drifts, of which either may be wrong."""
    size = abs(best.value)
    if best.kind in TURNED:
        name = CONTRADICTION
        evidence = f"against mean currents of dives the profiles look {best.names}"
        cause = "the axes or signs of the profiles, or those of the mean currents of dives"
        advice = _CHECK_BOTH.format("their frames")
    elif best.kind in ("scale", "unit"):
        name = UNIT if size >= _GROSS else SCALE
        evidence = f"the profiles are {size:.3g} (x/ {math.exp(best.spread):.2f}) times as fast as the mean currents of dives"
        cause = "a wrong unit or scale of the profiles, or of the mean currents of dives"
        if units := list(dict.fromkeys(filter(None, best.slips))):
            of = "velocities" if size > 1.0 else "mean currents of dives"
            cause = f"the {of} are in {' or '.join(units)}, taken for m/s"
        stated = f' = "{best.slips[0]}"' * (best.slips[0] in _STATED and size > 1.0)
        advice = f"state measurements.velocity_unit{stated}, or check both sources"
    else:
        name, unit = (OFFSET, "m/s") if best.kind == "offset" else (DRIFT, "m/s an hour")
        evidence = f"profiles less mean currents of dives: {best.value.real:+.3f} east, {best.value.imag:+.3f} north {unit}"
        cause = (
            "the velocity of the platform that is in the profiles, an instrument's offset, "
            "or the flight model behind the mean currents of dives"
        )
        advice = _CHECK_BOTH.format("both")
    return finding_of(mean, best, name, evidence, cause + rivals, advice, KNOWN)
