"""Dives between fixes, from whose displacements surfacings are predicted in a log without DACs.

A dive's mean velocity over ground is the sum of its velocity through the water and the current, which no flight model separates here. The
estimate predicts the current before the dive, halfway along a dive like the last one. The remainder of earlier dives is their velocity
through the water, assumed to persist unless the pilot steers elsewhere. Outside the estimate's region the velocity over ground persists
instead.
"""

from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import FlownDive, flown_dive
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, VehicleState
from replay_kit.core.surfacing import Basis, forecast_place
from replay_kit.estimator.next_dive.process import FIXES_STD, DiveMean
from replay_kit.measurements.means import Path, Spot, path_mean
from replay_kit.measurements.track.dives import SurfacingState

_NO_DEPTH = np.empty(0)
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


def dive_along(
    path: Path, end: VehicleState, number: int, ahead: Ahead | None, last: Dive | None
) -> Dive:
    """Return the dive along a path to a fix."""
    mean = path_mean(path, spot_of(end), (0.0, 0.0), 0.0)
    depth, weight = mean["path_depth"], mean["weight"]
    start, fix = (Fix(at.time, at.longitude, at.latitude) for at in (path.start, spot_of(end)))
    seconds, velocity = over_ground(start, fix)
    current, basis = predicted_mean(ahead, last, depth, weight)
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


def spot_of(position: VehicleState) -> Spot:
    """Return a position as a point of a path."""
    return Spot(position.time_ns, position.longitude, position.latitude, position.depth)


def in_dive(detection: SurfacingState) -> bool:
    """Return whether the vehicle is in a dive."""
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


def predicted_mean(
    ahead: Ahead | None, last: Dive | None, depth: Array, weight: Array
) -> tuple[Array, Basis]:
    """Return the predicted mean current over depths, shape (2,) [m/s], and its basis.

    Outside the estimate it is the current of the last dive, or NaN before the first.
    """
    if ahead is not None:
        return path_average(depth, weight, *ahead), "estimate"
    known = np.full(2, np.nan) if last is None else np.asarray(last.mean.backgrounds[0])
    return known, "displacements"
