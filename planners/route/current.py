"""Mean current on a lattice, and travel times along lines over ground at constant speed through water.

Vectors are complex, east + i north. Travel times follow Zermelo (1931).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.simulation.currents import Currents
from replay_kit.core.arrays import Array, points_over
from replay_kit.core.flow.estimate import FlowEstimate

Complex = NDArray[np.complex128]

# Points a kernel length of the table that the lattice is interpolated from by cubic splines: an error of some 1e-3 of the current.
_PER_LENGTH = 4.0
# Points of the lattice, about, and lines a kernel length at most; intervals of the table between two of them.
_POINTS, _LINES, _DIVISIONS = 7400, 10.0, 2


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLattice:
    """Current on a regular lattice, interpolated linearly in space and time, constant beyond.

    Attributes:
        origin: First point, shape (2,), east and north [m].
        spacing: Spacing along both axes [m].
        times: Times, shape (T,), increasing [s].
        values: Current, shape (T, n d + 1, m d + 1), east + i north [m/s], with d intervals between points.
        divisions: Number of intervals between points, d.
    """

    origin: Array
    spacing: float
    times: Array
    values: Complex
    divisions: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (points along north, points along east)."""
        rows, columns = self.values.shape[1:]
        return (rows - 1) // self.divisions + 1, (columns - 1) // self.divisions + 1

    @property
    def places(self) -> Complex:
        """Points, shape (n_north n_east,) [m], east + i north."""
        rows, columns = np.divmod(np.arange(self.shape[0] * self.shape[1]), self.shape[1])
        return complex(*self.origin) + self.spacing * (columns + 1j * rows)

    @property
    def fastest(self) -> float:
        """Greatest current speed of all points [m/s]."""
        return float(np.max(np.abs(self.values)))

    def at(self, places: Complex, times: Array) -> Complex:
        """Return the current at positions, shape (n,) [m], and times, shape (n,) [s]."""
        rows, columns = self.values.shape[1:]
        scale = self.divisions / self.spacing
        east = np.clip((places.real - self.origin[0]) * scale, 0.0, columns - 1.000001)
        north = np.clip((places.imag - self.origin[1]) * scale, 0.0, rows - 1.000001)
        column, row = east.astype(np.intp), north.astype(np.intp)
        east -= column
        north -= row
        corner, flat = row * columns + column, self.values.reshape(-1)
        if self.times.size == 1:
            return _between(flat, corner, columns, east, north)
        number = np.interp(times, self.times, np.arange(self.times.size, dtype=np.float64))
        slot = np.minimum(number.astype(np.intp), self.times.size - 2)
        number -= slot
        corner += slot * (rows * columns)
        before = _between(flat, corner, columns, east, north)
        return before + number * (
            _between(flat, corner + rows * columns, columns, east, north) - before
        )


def _between(
    flat: Complex, corner: NDArray[np.intp], columns: int, east: Array, north: Array
) -> Complex:
    """Return values interpolated bilinearly in cells given by their lower left corners."""
    lower, upper = flat.take(corner), flat.take(corner + columns)
    lower += east * (flat.take(corner + 1) - lower)
    upper += east * (flat.take(corner + columns + 1) - upper)
    return lower + north * (upper - lower)


def spacing_over(flow: FlowEstimate) -> float:
    """Return the spacing of a lattice over a flow's region [m], limited by the kernel length."""
    area = float(np.ptp(flow.grid.east) * np.ptp(flow.grid.north))
    return float(max(np.sqrt(area / _POINTS), flow.horizontal.kernel.lengths.min() / _LINES))


def current_lattice(
    flow: FlowEstimate, latent: Array, times: Array, spacing: float, by_depth: Array
) -> CurrentLattice:
    """Return the mean current over a flow's region on a lattice.

    Args:
        flow: Flow with region, levels and functions.
        latent: Latent values, shape (M, Z T), all levels of the first time first.
        times: Times, shape (T,), increasing [s]; one arbitrary time for a steady flow.
        spacing: Spacing of the lattice [m].
        by_depth: Weight of each level in the mean, shape (Z,).
    """
    low, high = flow.grid.ends
    intervals = np.maximum(np.ceil((high - low) / spacing - 1e-9).astype(int), 1)
    mean = np.stack([part @ by_depth for part in np.split(latent, times.size, axis=1)], axis=1)
    lengths = flow.horizontal.kernel.lengths
    coarse = np.maximum(np.ceil((high - low) / lengths * _PER_LENGTH).astype(int) + 1, 4)
    at = [np.linspace(*span) for span in zip(low, low + spacing * intervals, coarse, strict=True)]
    table = (
        flow.horizontal.velocity(points_over(*at), mean)
        .reshape(2, coarse[1], coarse[0], times.size)
        .transpose(0, 3, 1, 2)
    )
    to_east, to_north = (
        _splines(coarse[axis], _DIVISIONS * intervals[axis] + 1) for axis in (0, 1)
    )
    u, v = to_north @ table @ to_east.T
    return CurrentLattice(low, spacing, times, u + 1j * v, _DIVISIONS)


def _splines(count: int, finer: int) -> Array:
    """Return the matrix of a cubic spline from even to denser points, shape (finer, count)."""
    # as scipy's CubicSpline with no knot beside the ends, which takes as long to load as a plan takes
    unit, change = np.eye(count), np.diff(np.eye(count), axis=0)
    slopes, sides = 4.0 * unit + np.eye(count, k=1) + np.eye(count, k=-1), np.zeros_like(unit)
    sides[1:-1] = 3.0 * (change[:-1] + change[1:])
    for end, sign in (0, 1), (-1, -1):
        slopes[end, end], slopes[end, end + sign] = 1.0, 2.0
        sides[end] = 2.5 * change[end] + 0.5 * change[end + sign]
    slopes = np.asarray(np.linalg.solve(slopes, sides), dtype=np.float64)
    at = np.linspace(0.0, count - 1.0, finer)
    begin = np.minimum(at.astype(int), count - 2)
    share = (at - begin)[:, None]
    values, first, last = unit[begin], slopes[begin], slopes[begin + 1]
    bend, turn = first + last - 2.0 * change[begin], 3.0 * change[begin] - 2.0 * first - last
    return np.asarray(values + share * (first + share * (turn + share * bend)))


def shares_of_levels(currents: Currents, depth: float, drift_share: float) -> Array:
    """Return the weights of levels, shape (Z,), in the mean over dives to a depth [m] and a fraction of drift time."""
    dive = currents.weights(np.linspace(0.0, depth, 101)).mean(axis=0)
    return np.asarray((1.0 - drift_share) * dive + drift_share * currents.weights(np.zeros(1))[0])


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Route from a start to a goal or its closest reachable point.

    Attributes:
        points: Points, shape (n, 2) [m], local east and north.
        times: Time at each point, shape (n,) [s since the beginning].
        arrives: Whether the route reaches its goal.
    """

    points: Array
    times: Array
    arrives: bool

    def at(self, times: Array) -> Array:
        """Return the positions at times [s], shape (m, 2) [m]."""
        return np.column_stack([np.interp(times, self.times, self.points[:, i]) for i in (0, 1)])


# Speed made good below which an edge is closed [m/s].
SLOWEST = 1e-3


def edge_durations(
    current: CurrentLattice,
    speed: float,
    begin: Complex,
    end: Complex,
    depart: Array,
    longest_piece: float,
) -> Array:
    """Return the durations of straight tracks over ground, shape (n,) [s]; infinite if the current prevents them.

    In each piece, with u at its middle, the heading cancels u_perp; the speed over ground is u_par + sqrt(V^2 - u_perp^2).

    Args:
        current: Current on a lattice.
        speed: Speed through water, V [m/s].
        begin: Begin of each track, shape (n,) [m], east + i north.
        end: End of each track, shape (n,) [m].
        depart: Departure times, shape (n,) [s].
        longest_piece: Largest length of a piece [m].
    """
    way = end - begin
    length = np.abs(way)
    direction = way / np.maximum(length, 1e-9)
    pieces = np.maximum(np.ceil(length / longest_piece - 1e-6), 1.0)
    piece = length / pieces
    seconds = np.zeros(length.size)
    for k in range(int(pieces.max(initial=0.0))):
        open_ = np.flatnonzero((pieces > k) & np.isfinite(seconds))
        along, lasts = direction[open_], piece[open_]
        middle = begin[open_] + (k + 0.5) * lasts * along
        turned = (
            current.at(middle, depart[open_] + seconds[open_] + 0.5 / speed * lasts) * along.conj()
        )
        room = speed**2 - turned.imag**2
        made_good = turned.real + np.sqrt(np.maximum(room, 0.0))
        closed = (room <= 0.0) | (made_good <= SLOWEST)
        seconds[open_] += np.where(closed, np.inf, lasts / np.where(closed, 1.0, made_good))
    return seconds
