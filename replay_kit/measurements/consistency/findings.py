"""The findings of the checks, in words: name, evidence, likely cause, what to set."""

from collections.abc import Sequence

from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import Observation, PathMean
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.consistency.pairs import Explanation
from replay_kit.measurements.consistency.raw import RawHistory
from replay_kit.measurements.consistency.tracks import Passages

DEAD = "dead or stale instrument"
COMPASS = "compass or instrument turned"
CONTRADICTION = "two sources of the current contradict each other"
UNIT = "unit of the velocities"
KNOTS = "velocities in knots"
DEPTH = "depths above the surface"
FROZEN = "frozen positions"
PLACES = "positions of several missions"
TRACKS = "these logs hold two tracks that no one vehicle can join"
ENSEMBLE_UNIT = "unit of the ensemble"
ENSEMBLE = "log and ensemble contradict each other"
MISFIT = "the forecast does not fit this water"
MISFIT_OF_MOVED = "the ensemble that was moved here does not fit this water"
# Scale from which no slip but that of a unit explains a ratio.
_GROSS = 8.0

OF_MOTION = "changes of the measured velocity follow those of the platform's velocity"
OF_TRACK = "the platform's stated velocity contradicts that of its positions"
OF_VEHICLE = "relative to the vehicle, profiles contradict the mean currents of dives"
_SOURCE = {"dac": "mean currents of dives", "drift": "drifts at the surface"}


def dead(history: RawHistory, ping: Observation) -> Finding:
    """Return the finding of raw values that no living instrument gives."""
    return Finding(
        DEAD,
        ping.time_ns,
        f"{ping.source.topic}: {history.evidence}",
        "an instrument that is off or hangs, or a logger that repeats its last message",
        "those profiles are not used; check the instrument's power and its logger",
    )


def unit(explanation: Explanation, mean: PathMean, topic: str) -> Finding:
    """Return the finding of velocities in another unit than the mean currents'."""
    scale, name = explanation.map.scale, explanation.map.unit
    gross, stated, about = scale >= _GROSS, f' = "{name}"' if name else "", "" if name else "about "
    return Finding(
        UNIT if gross else KNOTS,
        mean.time_ns,
        f"{topic}: the profiles are {about}{scale:.4g} times as fast as the {_SOURCE[mean.kind]} ({_strength(explanation)})",
        f"the velocities are in {name}, taken for m/s"
        if name
        else "a wrong unit or scale of the profiles",
        f"state measurements.velocity_unit{stated}, or check both sources",
        "unusable" if gross else "inconsistent",
    )


def contradiction(explanation: Explanation, mean: PathMean, topic: str) -> Finding:
    """Return the finding of two sources of which either may be wrong."""
    other = _SOURCE[mean.kind]
    return Finding(
        CONTRADICTION,
        mean.time_ns,
        f"profiles of {topic} and {other}: the profiles look {_names(explanation)} ({_strength(explanation)})",
        f"the axes or signs of the profiles, or those of the {other}",
        f"the gate is relaxed for both; check their frames and withhold the wrong one (--without {mean.kind}, or profiles)",
    )


def turned(explanation: Explanation, what: str, time_ns: int, topic: str) -> Finding:
    """Return the finding of an instrument that is turned."""
    return Finding(
        COMPASS,
        time_ns,
        f"{topic}: {what}; relative to the vehicle the profiles look {_names(explanation)} ({_strength(explanation)})",
        "the compass, the sign of the heading or of the declination, or how the instrument is mounted",
        "its profiles are not used, the estimate is rebuilt without them; correct the heading or the mounting and replay again",
        distrusts=True,
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
        'replay each alone; consistency.on_failure = "ignore" takes them for one vehicle',
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
        "an ensemble of another region or season, or errors of the profiles that are stated too small",
        "warning only; replay-kit info --ensemble lists faults of the log that would explain it",
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
    return ", or ".join(each.name for each in (explanation.map, *explanation.alike))


def _strength(explanation: Explanation) -> str:
    return f"likelihood ratio e^{explanation.gain:.0f}, {100.0 * explanation.favoured:.0f} % of {explanation.pairs} pairs agree"
