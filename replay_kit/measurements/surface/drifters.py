"""Fixes of drifters to means of the current between them: displacement over time, at the depth of the drogue."""

import math
from dataclasses import dataclass, replace

from replay_kit.core.observation import Label, LinearMeasurement, Source, VehicleState
from replay_kit.measurements.messages.water import DrifterFix
from replay_kit.measurements.vehicle.dead_reckoning import begin, drift_velocity, extend, path_mean

# s; shortest and longest time between two fixes of a mean: tides are averaged, and the way between is known
_SHORTEST, _LONGEST = 3 * 3600, 26 * 3600
# m/s; a drogued drifter's slip through the water (Niiler and Paduan 1995, J. Phys. Oceanogr. 25), and the semidiurnal tide's period [s]
_SLIP, _PERIOD = 0.01, 12.42 * 3600.0


@dataclass(frozen=True, slots=True)
class Errors:
    """What errs.

    Attributes:
        fix_std: Of each component of a fix that states no error [m].
        tide_std: Speed of tides and inertial motion that the forecast does not hold [m/s].
    """

    fix_std: float
    tide_std: float


def displacement(
    first: tuple[Source, DrifterFix], last: tuple[Source, DrifterFix], errors: Errors, dive: int
) -> LinearMeasurement | None:
    """Return the mean current between two fixes of one drifter; None where they are too near in time, or too far.

    Args:
        first: Message and fix.
        last: The later one.
        errors: What errs.
        dive: Number of the vehicle's dive, for statistics.
    """
    seconds = (last[0].time_ns - first[0].time_ns) * 1e-9
    if not _SHORTEST <= seconds <= _LONGEST:
        return None
    before, after = (
        VehicleState(source.time_ns, fix.longitude, fix.latitude, fix.depth, False, source)
        for source, fix in (first, last)
    )
    velocity = drift_velocity(begin(before), after)
    # a drifter goes with the water: no way through it
    still = replace(after, longitude=before.longitude, latitude=before.latitude)
    places = math.hypot(
        *(errors.fix_std if math.isnan(fix.error) else fix.error for _, fix in (first, last))
    )
    turns = math.pi * seconds / _PERIOD
    tide = errors.tide_std * min(1.0, 1.0 / turns)
    error = math.hypot(places / seconds, _SLIP, tide)
    mean = path_mean(extend(begin(before), still), after, velocity, error, "drift", dive)
    return replace(mean.linear, label=Label(dive, last[0], kind="drifters"))


def is_over(first: Source, now: Source) -> bool:
    """Return whether a fix is too old to begin a mean that ends now."""
    return (now.time_ns - first.time_ns) * 1e-9 > _LONGEST
