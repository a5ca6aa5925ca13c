"""Fastest route in a current faster than the vehicle, from Zermelo's rays.

A lattice has a limited set of directions, few of which are feasible in a current faster than the vehicle. A ray's heading t, from east,
turns by dt/dt = sin^2 t v_x + sin t cos t (u_x - v_y) - cos^2 t u_y, which is optimal (Zermelo 1931). Rays are inserted between diverging
neighbours as the mean of both. A ray ends where another was long before, or in a forbidden area.
"""

import numpy as np
from numpy.typing import NDArray

from planners.route.current import Complex, CurrentLattice, Route
from planners.route.obstacles import Obstacles
from replay_kit.core.arrays import Array

# Rays at the start and at most; steps for each line of the current's lattice.
_FIRST, _MOST, _A_LINE = 256, 20000, 1.5
# Distances in lattice lines: between neighbours, of the cells in which one is late, and to the goal; cells that a late one takes to cross.
_APART, _CELL, _NEAR, _LATE = 0.1, 0.1, 0.2, 2.0


def ray_to(
    current: CurrentLattice,
    speed: float,
    ends: tuple[complex, complex],
    times: tuple[float, float],
    obstacles: Obstacles,
) -> Route | None:
    """Return the route of the first ray that comes near a goal; None if none does in time.

    Args:
        current: Current on a lattice.
        speed: Speed through water [m/s].
        ends: Begin and goal [m], east + i north.
        times: Begin and latest end [s].
        obstacles: Obstacles.
    """
    (start, goal), (now, until), spacing = ends, times, current.spacing
    step = spacing / _A_LINE / (current.fastest + speed)
    at = np.full(_FIRST, start)
    headings = 2.0 * np.pi * np.arange(_FIRST) / _FIRST
    cell = _CELL * spacing
    late, corner = _LATE * cell / speed + 2.0 * step, complex(*current.origin)
    shape = [int(np.ceil(span / cell)) + 2 for span in _span(current)]
    first = np.full(shape, np.inf)
    history: list[tuple[Complex, NDArray[np.intp]]] = [(at, np.arange(_FIRST))]
    while now < until and at.size:
        before = at
        at, headings = _stepped(current, speed, at, headings, now, step)
        now += step
        # how near the way of this step comes
        way = at - before
        share = np.clip(((goal - before) * way.conj()).real / np.abs(way) ** 2, 0.0, 1.0)
        near = np.abs(before + share * way - goal)
        if np.min(near) < _NEAR * spacing:
            history.append((at, np.arange(at.size)))
            return _traced(history, int(np.argmin(near)), goal, (step, speed))
        rows, columns = (
            (part / cell).astype(int) for part in ((at - corner).real, (at - corner).imag)
        )
        inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
        rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
        np.minimum.at(first, (rows[inside], columns[inside]), now)
        kept = np.flatnonzero(inside & obstacles.free(at) & (now - first[rows, columns] <= late))
        at, headings, parents = _filled(at, headings, kept, _APART * spacing)
        history.append((at, parents))
    return None


def _span(current: CurrentLattice) -> Array:
    rows, columns = current.shape
    return current.spacing * np.array([columns - 1, rows - 1])


def _stepped(
    current: CurrentLattice, speed: float, at: Complex, headings: Array, now: float, step: float
) -> tuple[Complex, Array]:
    """Return positions and headings of rays after a step of the midpoint method."""

    def rate(at: Complex, headings: Array, now: float) -> tuple[Complex, Array]:
        h = 0.25 * current.spacing
        points = np.concatenate([at, at + h, at - h, at + 1j * h, at - 1j * h])
        here, east, west, north, south = np.split(current.at(points, np.full(points.size, now)), 5)
        by_x, by_y = (east - west) / (2.0 * h), (north - south) / (2.0 * h)
        sine, cosine = np.sin(headings), np.cos(headings)
        turn = sine**2 * by_x.imag + sine * cosine * (by_x.real - by_y.imag) - cosine**2 * by_y.real
        return here + speed * (cosine + 1j * sine), turn

    velocity, turn = rate(at, headings, now)
    half = 0.5 * step
    velocity, turn = rate(at + half * velocity, headings + half * turn, now + half)
    return at + step * velocity, headings + step * turn


def _filled(
    at: Complex, headings: Array, kept: NDArray[np.intp], apart: float
) -> tuple[Complex, Array, NDArray[np.intp]]:
    """Return the kept and inserted rays, and the previous number of each."""
    if not kept.size or kept.size >= _MOST:
        return at[kept], headings[kept], kept
    after = np.roll(kept, -1)
    gap = (np.abs(at[after] - at[kept]) > apart) & ((kept + 1) % at.size == after)
    turned = np.angle(np.exp(1j * (headings[after] - headings[kept])))
    order = np.argsort(
        np.concatenate([np.arange(kept.size), np.flatnonzero(gap) + 0.5]), kind="stable"
    )
    middle = 0.5 * (at[kept] + at[after])[gap]
    between = (headings[kept] + 0.5 * turned)[gap]
    return (
        np.concatenate([at[kept], middle])[order],
        np.concatenate([headings[kept], between])[order],
        np.concatenate([kept, kept[gap]])[order],
    )


def _traced(
    history: list[tuple[Complex, NDArray[np.intp]]],
    number: int,
    goal: complex,
    pace: tuple[float, float],
) -> Route:
    """Return the route along a ray and on to the goal."""
    (step, speed), chain = pace, list[complex]()
    for at, parents in reversed(history):
        chain.append(complex(at[number]))
        number = int(parents[number])
    places = np.array(chain[::-1])
    seconds = step * np.arange(places.size, dtype=np.float64)
    left = abs(goal - places[-1])
    places, seconds = (
        np.append(places, goal),
        np.append(seconds, seconds[-1] + max(left / speed * 0.3, 1.0)),
    )
    return Route(np.column_stack([places.real, places.imag]), seconds, True)
