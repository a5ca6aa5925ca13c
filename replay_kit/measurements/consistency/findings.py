"""The findings of the checks, in words: name, evidence, likely cause, what to set."""

from collections.abc import Sequence

from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import Observation, PathMean
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.consistency.pairs import SCALES, Explanation
from replay_kit.measurements.consistency.raw import RawHistory
from replay_kit.measurements.consistency.tracks import Passages

DEAD = "dead or stale instrument"
COMPASS = "compass or instrument turned"
CONTRADICTION = "two sources of the current contradict each other"
UNDECIDED = "two sources of the current contradict each other, and the cause is not certain"
UNIT = "unit of the velocities"
SCALE = "scale of the velocities"
OFFSET = "constant offset between two sources of the current"
DRIFT = "drift between two sources of the current"
DEPTH = "depths above the surface"
DEPTHS = "depth of the instrument and depth of the vehicle"
CLOCK = "clock of the instrument"
ERRORS = "stated errors"
BEAM = "a beam of the instrument"
MEANS = "mean currents"
RECKONED = "mean currents and dead reckoning contradict each other"
DUPLICATES = "messages logged twice"
FROZEN = "frozen positions"
REPEATED = "the last fix repeated under water"
DISPLACED = "displaced positions"
PLACES = "positions of several missions"
TRACKS = "these logs hold two tracks that no one vehicle can join"
ENSEMBLE_UNIT = "unit of the ensemble"
ENSEMBLE = "log and ensemble contradict each other"
FORECAST = "components or unit of the forecast"
PREFERRED = "the gate prefers one source of the current to another"
MISFIT = "the forecast does not fit this water"
MISFIT_OF_MOVED = "the ensemble that was moved here does not fit this water"
#: What two sources of the current may be found to be; while none of them is known to be right, the gate rejects neither.
OF_SOURCES = frozenset({CONTRADICTION, UNDECIDED, SCALE, OFFSET, DRIFT})
# Scale from which no slip but that of a unit explains a ratio.
_GROSS = 8.0
# What measurements.velocity_unit can be.
_STATED = ("knots", "cm/s", "mm/s")
# Probability below which a cause is not given, and from which rivals are not.
_LEAST_SHARE, _SURE = 0.01, 0.99

#: Causes with their probabilities, the likeliest first.
Rivals = Sequence[tuple[str, float]]

OF_MOTION = "changes of the measured velocity follow those of the platform's velocity"
OF_TRACK = "the platform's stated velocity contradicts that of its positions"
OF_VEHICLE = "relative to the vehicle, profiles contradict the mean currents of dives"
_SOURCE = {
    "dac": "mean currents of dives",
    "drift": "drifts at the surface",
    "shear": "geostrophic shears",
    "radar": "radar currents",
    "drifters": "drifters",
    "sensors": "other sensors",
}


def dead(history: RawHistory, ping: Observation) -> Finding:
    """Return the finding of raw values that no living instrument gives."""
    return Finding(
        DEAD,
        ping.time_ns,
        f"{ping.source.topic}: {history.evidence}",
        "an instrument that is off or hangs, or a logger that repeats its last message",
        "those profiles are not used; check the instrument's power and its logger",
    )


def of_sources(explanation: Explanation, rivals: Rivals, mean: PathMean, topic: str) -> Finding:
    """Return the finding of profiles and mean currents, or drifts, of which either may be wrong.

    Args:
        explanation: What explains the profiles by the other source.
        rivals: Causes with their probabilities, the likeliest first.
        mean: The last one of the other source.
        topic: Of the profiles.
    """
    fault, other = explanation.fault, _SOURCE[mean.kind]
    severity: Severity = "inconsistent"
    name, evidence, cause, advice = (
        CONTRADICTION,
        f"profiles of {topic} and {other}: the profiles look {_names(explanation)}",
        f"the axes or signs of the profiles, or those of the {other}",
        f"the gate is relaxed for both; check their frames and withhold the wrong one (--without {mean.kind}, or profiles)",
    )
    if fault.kind in SCALES:
        gross, about = fault.scale >= _GROSS, "" if fault.unit else "about "
        name, severity = (UNIT, "unusable") if gross else (SCALE, severity)
        evidence = (
            f"{topic}: the profiles are {about}{fault.scale:.4g} times as fast as the {other}"
        )
        of = "velocities" if fault.scale > 1.0 else other
        units = dict.fromkeys(each.unit for each in (fault, *explanation.alike) if each.unit)
        cause = f"a wrong unit or scale of the profiles, or of the {other}"
        if units:
            cause = f"the {of} are in {' or '.join(units)}, taken for m/s"
        stated = f' = "{fault.unit}"' if fault.unit in _STATED and fault.scale > 1.0 else ""
        advice = f"state measurements.velocity_unit{stated}, or check both sources"
    elif fault.kind in ("offset", "drift"):
        name, unit = (OFFSET, "m/s") if fault.kind == "offset" else (DRIFT, "m/s an hour")
        east, north = explanation.amount
        evidence = f"profiles of {topic} less {other}: {east:+.3f} east, {north:+.3f} north {unit}"
        cause = f"the velocity of the platform that is in the profiles, an instrument's offset, or the flight model behind the {other}"
    if rivals[0][1] < _SURE:
        cause = f"{cause}; {_odds(rivals)}"
    evidence, since_ns = f"{evidence} ({_strength(explanation)})", explanation.since_ns
    return Finding(name, since_ns or mean.time_ns, evidence, cause, advice, severity)


def of_reckoning(explanation: Explanation, mean: PathMean) -> Finding:
    """Return the finding of mean currents with a slip of axes or signs beside those that fixes and dead-reckoned positions give."""
    return Finding(
        RECKONED,
        explanation.since_ns or mean.time_ns,
        f"{mean.source.topic}: beside fixes and dead-reckoned positions the mean currents look {_names(explanation)} "
        f"({_strength(explanation)})",
        "the axes or signs of the mean currents",
        'check which variable is east; withhold them (--without dac), or compute them (measurements.dead_reckoning = "through_water")',
    )


def undecided(best: Explanation, rivals: Rivals, mean: PathMean, topic: str) -> Finding:
    """Return the finding of profiles and mean currents that contradict each other in a way that several causes explain."""
    other = _SOURCE[mean.kind]
    return Finding(
        UNDECIDED,
        best.since_ns or mean.time_ns,
        f"profiles of {topic} and {other}: {best.pairs} pairs are not of one current (likelihood ratio e^{best.gain:.0f})",
        f"not known yet, as the current and the heading hardly change; {_odds(rivals)}",
        f"the gate is relaxed for both; check both, and withhold the wrong one (--without {mean.kind}, or profiles)",
    )


def _odds(rivals: Rivals) -> str:
    chances = (f"{one} {100.0 * share:.0f} %" for one, share in rivals if share >= _LEAST_SHARE)
    return f"odds of the causes: {', '.join(chances)}"


def equal_means(mean: PathMean, since_ns: int, number: int) -> Finding:
    """Return the finding of mean currents that are equal to the last digit, dive after dive."""
    east, north = mean.velocity
    return Finding(
        MEANS,
        since_ns,
        f"{mean.source.topic}: {number} dives in a row have the mean current {east:g} east, {north:g} north m/s",
        "a mean current that was never computed, and is logged as zero or as the last one",
        "withhold them (--without dac), or compute them from dead reckoning",
    )


def too_fast(reason: str, number: int, total: int) -> Finding:
    """Return the finding of a log whose mean currents are faster than any current, and are skipped for that, most or all."""
    return Finding(
        SCALE,
        0,
        f"{number} of {total} mean currents were skipped ({reason})",
        "mean currents in cm/s or mm/s, taken for m/s",
        "correct their unit, or withhold them (--without dac)",
    )


def turned(explanation: Explanation, what: str, time_ns: int, topic: str) -> Finding:
    """Return the finding of an instrument that is turned."""
    return Finding(
        COMPASS,
        explanation.since_ns or time_ns,
        f"{topic}: {what}; relative to the vehicle the profiles look {_names(explanation)} ({_strength(explanation)})",
        "the compass, the sign of the heading or of the declination, the order of the beams, or how the instrument is mounted; "
        "of a DVL its axes, where forward, left and up are taken for forward, starboard and down (measurements.dvl_axes)",
        "its profiles are not used, the estimate is rebuilt without them; correct the instrument's settings and replay again",
        distrusts=True,
    )


def scaled_motion(explanation: Explanation, time_ns: int, topic: str) -> Finding:
    """Return the finding of a platform whose stated velocity is another one than that of its positions by a factor."""
    return Finding(
        SCALE,
        explanation.since_ns or time_ns,
        f"{topic}: beside that of its positions the platform's stated velocity looks {_names(explanation)} ({_strength(explanation)})",
        "a wrong unit or scale of the platform's velocity, and of the profiles that it is in",
        "state measurements.velocity_unit, or correct the platform's velocity",
    )


def two_tracks(passages: Passages, names: Sequence[str]) -> Finding:
    """Return the finding of logs of two vehicles.

    Args:
        passages: Between the two logs, one of them at least out of reach.
        names: Of the logs, in order of their numbers.
    """
    assert passages.example is not None
    one, other = sorted(passages.example, key=lambda position: position.source.input)
    apart = float(distance(one.longitude, one.latitude, other.longitude, other.latitude)) / 1e3
    placed = (
        f"{place_text(each.longitude, each.latitude)} at {time_text(each.time_ns)}"
        for each in (one, other)
    )
    return Finding(
        TRACKS,
        0,
        f"{names[one.source.input]} and {names[other.source.input]}; of {passages.number} ways from a position of the one to the next "
        f"of the other {passages.beyond} are longer than a vehicle travels in that time, the last one {apart:.0f} km ({', '.join(placed)})",
        "two vehicles, or a clock or receiver that was wrong most of the time",
        'name the vehicles (--as NAME=LOG), or replay each alone; consistency.on_failure = "ignore" takes them for one vehicle',
        "unusable",
    )


def ensemble_unit(evidence: str, source: str) -> Finding:
    """Return the finding of an ensemble whose speeds no ocean has."""
    return Finding(
        ENSEMBLE_UNIT,
        0,
        f"{source}: {evidence}",
        "velocities in cm/s or knots that the file calls m/s",
        'convert the ensemble and correct its units; consistency.on_failure = "ignore" takes it as it is',
        "unusable",
    )


def ensemble_contradicts(evidence: str, time_ns: int = 0) -> Finding:
    """Return the warning that a log and an ensemble do not fit."""
    return Finding(
        ENSEMBLE,
        time_ns,
        evidence,
        "an ensemble of another region or season, of too few members, or errors of the profiles that are stated too small",
        "warning only; replay-kit info --ensemble lists faults of the log that would explain it",
        "warning",
    )


def forecast_fault(faults: Sequence[str], gain: float, dives: int) -> Finding:
    """Return the warning that a forecast looks as if its file were wrong, in one of some ways."""
    return Finding(
        FORECAST,
        0,
        f"by {dives} mean currents of dives the forecast's currents look {', or '.join(faults)} (likelihood ratio e^{gain:.0f})",
        "exchanged components, a sign or a unit in the forecast's file; or an eddy that is elsewhere than forecast",
        "check the names, signs and units of the forecast's velocities",
        "warning",
    )


def preferred(rejected: str, kept: str, evidence: str) -> Finding:
    """Return the finding of a gate that rejects most measurements of one source, by its kind, and keeps those of another."""
    words = {"profiles": "the profiles", **_SOURCE}
    return Finding(
        PREFERRED,
        0,
        f"{words[rejected]} were rejected and {words[kept]} kept: {evidence}",
        f"{words[rejected]} and {words[kept]} are not of one current: either may be wrong, or its stated error is too small",
        f"check both, and withhold the wrong one (--without {rejected} or {kept})",
    )


def source_misfit(kind: str, nis: float, values: int) -> Finding:
    """Return the finding that a source's values are farther from the estimate than their errors say."""
    return Finding(
        PREFERRED,
        0,
        f"{_SOURCE[kind]}: normalised innovation squared {nis:.1f} per value, of {values}",
        f"{_SOURCE[kind]} and the estimate are not of one current, or their stated errors are too small",
        f"compare the results with and without them (--without {kind})",
        "warning",
    )


def forecast_misfit(evidence: str, moved: bool) -> Finding:
    """Return the finding that most measurements are none of those that the forecast expects.

    Args:
        evidence: The figures.
        moved: Whether the ensemble was moved to the log: it is no forecast of this water, so that a misfit is no news.
    """
    if moved:
        advice = (
            "treat the estimate as a demonstration; for a reliable one give a forecast of this area"
        )
        return Finding(
            MISFIT_OF_MOVED,
            0,
            evidence,
            "the ensemble was moved from elsewhere (--place-ensemble)",
            advice,
            "warning",
        )
    return Finding(
        MISFIT,
        0,
        evidence,
        "a forecast of another place or time, members that differ too little, or errors of the measurements that are stated too small",
        "do not rely on this estimate; give a forecast of this area; replay-kit info --ensemble lists faults of a log that look the same",
        "misfit",
    )


def _names(explanation: Explanation) -> str:
    found = (explanation.fault, *explanation.alike)
    return ", or ".join(dict.fromkeys(each.name for each in found))


def _strength(explanation: Explanation) -> str:
    return f"likelihood ratio e^{explanation.gain:.0f}, {100.0 * explanation.favoured:.0f} % of {explanation.pairs} pairs agree"
