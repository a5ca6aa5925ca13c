"""Dives between fixes, from whose displacements surfacings are predicted in a log without DACs.

A dive's mean velocity over ground is the sum of its velocity through the water and the current, which no flight model separates here. The
estimate predicts the current before the dive, halfway along a dive like the last one. The remainder of earlier dives is their velocity
through the water, assumed to persist unless the pilot steers elsewhere. Outside the estimate's region the velocity over ground persists
instead.
"""

from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.as_flown import FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, Profiles, VehicleState
from replay_kit.core.surfacing import Basis, forecast_place
from replay_kit.estimator.next_dive.process import FIXES_STD, DiveMean
from replay_kit.measurements.means import Path, Spot, begun, extended, path_mean
from replay_kit.measurements.track.dives import SurfacingState, detect_surfacing
from replay_kit.workflows.replay.events import Track

_NO_DEPTH = np.empty(0)
_NOWHERE = dict.fromkeys(Spot._fields, _NO_DEPTH) | {"time": np.empty(0, np.int64)}
#: Levels [m], shape (Z,), and the current there, shape (Z, 2) [m/s], true east and north.
Ahead = tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """Finished dive.

    Attributes:
        mean: The dive in the form of the model.
        fixes: Fixes before and after it.
        number: Number of the dive; 0 if unknown.
        basis: Basis of its prediction.
        flown: Flight through the water; None if unknown.
        path: Depths along its path and fractions of time around them, which sum to one, each shape (m,); empty if not needed.
    """

    mean: DiveMean
    fixes: tuple[Fix, Fix]
    number: int
    basis: Basis = "mean_currents"
    flown: FlownDive | None = None
    path: tuple[Array, Array] = (_NO_DEPTH, _NO_DEPTH)


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Positions of a log without DACs since the last dive.

    Attributes:
        detection: Detection of surfacings.
        latest: Last fix at the surface; None before the first.
        path: Path since the fix before the dive; None at the surface.
        ahead: Current predicted before the dive; None outside the estimate.
    """

    detection: SurfacingState = field(default_factory=SurfacingState)
    latest: VehicleState | None = None
    path: Path | None = None
    ahead: Ahead | None = None


def watched(
    state: Between, event: VehicleState | Profiles, surface_depth: float, last: Dive | None
) -> tuple[Between, Dive | None, bool]:
    """Return the state after the surfacing that an event shows, the dive ended by it, if any, and whether another dive begins.

    Args:
        state: State before the event.
        event: Position or profile, in log order.
        surface_depth: Depth above which the vehicle is at the surface [m].
        last: Last dive.
    """
    detection, end = detect_surfacing(state.detection, event, surface_depth)
    before, path, dive = state.detection, state.path, None
    begins = _in_dive(detection) and (end is not None or not _in_dive(before))
    state = replace(state, detection=detection)
    if end is None:
        return state, None, begins
    if path is not None and end.time_ns > path.start.time:
        # a dive's profiles may have waited for the fix after it
        first_ns = int(event["time"][0]) if isinstance(event, Profiles) else event.time_ns
        number = (detection if first_ns <= end.time_ns else before).dive
        dive = _surfaced(path, end, number, state.ahead, last)
    return replace(state, path=None), dive, begins


def dived(state: Between, fix: VehicleState, flow: FlowEstimate, last: Dive | None) -> Between:
    """Return the state at the beginning of a dive from a fix, with the estimate of that time; ``last`` is the last dive."""
    return replace(state, path=begun(_spot(fix)), ahead=ahead_of(fix, flow, last))


def moved(state: Between, event: VehicleState | Profiles, surface_depth: float) -> Between:
    """Return the state after a position, or after the depth of a profile's first bin if positions have none."""
    path = state.path
    if isinstance(event, Profiles):
        known = event["depth"][0][np.isfinite(event["depth"][0])]
        if path is None or path.reckoned or not known.size:
            return state
        return replace(state, path=extended(path, _NOWHERE, known.min(keepdims=True)))
    if not event.dead_reckoned and not event.depth > surface_depth:
        return replace(state, latest=event)
    if path is None:
        return state
    more = {name: np.array([part]) for name, part in _spot(event)._asdict().items()}
    return replace(state, path=extended(path, more, _NO_DEPTH))


def adrift(state: Between, track: Track, surface_depth: float) -> Between | None:
    """Return the state after fixes at the surface between dives; None for other positions."""
    below = track.columns["dead_reckoned"].any() or (track.columns["depth"] > surface_depth).any()
    if below or _in_dive(state.detection):
        return None
    latest = track[-1]
    return replace(state, detection=replace(state.detection, fix=latest), latest=latest)


def _surfaced(
    path: Path, end: VehicleState, number: int, ahead: Ahead | None, last: Dive | None
) -> Dive:
    """Return the dive along a path to a fix."""
    mean = path_mean(path, _spot(end), (0.0, 0.0), 0.0)
    depth, weight = mean["path_depth"], mean["weight"]
    start, fix = (Fix(at.time, at.longitude, at.latitude) for at in (path.start, _spot(end)))
    seconds, velocity = over_ground(start, fix)
    current, basis = predicted(ahead, last, depth, weight)
    dive = DiveMean(
        time_ns=(start.time_ns + fix.time_ns) // 2,
        seconds=seconds,
        way=np.zeros(2),
        velocity=velocity,
        backgrounds=current[None],
        position_std=FIXES_STD,
    )
    flown = flown_dive(seconds, velocity - current, depth, path.deepest) if ahead else None
    return Dive(dive, (start, fix), number, basis, flown, (depth, weight))


def over_ground(start: Fix, end: Fix) -> tuple[float, Array]:
    """Return the time between two fixes [s], and the mean velocity, shape (2,) [m/s]."""
    seconds = (end.time_ns - start.time_ns) * 1e-9
    frame = Projection(start.longitude, start.latitude)
    return seconds, np.array(to_local(frame, end.longitude, end.latitude)) / seconds


def _spot(position: VehicleState) -> Spot:
    return Spot(position.time_ns, position.longitude, position.latitude, position.depth)


def _in_dive(detection: SurfacingState) -> bool:
    return detection.submerged or not detection.reported


def ahead_of(fix: VehicleState, flow: FlowEstimate, last: Dive | None) -> Ahead | None:
    """Return the current predicted halfway along a dive like the last one from a fix; None outside the estimate."""
    place = fix.longitude, fix.latitude
    if last is not None:
        place = forecast_place(Fix(0, *place), 0.5 * last.mean.seconds, last.mean.velocity)
    east, north = to_local(flow.grid.projection, *place)
    if not inside_grid(flow.grid, east, north):
        return None
    return flow.levels, flow.velocity(east, north, flow.levels, true_axes=True)


def path_average(depth: Array, weight: Array, levels: Array, velocity: Array) -> Array:
    """Return the mean current over depths, shape (2,) [m/s]; constant beyond the levels.

    Args:
        depth: shape (m,) [m].
        weight: shape (m,), sums to one.
        levels: shape (Z,) [m], increasing.
        velocity: shape (Z, 2) [m/s].
    """
    return np.array([weight @ np.interp(depth, levels, component) for component in velocity.T])


def predicted(
    ahead: Ahead | None, last: Dive | None, depth: Array, weight: Array
) -> tuple[Array, Basis]:
    """Return the predicted mean current over depths, shape (2,) [m/s], and its basis.

    Outside the estimate it is the current of the last dive, or NaN before the first.
    """
    if ahead is not None:
        return path_average(depth, weight, *ahead), "estimate"
    known = np.full(2, np.nan) if last is None else np.asarray(last.mean.backgrounds[0])
    return known, "displacements"
