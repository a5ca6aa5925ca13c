"""Mean currents between fixes: a dive's depth-averaged current, stated or computed.

A depth-averaged current is how far a vehicle surfaced from where its motion through the water alone would have brought it, over the
time between the fixes; it is the mean of the current along the path (``dead_reckoning.py``).
"""

import math
from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import replace
from replay_kit.core.observation import Fix, PathMean, Source, VehicleState
from replay_kit.measurements.vehicle.dead_reckoning import (
    Path,
    at_depth,
    begin,
    drift_velocity,
    extend,
    path_mean,
)
from replay_kit.measurements.vehicle.dives import dive_begins

# s; a stated fix this near in time to one of the log's is that fix
_SAME_FIX_NS = 60 * 10**9
#: Why a mean current is not used that no current is.
TOO_FAST = "depth-averaged current: faster than measurements.max_speed"


@dataclass(frozen=True, slots=True)
class MeanCurrent:
    """A mean current that a message states.

    Attributes:
        velocity: True east and north [m/s].
        error_std: Of each component [m/s]; NaN when not stated.
        start: The fix before the dive; None when not stated.
        end: The fix after it; None when not stated.
        dive: Number of its dive; None when not stated.
        max_depth: Greatest depth of its dive [m]; NaN when not stated.
        inverted: Whether its dive has profiles that were computed from it, among other things.
    """

    velocity: tuple[float, float]
    error_std: float
    start: Fix | None
    end: Fix | None
    dive: int | None
    max_depth: float = math.nan
    inverted: bool = False


@dataclass(frozen=True, slots=True)
class Dives:
    """What is remembered of the way since the last fixes.

    Attributes:
        path: Since the last fix at the surface; None before the first.
        done: The last dive's path, and the fix that ended it, until its mean current comes.
        stated: Whether the log states mean currents itself.
        computed_ns: Time of the fix that ended the last dive whose mean current was computed [ns, UTC].
    """

    path: Path | None = None
    done: tuple[Path, VehicleState] | None = None
    stated: bool = False
    computed_ns: int | None = None


def stated_mean(
    dives: Dives, mean: MeanCurrent, dive: int, source: Source, config: MeasurementConfig
) -> tuple[Dives, PathMean | str]:
    """Return what is remembered after a stated mean current, and the current with its path, or why it is not used.

    Args:
        dives: What was remembered before.
        mean: The current.
        dive: Its dive's number.
        source: The message.
        config: The errors of currents that state none, and the fastest that is believed.
    """
    if not _believed(mean.velocity, config):
        return dives, TOO_FAST
    dives = replace(dives, stated=True)
    if (
        mean.end is not None
        and dives.computed_ns is not None
        and mean.end.time_ns <= dives.computed_ns + _SAME_FIX_NS
    ):
        return dives, "depth-averaged current: already computed from dead reckoning"
    found = _path_of(dives, mean, source)
    if found is None:
        return (
            dives,
            "depth-averaged current: no path, and no fixes with a depth",
        )
    path, end = found
    error = (
        mean.error_std
        if math.isfinite(mean.error_std)
        else _error(path, end, config.dac_std, config)
    )
    done = None if dives.done is not None and dives.done[1].time_ns <= end.time_ns else dives.done
    whole = path_mean(path, replace(end, source=source), mean.velocity, error, "dac", dive)
    whole = replace(whole, beside_profiles=mean.inverted and config.use_inverted)
    if not _is_path(whole):
        return dives, "depth-averaged current: no path from its first fix to its last"
    return replace(dives, done=done), whole


def record_depth(dives: Dives, depth: float) -> Dives:
    """Return what is remembered after a depth."""
    path = dives.path
    if path is None or (deeper := at_depth(path, depth)) is path:
        return dives
    return _on(dives, deeper)


def record_position(
    dives: Dives, position: VehicleState, submerged: bool, dive: int, config: MeasurementConfig
) -> tuple[Dives, list[PathMean]]:
    """Return what is remembered after a position, and the mean currents that it completes.

    Args:
        dives: What was remembered before.
        position: A fix, or a dead-reckoned position.
        submerged: Whether the vehicle is in a dive.
        dive: Number of the last dive.
        config: Which mean currents are computed, and their errors.
    """
    path = dives.path
    if position.dead_reckoned or submerged:
        return (dives if path is None else replace(dives, path=extend(path, position))), []
    if path is not None and position.time_ns <= path.start.time_ns:
        return dives, []
    dived = path is not None and dive_begins(path.deepest, config.surface_depth)
    if path is None or not dived:
        return replace(dives, path=begin(position)), []
    after = replace(dives, path=begin(position), done=(path, position))
    if config.dead_reckoning == "corrected" or dives.stated or not path.reckoned:
        return after, []
    velocity = drift_velocity(path, position)
    if not _believed(velocity, config):
        return after, []
    mean = path_mean(
        path, position, velocity, _error(path, position, config.dac_std, config), "dac", dive
    )
    return replace(after, done=None, computed_ns=position.time_ns), [mean] if _is_path(mean) else []


def _on(dives: Dives, path: Path) -> Dives:
    """Return what is remembered, with another path; each position gives one."""
    return Dives(path, dives.done, dives.stated, dives.computed_ns)


def _is_path(mean: PathMean) -> bool:
    """Return whether a path leads from place to place; between opposite sides of the Earth no way is the shortest."""
    return bool(np.isfinite(mean.longitude + mean.latitude + mean.depth).all())


def _believed(velocity: tuple[float, float], config: MeasurementConfig) -> bool:
    return all(abs(component) <= config.max_speed for component in velocity)


def _error(path: Path, end: VehicleState, own_std: float, config: MeasurementConfig) -> float:
    """Return the error of a component [m/s]: its own, and that of the two fixes over the time between them."""
    seconds = (end.time_ns - path.start.time_ns) * 1e-9
    return math.hypot(own_std, math.sqrt(2.0) * config.fix_std / seconds)


def _path_of(dives: Dives, mean: MeanCurrent, source: Source) -> tuple[Path, VehicleState] | None:
    """Return the path that a stated mean current belongs to, and the fix that ends it; None when neither is known."""
    if (
        dives.done is not None
        and _same(dives.done[0].start, mean.start)
        and _same(dives.done[1], mean.end)
    ):
        return dives.done
    start, end = mean.start, mean.end
    if start is None or end is None or end.time_ns <= start.time_ns:
        return None
    last = VehicleState(*end, 0.0, False, source)
    path = dives.path
    if (
        path is not None
        and _same(path.start, start)
        and path.last.time_ns <= end.time_ns
        and math.isfinite(path.deepest)
    ):
        # the fix after the dive has not come yet
        return path, last
    deepest = mean.max_depth
    if not math.isfinite(deepest):
        deepest = max(
            (known.deepest for known in (path, dives.done and dives.done[0]) if known is not None),
            key=_finite,
            default=math.nan,
        )
    if not math.isfinite(deepest):
        return None
    return replace(begin(VehicleState(*start, 0.0, False, source)), deepest=deepest), last


def _finite(value: float) -> float:
    return value if math.isfinite(value) else -math.inf


def _same(fix: VehicleState, stated: Fix | None) -> bool:
    return stated is None or abs(fix.time_ns - stated.time_ns) <= _SAME_FIX_NS
