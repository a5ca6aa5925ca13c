"""Earliest arrival at all points of a lattice, and some points off it, by a front from a start.

Label setting (Dijkstra 1959) in buckets no wider than the least edge, as in Delta-stepping (Meyer and Sanders 2003): all points of a
bucket propagate at once. Edges lead to lattice points within five lines in 80 directions (steps in lowest terms), and between points off
the lattice and all points within five lines. Their travel times follow ``edge_durations`` at departure. If the vehicle is faster than the
current, a later departure never arrives earlier, and the result is exact on the lattice. Elsewhere an edge may open later: with ``waits``
reached points propagate again at each time of the current.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.hazards.domain import widened_mask
from planners.route.current import Complex, CurrentLattice, Route, edge_durations
from planners.route.obstacles import Obstacles
from replay_kit.core.arrays import Array

Numbers = NDArray[np.intp]

# Parts of the longest edge that a vehicle may go on from a point of the front.
_FURTHER = 20
# Lattice lines that an edge may reach over, and those of a piece of one.
_REACH, _PIECE = 5, 2.25
_STEPS = np.array(
    [
        (j, i)
        for j in range(-_REACH, _REACH + 1)
        for i in range(-_REACH, _REACH + 1)
        if np.gcd(i, j) == 1
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class Sea:
    """Graph on which a front propagates.

    Attributes:
        current: Current on the lattice.
        speed: Speed through water [m/s].
        obstacles: Obstacles.
        places: Points, those of the lattice first, shape (n,) [m], east + i north.
        free: Mask of points that a route may pass, shape (n,).
        near: Mask of points with edges that may touch an obstacle, shape (n,).
        first: Index of the first neighbour of each point, shape (n + 1,).
        neighbours: Numbers of the neighbouring points.
        waits: Whether points propagate again at each time of the current.
        fastest: Upper bound of the speed over ground [m/s].
    """

    current: CurrentLattice
    speed: float
    obstacles: Obstacles | None
    places: Complex
    free: NDArray[np.bool_]
    near: NDArray[np.bool_]
    first: Numbers
    neighbours: Numbers
    waits: bool
    fastest: float

    def durations(self, begin: Complex, end: Complex, depart: Array) -> Array:
        """Return the durations of edges, shape (n,) [s], see ``edge_durations``."""
        piece = _PIECE * self.current.spacing
        return edge_durations(self.current, self.speed, begin, end, depart, piece)


@dataclass(frozen=True, slots=True, eq=False)
class Front:
    """Earliest arrival at each point.

    Attributes:
        sea: Graph on which the front propagates.
        times: Earliest arrival, shape (n,) [s]; infinite for points not reached.
        before: Predecessor of each point, shape (n,); its own number at the start.
    """

    sea: Sea
    times: Array
    before: Numbers

    def route_to(self, number: int, begins: float, arrives: bool) -> Route:
        """Return the route to a point, with times since the beginning [s]."""
        chain = [number]
        while self.before[chain[-1]] != chain[-1]:
            chain.append(int(self.before[chain[-1]]))
        places, times = self.sea.places[chain[::-1]], self.times[chain[::-1]] - begins
        if len(chain) == 1:
            places, times = places.repeat(2), np.array([0.0, 1.0])
        return Route(np.column_stack([places.real, places.imag]), times, arrives)

    def nearest_to(self, place: complex) -> int:
        """Return the number of the reached point nearest to a position."""
        return int(
            np.argmin(np.where(np.isfinite(self.times), np.abs(self.sea.places - place), np.inf))
        )

    def fastest_met(
        self, begins: float, until: float, goal: tuple[complex, float] | None = None
    ) -> float:
        """Return the greatest current speed that a vehicle may meet [m/s].

        Args:
            begins: Begin of the front [s].
            until: Latest end of the route [s].
            goal: Position [m], east + i north, and radius [m] of the goal; None for any.
        """
        current, divisions = self.sea.current, self.sea.current.divisions
        count = current.places.size
        onward = (
            np.zeros(count)
            if goal is None
            else np.maximum(np.abs(current.places - goal[0]) - goal[1], 0.0) / self.sea.fastest
        )
        useful = self.times[:count] + onward <= until
        met = np.zeros(current.values.shape[1:], dtype=bool)
        met[::divisions, ::divisions] = useful.reshape(current.shape)
        # beside points that are reached, too: what stops the front
        met = widened_mask(met, divisions)
        times = np.flatnonzero(
            (np.append(current.times[1:], np.inf) > begins)
            & (np.append(-np.inf, current.times[:-1]) < until)
        )
        return float(np.max(np.abs(current.values[times][:, met]), initial=0.0))

    def approach(self, place: complex, until: float) -> tuple[float, float]:
        """Return the closest approach to a position [m] and its time [s], from points of the front as far as time and water allow.

        Args:
            place: Position out of reach [m], east + i north.
            until: End of the search [s].
        """
        sea, number = self.sea, self.nearest_to(place)
        away = np.abs(sea.places - place)
        longest = _REACH * sea.current.spacing
        near = np.flatnonzero(np.isfinite(self.times) & (away < away[number] + longest))
        begin = np.tile(near, _FURTHER)
        lengths = np.repeat(longest * np.arange(1, _FURTHER + 1) / _FURTHER, near.size)
        lengths = np.minimum(lengths, away[begin])
        end = sea.places[begin] + lengths * (place - sea.places[begin]) / np.maximum(
            away[begin], 1e-9
        )
        depart = self.times[begin]
        arrive = depart + sea.durations(sea.places[begin], end, depart)
        open_ = np.flatnonzero(arrive <= until)
        if sea.obstacles is not None:
            open_ = open_[~sea.obstacles.crossed(sea.places[begin[open_]], end[open_])]
        left = np.abs(end[open_] - place)
        if not left.size or np.min(left) >= away[number]:
            return float(away[number]), float(self.times[number])
        best = int(np.argmin(left))
        return float(left[best]), float(arrive[open_][best])


def sea_of(
    current: CurrentLattice,
    speed: float,
    extra: Complex,
    obstacles: Obstacles | None = None,
    *,
    waits: bool = False,
) -> Sea:
    """Return the graph of a front.

    Args:
        current: Current on a lattice.
        speed: Speed through water [m/s].
        extra: Points off the lattice such as start and goals, shape (k,) [m]; numbered between lattice and corners.
        obstacles: Obstacles, or None.
        waits: Whether points propagate again at each time of the current.
    """
    off = extra if obstacles is None else np.concatenate([extra, obstacles.corners])
    lattice = current.places
    places = np.concatenate([lattice, off])
    free = np.full(places.size, True) if obstacles is None else obstacles.free(places)
    reach = _REACH * current.spacing * 1.0001
    near = np.full(places.size, obstacles is not None)
    if obstacles is not None:
        near[: lattice.size] = _near(current, obstacles)
    begin, end = _neighbours(current, off, reach)
    back = end < lattice.size
    begin, end = np.concatenate([begin, end[back]]), np.concatenate([end, begin[back]])
    order = np.argsort(begin, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(begin, minlength=places.size))])
    return Sea(
        current,
        speed,
        obstacles,
        places,
        free,
        near,
        first,
        end[order],
        waits,
        speed + current.fastest,
    )


def _neighbours(current: CurrentLattice, off: Complex, reach: float) -> tuple[Numbers, Numbers]:
    """Return pairs of numbers: points off a lattice, and points within a reach [m] of them."""
    rows, columns = current.shape
    at = (off - complex(*current.origin)) / current.spacing
    around = np.arange(-_REACH - 1, _REACH + 2)
    row = np.round(at.imag).astype(int)[:, None, None] + around[:, None]
    column = np.round(at.real).astype(int)[:, None, None] + around
    row, column = np.broadcast_arrays(row, column)
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    inside &= np.abs(column + 1j * row - at[:, None, None]) * current.spacing <= reach
    begin = np.nonzero(inside)[0] + rows * columns
    end = (row * columns + column)[inside]
    one, other = np.nonzero(np.abs(off[:, None] - off) <= reach)
    both = np.concatenate([begin, one + rows * columns])
    return both, np.concatenate([end, other + rows * columns])


def _near(current: CurrentLattice, obstacles: Obstacles) -> NDArray[np.bool_]:
    """Return a mask of lattice points with edges that may touch the outline of the water."""
    outline = np.zeros(current.shape, dtype=bool)
    at = (obstacles.outline(current.spacing) - complex(*current.origin)) / current.spacing
    rows, columns = (
        np.clip(np.round(part), 0, count - 1).astype(int)
        for part, count in zip((at.imag, at.real), outline.shape, strict=True)
    )
    outline[rows, columns] = True
    # a point of the outline is no farther from its lattice point than one line, nor from the next point of the outline
    return widened_mask(outline, _REACH + 2).ravel()


def spread_front(sea: Sea, seeds: Numbers, begins: Array, until: float, goals: Numbers) -> Front:
    """Return the front from seed points.

    Args:
        sea: Graph on which the front propagates.
        seeds: Numbers of the seed points, shape (k,).
        begins: Begin at each seed, shape (k,) [s].
        until: End of the search [s].
        goals: Points that end the search when first reached; empty to reach all.
    """
    times, before = np.full(sea.places.size, np.inf), np.arange(sea.places.size)
    np.minimum.at(times, seeds, begins)
    pending, width = np.isfinite(times), sea.current.spacing / sea.fastest
    held = _strong(sea)
    later = sea.current.times[sea.current.times > np.min(begins)] if sea.waits else np.zeros(0)
    while pending.any() or later.size:
        # a front that stands still may go on at the current's next time
        now = float(
            np.min(times[pending], initial=later[0] if later.size and not pending.any() else np.inf)
        )
        if now > until or (goals.size and np.min(times[goals]) <= now):
            break
        if later.size and later[0] <= now:
            waiting = np.flatnonzero(held & (times < later[0]))
            _spread_from(sea, waiting, np.full(waiting.size, later[0]), times, before, pending)
            later = later[1:]
            continue
        bucket = min(now + width, later[0]) if later.size else now + width
        while (numbers := np.flatnonzero(pending & (times < bucket))).size:
            pending[numbers] = False
            _spread_from(sea, numbers, times[numbers], times, before, pending)
    times[times > until] = np.inf
    return Front(sea, times, before)


def _strong(sea: Sea) -> NDArray[np.bool_]:
    """Return a mask of points with edges that may open later: a current nearby exceeds the vehicle's speed at some time."""
    found = np.ones(sea.places.size, dtype=bool)
    divisions = sea.current.divisions
    strong = widened_mask(
        np.max(np.abs(sea.current.values), axis=0) > 0.98 * sea.speed, _REACH * divisions
    )
    strong = strong[::divisions, ::divisions]
    found[: strong.size] = strong.ravel()
    return found


def _spread_from(
    sea: Sea,
    numbers: Numbers,
    depart: Array,
    times: Array,
    before: Numbers,
    pending: NDArray[np.bool_],
) -> None:
    """Reduce the times of neighbours of points that depart at given times, and mark reduced ones as pending."""
    begin, end = _edges_from(sea, numbers)
    depart = depart[begin]
    begin = numbers[begin]
    way = np.abs(sea.places[end] - sea.places[begin])
    # no edge is quicker than along the fastest current
    useful = sea.free[end] & (depart + way / sea.fastest < times[end])
    begin, end, depart = begin[useful], end[useful], depart[useful]
    arrive = depart + sea.durations(sea.places[begin], sea.places[end], depart)
    useful = arrive < times[end]
    begin, end, arrive = begin[useful], end[useful], arrive[useful]
    if sea.obstacles is not None:
        touching = np.flatnonzero(sea.near[begin])
        clear = np.full(begin.size, True)
        clear[touching] = ~sea.obstacles.crossed(
            sea.places[begin[touching]], sea.places[end[touching]]
        )
        begin, end, arrive = begin[clear], end[clear], arrive[clear]
    # of several values for one number the last is kept
    order = np.argsort(-arrive, kind="stable")
    begin, end = begin[order], end[order]
    times[end], before[end], pending[end] = arrive[order], begin, True


def _edges_from(sea: Sea, numbers: Numbers) -> tuple[Numbers, Numbers]:
    """Return the edges of points: index of the origin in ``numbers`` and number of the end."""
    rows, columns = sea.current.shape
    on = np.flatnonzero(numbers < rows * columns)
    row, column = np.divmod(numbers[on], columns)
    to_row, to_column = row[:, None] + _STEPS[:, 0], column[:, None] + _STEPS[:, 1]
    inside = (to_row >= 0) & (to_row < rows) & (to_column >= 0) & (to_column < columns)
    begin, end = np.repeat(on, len(_STEPS))[inside.ravel()], (to_row * columns + to_column)[inside]
    counts = sea.first[numbers + 1] - sea.first[numbers]
    if not counts.any():
        return begin, end
    owners = np.repeat(np.arange(numbers.size), counts)
    positions = (
        np.arange(owners.size)
        - np.repeat(np.cumsum(counts) - counts, counts)
        + np.repeat(sea.first[numbers], counts)
    )
    return np.concatenate([begin, owners]), np.concatenate([end, sea.neighbours[positions]])
