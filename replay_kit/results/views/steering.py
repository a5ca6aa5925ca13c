"""A glider that steers for waypoints through gridded currents: when it arrives, and how far it misses.

The report's page flies the same rule in the browser (``flight.js``). At each surfacing the glider aims at its next waypoint and cancels the
cross-track part of the current that it expects, as gliders do with the mean current of their last dive. A dive that would pass the
waypoint is made shallower, and ends there as far as the expected current holds. A waypoint is reached when the glider surfaces within
its radius, and given up after two such dives: the glider does not circle.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.results.slices import depth_slice

#: Steps of a dive and its climb.
STEPS = 24
#: The least dive, as a share of a whole one.
LEAST_DIVE = 0.02
#: Shallower dives for one waypoint.
TRIES = 2


@dataclass(frozen=True, slots=True, eq=False)
class GriddedCurrents:
    """Currents that do not change, on one regular grid of the local frame.

    Attributes:
        depths: shape (D,) [m], increasing.
        east: shape (I,) [m], evenly spaced.
        north: shape (J,) [m], evenly spaced.
        velocity: shape (K, D, 2, J, I) [m/s], local east and north; 0 where dry.
    """

    depths: Array
    east: Array
    north: Array
    velocity: Array

    def at(self, flow: int, place: Array, depth: float) -> Array:
        """Return the current (2,) [m/s] of a flow at a place (2,) [m]: linear between the grid's points, constant beyond its ends."""
        at = ((self.depths, depth), (self.north, float(place[1])), (self.east, float(place[0])))
        (d, fd), (j, fj), (i, fi) = (_cell(axis, value) for axis, value in at)
        corners = self.velocity[flow, d : d + 2, :, j : j + 2, i : i + 2]
        level = corners[0] if corners.shape[0] == 1 else corners[0] + fd * (corners[1] - corners[0])
        row = level[:, 0] + fj * (level[:, 1] - level[:, 0])
        return np.asarray(row[:, 0] + fi * (row[:, 1] - row[:, 0]))


@dataclass(frozen=True, slots=True)
class Dives:
    """How a glider dives.

    Attributes:
        speed: Through water [m/s].
        glide_angle_deg: Below the horizontal.
        depth: Of a whole dive [m].
        surface_time: Drift between dives [s].
        radius: Within which a waypoint is reached [m].
        max_duration: After which it gives up [s].
    """

    speed: float
    glide_angle_deg: float
    depth: float
    surface_time: float
    radius: float
    max_duration: float

    @property
    def along(self) -> float:
        """Horizontal speed through water [m/s]."""
        return self.speed * float(np.cos(np.deg2rad(self.glide_angle_deg)))

    @property
    def duration(self) -> float:
        """Of a whole dive and its climb [s]."""
        return 2.0 * self.depth / (self.speed * float(np.sin(np.deg2rad(self.glide_angle_deg))))


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A flight to the last of some waypoints.

    Attributes:
        duration: Until it arrived, or gave up [s].
        miss: Distance from the last waypoint then [m].
        arrived: Whether it did not give up.
        surfacings: shape (n, 2) [m], from the start on.
    """

    duration: float
    miss: float
    arrived: bool
    surfacings: Array


def gridded_currents(flow: FlowEstimate, depths: Array, samples: int, seed: int) -> GriddedCurrents:
    """Return the mean of an estimate, and samples of it after the mean, on the grid of its published slices.

    Args:
        flow: The estimate.
        depths: shape (D,) [m].
        samples: Their number; 0 for an estimate without uncertainty.
        seed: Of the samples.
    """
    flows = [flow.mean_flow(), *(flow.sample(samples, seed) if samples else ())]
    each = [[depth_slice(one, float(depth)) for depth in depths] for one in flows]
    velocity = np.stack(
        [np.stack([np.moveaxis(value.velocity, -1, 0) for value in slices]) for slices in each]
    )
    return GriddedCurrents(
        np.asarray(depths, dtype=np.float64),
        each[0][0].east,
        each[0][0].north,
        np.nan_to_num(velocity),
    )


def fly_to_waypoints(
    currents: GriddedCurrents, flow: int, dives: Dives, start: Array, waypoints: Sequence[Array]
) -> Arrival:
    """Return how a glider arrives that steers for waypoints one after another.

    Args:
        currents: The currents; the glider expects those of the first flow until its first surfacing.
        flow: Which of the flows it flies in.
        dives: How it dives.
        start: shape (2,) [m], at the surface.
        waypoints: Each shape (2,) [m].
    """
    place, time, surfacings = (
        np.asarray(start, dtype=np.float64),
        0.0,
        [np.asarray(start, dtype=np.float64)],
    )
    depths = np.linspace(0.0, dives.depth, STEPS + 1)
    expected = np.mean([currents.at(0, place, depth) for depth in depths], axis=0)
    for waypoint in waypoints:
        tries, passed = 0, False
        while not passed and time < dives.max_duration:
            through, share = _steer(dives, np.asarray(waypoint) - place, expected)
            begin, duration = place, share * dives.duration
            place = _dive(currents, flow, place, through, share * dives.depth, duration)
            expected = (place - begin) / duration - through
            time += duration
            tries += share < 1.0
            passed = tries == TRIES or float(np.linalg.norm(waypoint - place)) <= dives.radius
            if not passed:
                place = place + dives.surface_time * currents.at(flow, place, 0.0)
                time += dives.surface_time
            surfacings.append(place)
        if not passed:
            break
    miss = float(np.linalg.norm(np.asarray(waypoints[-1]) - place))
    return Arrival(time, miss, passed, np.array(surfacings))


def _steer(dives: Dives, ahead: Array, expected: Array) -> tuple[Array, float]:
    """Return the horizontal velocity through water (2,) [m/s] towards a place, and the share of a whole dive that leads there."""
    far = float(np.linalg.norm(ahead))
    direction = ahead / far if far > 0.0 else np.array([0.0, 1.0])
    left = np.array([-direction[1], direction[0]])
    across = float(np.clip(-expected @ left, -dives.along, dives.along))
    forward = float(np.sqrt(dives.along**2 - across**2))
    made_good = forward + float(expected @ direction)
    share = far / (made_good * dives.duration) if made_good > 0.0 else 1.0
    return forward * direction + across * left, min(max(share, LEAST_DIVE), 1.0)


def _dive(
    currents: GriddedCurrents,
    flow: int,
    place: Array,
    through: Array,
    depth: float,
    duration: float,
) -> Array:
    """Return where a dive and its climb end, by the midpoint rule."""
    step = duration / STEPS
    for at in _middles():
        now, middle = (depth * (1.0 - abs(2.0 * share - 1.0)) for share in at)
        half = place + 0.5 * step * (through + currents.at(flow, place, now))
        place = place + step * (through + currents.at(flow, half, middle))
    return place


def _middles() -> Iterator[tuple[float, float]]:
    """Yield the beginning and the middle of each step, as shares of the dive."""
    for k in range(STEPS):
        yield k / STEPS, (k + 0.5) / STEPS


def _cell(axis: Array, value: float) -> tuple[int, float]:
    """Return the cell of an axis that a value lies in, and where in it, 0 to 1."""
    if axis.size == 1:
        return 0, 0.0
    # numbers of Python: a flight looks up thousands of cells, and numpy's functions of one number take ten times as long
    k = min(max(int(axis.searchsorted(value, side="right")) - 1, 0), axis.size - 2)
    begin, end = float(axis[k]), float(axis[k + 1])
    return k, min(max((value - begin) / (end - begin), 0.0), 1.0)
