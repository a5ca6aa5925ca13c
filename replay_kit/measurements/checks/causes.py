"""Causes of what pairs show, the likeliest and its odds among all; and findings on a whole run: ensemble, forecast, sources and logs.

Causes in the vectors relative to the vehicle (compass, mounting) compete with causes in the currents (axes, scale, offset). If heading and
current hardly change, several explain the pairs: nothing is then excluded, and the odds of all are given.
"""

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.words.text import place_text, time_text
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
from replay_kit.measurements.checks.place import Passages
from replay_kit.measurements.checks.profile import SURFACE, UNIT
from replay_kit.measurements.checks.sensors import CLOCK, DEPTHS

COMPASS = "compass or instrument turned"
CONTRADICTION = "two sources of the current contradict each other"
UNDECIDED = "two sources of the current contradict each other, and the cause is not certain"
SCALE = "scale of the velocities"
OFFSET = "constant offset between two sources of the current"
DRIFT = "drift between two sources of the current"
MEANS = "repeated mean currents"
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
            quantity = "velocities" if size > 1.0 else "mean currents of dives"
            cause = f"the {quantity} are in {' or '.join(units)}, taken for m/s"
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


ENSEMBLE_UNIT = "unit of the ensemble"
FORECAST = "components or unit of the forecast"
PREFERRED = "the gate prefers one source of the current to another"
MISFIT = "the forecast does not fit this water"
MISFIT_OF_MOVED = "the ensemble that was moved here does not fit this water"
MIXED = "positions of two vehicles in one log"
TRACKS = "these logs hold two tracks that no one vehicle can join"
_SOURCES = {
    "profiles": "the profiles",
    "dac": "mean currents of dives",
    "shear": "geostrophic shears",
    "radar": "radar currents",
    "drifters": "drifters",
    "sensors": "other sensors",
}


def _concluded(
    name: str,
    evidence: str,
    cause: str,
    advice: str,
    severity: Severity = "inconsistent",
    /,
    **said: Any,
) -> Finding:
    """Return a finding on a whole run, from texts with fields in braces."""
    evidence, cause, advice = (text.format(**said) for text in (evidence, cause, advice))
    return Finding(name, 0, evidence, cause, advice, severity)


#: Most or all mean currents of a log were skipped as too fast.
too_fast = partial(
    _concluded,
    SCALE,
    "{number} of {total} mean currents were skipped ({reason})",
    "mean currents in cm/s or mm/s, taken for m/s",
    "correct their unit, or withhold them (--without dac)",
)
#: Many positions of one log are out of reach of the others.
mixed_tracks = partial(
    _concluded,
    MIXED,
    "{thrown} of {total} positions are out of the vehicle's reach",
    "two vehicles in one log, or a receiver that errs much of the time",
    "split the log by vehicle and name the parts (--as NAME=LOG)",
)
#: An ensemble's speeds are impossible in an ocean.
ensemble_unit = partial(
    _concluded,
    ENSEMBLE_UNIT,
    "{source}: {evidence}",
    "velocities in cm/s or knots called m/s, or undeclared fill values",
    'correct the file; consistency.on_failure = "ignore" takes it as it is',
    "unusable",
)
#: A forecast file seems wrong, with possible faults.
forecast_fault = partial(
    _concluded,
    FORECAST,
    "by {dives} mean currents of dives the forecast's currents look {faults} (likelihood ratio e^{gain:.0f})",
    "exchanged components, a sign or a unit in its file; or an eddy that is elsewhere",
    "check the names, signs and units of the forecast's velocities",
    "warning",
)
#: Most measurements are outside the forecast's uncertainty, by whether the ensemble was moved to the log, so that a misfit is expected.
forecast_misfit = {
    False: partial(
        _concluded,
        MISFIT,
        "{evidence}",
        "a forecast of another place or time, too narrow an ensemble, or stated errors that are too small",
        "do not rely on this estimate; give a forecast of this area; replay-kit info --ensemble lists faults of a log that look the same",
        "misfit",
    ),
    True: partial(
        _concluded,
        MISFIT_OF_MOVED,
        "{evidence}",
        "the ensemble was moved from elsewhere (--place-ensemble)",
        "the estimate is a demonstration; give a forecast of this area",
        "warning",
    ),
}


def preferred_source(rejected: str, kept: str, evidence: str) -> Finding:
    """Return the finding that the gate rejects most measurements of one source and accepts those of another."""
    one, other = _SOURCES[rejected], _SOURCES[kept]
    return Finding(
        PREFERRED,
        0,
        f"{one} were rejected and {other} kept: {evidence}",
        f"{one} and {other} are inconsistent: either may be wrong, or its stated error too small",
        f"check both, and withhold the wrong one (--without {rejected} or {kept})",
    )


def source_misfit(kind: str, nis: float, values: int) -> Finding:
    """Return the finding that a source's innovations exceed their stated errors."""
    source = _SOURCES[kind]
    return Finding(
        PREFERRED,
        0,
        f"{source}: normalised innovation squared {nis:.1f} per value, of {values}",
        f"{source} and the estimate are inconsistent, or their stated errors too small",
        f"compare the results with and without them (--without {kind})",
        "warning",
    )


def two_tracks(passages: Passages, names: Sequence[str]) -> Finding:
    """Return the finding that logs are from two vehicles.

    Args:
        passages: Passages between the two logs, at least one out of reach.
        names: Names of the logs in order of their numbers.
    """
    one, other = sorted(passages.example, key=lambda place: place.log)
    placed = (
        f"{place_text(each.longitude, each.latitude)} at {time_text(each.time_ns)}"
        for each in (one, other)
    )
    return Finding(
        TRACKS,
        0,
        f"{names[one.log]} and {names[other.log]}; {passages.beyond} of {passages.number} steps between them are "
        f"too long for one vehicle, the last one "
        f"{one.way(other) / 1e3:.0f} km ({', '.join(placed)})",
        "two vehicles, or a clock or receiver that was wrong most of the time",
        'name the vehicles (--as NAME=LOG), or replay each alone; consistency.on_failure = "ignore" takes them for one vehicle',
        "unusable",
    )
