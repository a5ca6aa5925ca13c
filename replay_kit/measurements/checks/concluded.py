"""Findings on a whole run: ensemble, forecast, sources and logs."""

from collections.abc import Sequence

from replay_kit.core.errors import Finding
from replay_kit.core.words.text import place_text, time_text
from replay_kit.measurements.checks.causes import SCALE
from replay_kit.measurements.checks.place import Passages

ENSEMBLE_UNIT = "unit of the ensemble"
FORECAST = "components or unit of the forecast"
PREFERRED = "the gate prefers one source of the current to another"
MISFIT = "the forecast does not fit this water"
MISFIT_OF_MOVED = "the ensemble that was moved here does not fit this water"
MIXED = "positions of two vehicles in one log"
TRACKS = "these logs hold two tracks that no one vehicle can join"
_SOURCE = {
    "dac": "mean currents of dives",
    "shear": "geostrophic shears",
    "radar": "radar currents",
    "drifters": "drifters",
    "sensors": "other sensors",
}


def too_fast(reason: str, number: int, total: int) -> Finding:
    """Return the finding that most or all mean currents of a log were skipped as too fast."""
    return Finding(
        SCALE,
        0,
        f"{number} of {total} mean currents were skipped ({reason})",
        "mean currents in cm/s or mm/s, taken for m/s",
        "correct their unit, or withhold them (--without dac)",
    )


def mixed_tracks(thrown: int, total: int) -> Finding:
    """Return the finding that many positions of one log are out of reach of the others."""
    return Finding(
        MIXED,
        0,
        f"{thrown} of {total} positions are out of the vehicle's reach",
        "two vehicles in one log, or a receiver that errs much of the time",
        "split the log by vehicle and name the parts (--as NAME=LOG)",
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


def ensemble_unit(evidence: str, source: str) -> Finding:
    """Return the finding that an ensemble's speeds are impossible in an ocean."""
    return Finding(
        ENSEMBLE_UNIT,
        0,
        f"{source}: {evidence}",
        "velocities in cm/s or knots called m/s, or undeclared fill values",
        'correct the file; consistency.on_failure = "ignore" takes it as it is',
        "unusable",
    )


def forecast_fault(faults: Sequence[str], gain: float, dives: int) -> Finding:
    """Return the warning that a forecast file seems wrong, with possible faults."""
    return Finding(
        FORECAST,
        0,
        f"by {dives} mean currents of dives the forecast's currents look {', or '.join(faults)} (likelihood ratio e^{gain:.0f})",
        "exchanged components, a sign or a unit in its file; or an eddy that is elsewhere",
        "check the names, signs and units of the forecast's velocities",
        "warning",
    )


def preferred(rejected: str, kept: str, evidence: str) -> Finding:
    """Return the finding that the gate rejects most measurements of one source and accepts those of another."""
    words = {"profiles": "the profiles", **_SOURCE}
    return Finding(
        PREFERRED,
        0,
        f"{words[rejected]} were rejected and {words[kept]} kept: {evidence}",
        f"{words[rejected]} and {words[kept]} are inconsistent: either may be wrong, or its stated error too small",
        f"check both, and withhold the wrong one (--without {rejected} or {kept})",
    )


def source_misfit(kind: str, nis: float, values: int) -> Finding:
    """Return the finding that a source's innovations exceed their stated errors."""
    return Finding(
        PREFERRED,
        0,
        f"{_SOURCE[kind]}: normalised innovation squared {nis:.1f} per value, of {values}",
        f"{_SOURCE[kind]} and the estimate are inconsistent, or their stated errors too small",
        f"compare the results with and without them (--without {kind})",
        "warning",
    )


def forecast_misfit(evidence: str, moved: bool) -> Finding:
    """Return the finding that most measurements are outside the forecast's uncertainty.

    Args:
        evidence: Figures.
        moved: Whether the ensemble was moved to the log, so that a misfit is expected.
    """
    if moved:
        advice = "the estimate is a demonstration; give a forecast of this area"
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
        "a forecast of another place or time, too narrow an ensemble, or stated errors that are too small",
        "do not rely on this estimate; give a forecast of this area; replay-kit info --ensemble lists faults of a log that look the same",
        "misfit",
    )
