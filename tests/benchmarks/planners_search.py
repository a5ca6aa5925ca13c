"""The exhaustive search of one glide at the size that is asked: every heading and time to depth flown in a fine table of the flow."""

import weakref
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from planners.route.region import Region, region_of
from planners.track import fly_glide, fractions_of_duration
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.planners_masked import bounds

# Spacing of the table in kernel lengths: linear interpolation is then good to 1e-4 m/s.
_SPACING = 1.0 / 30.0
_STEPS = 40
_tables: "weakref.WeakKeyDictionary[FlowEstimate, Table]" = weakref.WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Table:
    """A flow at the points of a fine grid."""

    origin: Array
    spacing: Array
    levels: Array
    velocity: Array

    def at(self, points: Array) -> Array:
        """The flow at points (n, 3), nothing downwards."""
        column, row = ((points[:, :2] - self.origin) / self.spacing).T
        layer = np.interp(points[:, 2], self.levels, np.arange(self.levels.size, dtype=float))
        u, v = (
            map_coordinates(component, [layer, row, column], order=1, mode="nearest")
            for component in self.velocity
        )
        return np.column_stack([u, v, np.zeros_like(u)])


def tabulated(flow: FlowEstimate) -> Table:
    """Return a flow's table, made once."""
    if flow not in _tables:
        low, high = bounds(flow)
        lengths = np.array(
            [flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north]
        )
        size = np.ceil((high - low) / lengths / _SPACING).astype(int) + 1
        east, north = (np.linspace(low[i], high[i], size[i]) for i in (0, 1))
        rows = [flow.velocity(east[None], y, flow.levels[:, None]) for y in north]
        _tables[flow] = Table(
            low,
            (high - low) / (size - 1),
            flow.levels,
            np.ascontiguousarray(np.stack(rows, axis=1).transpose(3, 0, 1, 2)),
        )
    return _tables[flow]


def closest_by_search(
    flow: FlowEstimate,
    begin: Array,
    end: Array,
    speed: float,
    longest: float,
    headings: int = 360,
    times: int = 60,
) -> float:
    """Return the least closest approach [m] of all glides to the goal's depth, the best refined around and flown in the flow itself."""
    table, region, depth = tabulated(flow), region_of(flow.grid), end[2] - begin[2]
    heading = np.linspace(0.0, 2.0 * np.pi, headings, endpoint=False)
    log_time = np.linspace(np.log(max(abs(depth) / speed, 600.0)), np.log(longest), times)
    best = np.inf
    first = _fly(table, region, begin, end, speed, heading, log_time)
    for i in np.argsort(first, axis=None, kind="stable")[:3]:
        j, k = np.unravel_index(i, first.shape)
        at, width = (
            np.array([heading[j], log_time[k]]),
            np.array([heading[1] - heading[0], log_time[1] - log_time[0]]),
        )
        for _ in range(5):
            fine = [at[a] + width[a] * np.linspace(-1.2, 1.2, 13) for a in (0, 1)]
            fine[1] = np.clip(fine[1], log_time[0], log_time[-1])
            near = _fly(table, region, begin, end, speed, *fine)
            j, k = np.unravel_index(np.argmin(near), near.shape)
            at, width = np.array([fine[0][j], fine[1][k]]), 0.2 * width
        best = min(best, _exactly(flow, region, begin, end, speed, *at))
    return best


def _fly(
    table: Table,
    region: Region,
    begin: Array,
    end: Array,
    speed: float,
    heading: Array,
    log_time: Array,
) -> Array:
    """Return the least distance of each glide, (headings, times), along straight legs between its steps inside the region."""
    angle, lasts = (a.ravel() for a in np.meshgrid(heading, np.exp(log_time), indexing="ij"))
    down = (end[2] - begin[2]) / lasts
    along = np.sqrt(np.maximum(speed**2 - down**2, 0.0))
    through = np.column_stack([along * np.sin(angle), along * np.cos(angle), down])
    step = (lasts / _STEPS)[:, None]
    at = np.tile(begin, (angle.size, 1))
    best, inside = np.linalg.norm(at - end, axis=1), np.full(angle.size, True)
    for _ in range(_STEPS):
        k1 = through + table.at(at)
        k2 = through + table.at(at + step / 2 * k1)
        k3 = through + table.at(at + step / 2 * k2)
        after = at + step / 6 * (k1 + 2 * k2 + 2 * k3 + through + table.at(at + step * k3))
        inside &= region.inside(after)
        leg = after - at
        share = np.clip(
            np.sum((end - at) * leg, axis=1) / np.maximum(np.sum(leg**2, axis=1), 1e-12), 0.0, 1.0
        )
        best = np.where(
            inside, np.minimum(best, np.linalg.norm(at + share[:, None] * leg - end, axis=1)), best
        )
        at = after
    return best.reshape(heading.size, log_time.size)


def _exactly(
    flow: FlowEstimate,
    region: Region,
    begin: Array,
    end: Array,
    speed: float,
    heading: float,
    log_time: float,
) -> float:
    lasts = float(np.exp(log_time))
    down = (end[2] - begin[2]) / lasts
    along = np.sqrt(max(speed**2 - down**2, 0.0))
    through = np.array([along * np.sin(heading), along * np.cos(heading), down])
    track = fly_glide(
        flow, begin, through, lasts * fractions_of_duration(begin[2], end[2], flow.levels, 120)
    )
    return track.closest(end, track.allowed_until(region.allowed))[1]
