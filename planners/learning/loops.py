"""Surveys from a place and back to it in a given time: shapes, times, where they may not go; and which leaves the least error.

Many are judged by the error at the end of a stretch without fixes, and the best of each kind is refined.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.front.current import Complex
from planners.learning.current import Currents
from planners.learning.rows import Combined, Rows, lower_root, posterior, rows_at, stacked
from planners.route.hazards import Ring
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import DepthMeans

#: Position of waiting and of scouting straight ahead and back among the loops of ``shapes``.
WAITING, SCOUTING = 0, 1
#: Directions of the loops, of which each kind comes in turn.
DIRECTIONS = 16
# Corners of each kind, relative to a direction and of any size.
_SHAPES = (
    (1.0 + 0j, 0.5 + 0j, 0j),
    (1.0 + 0j, 0.7 + 0.7j, 0j),
    (1.0 + 0j, 0.7 - 0.7j, 0j),
    (1.0 + 0.25j, 1.0 - 0.25j, 0j),
)
# Points along a loop at which its current counts, and rounds in which its size is fitted to its time.
_POINTS, _ROUNDS = 48, 6
# Share of a vehicle's speed that a survey counts on: the rest makes up for a current that is not as known.
_COUNTED = 0.9
# Least speed over ground [m/s]; where a current leaves less a loop cannot be flown.
_LEAST = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Surveys of one duration, C of them.

    Attributes:
        corners: shape (C, W) [m], after the start, to which the last returns.
        ends: shape (C, n) [m], where each dive ends.
        profiles: shape (C, n) [m], its middle: where its mean current counts.
        times: shape (n,) [s], of the profiles.
        flown: shape (C,), whether it can be flown in the current that is known.
    """

    corners: Complex
    ends: Complex
    profiles: Complex
    times: Array
    flown: NDArray[np.bool_]

    def picked(self, which: Sequence[int] | NDArray[np.intp]) -> "Survey":
        """Return some of the surveys."""
        index = np.asarray(which)
        return Survey(
            self.corners[index],
            self.ends[index],
            self.profiles[index],
            self.times,
            self.flown[index],
        )

    @property
    def points(self) -> Array:
        """Places of the profiles, shape (C, n, 2) [m]."""
        return np.stack([self.profiles.real, self.profiles.imag], axis=-1)


def shapes(ahead: complex) -> Complex:
    """Return the corners of loops in all directions, shape (65, 3), of any size, relative to the start: first waiting, then scouting ahead.

    Args:
        ahead: The direction in which the stretch without fixes leads, of any length above 0.
    """
    turns = ahead / abs(ahead) * np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    loops = (np.array(_SHAPES)[:, None, :] * turns[:, None]).reshape(-1, 3)
    return np.concatenate([np.zeros((1, 3)), loops])


def timed(
    known: Currents, start: complex, shape: Complex, span: tuple[float, float, int], speed: float
) -> Survey:
    """Return surveys of such shapes that take a given time in the current that is known.

    Args:
        known: One current.
        start: [m].
        shape: shape (C, W), corners of any size relative to the start, the last 0; all 0 to wait.
        span: When they begin [s], for how long [s], and their number of dives.
        speed: Greatest through water [m/s].
    """
    begin, duration, n_dives = span
    lengths = np.abs(np.diff(shape, axis=1, prepend=0.0)).sum(axis=1)
    moves = lengths > 0.0
    unit = shape / np.where(moves, lengths, 1.0)[:, None]
    size = np.where(moves, speed * _COUNTED * duration, 0.0)
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    track, tangent = _along(unit, share)
    times = np.broadcast_to(begin + duration * share, track.shape)
    for _ in range(_ROUNDS):
        spent = _time_along(known, (start + size[:, None] * track, tangent), times, size, speed)
        size *= np.clip(duration / np.maximum(spent.sum(axis=1), 1e-9), 0.2, 1.6)
    spent = _time_along(known, (start + size[:, None] * track, tangent), times, size, speed)
    held_back = np.any(spent >= (1.0 - 1e-9) * size[:, None] / _POINTS / _LEAST, axis=1)
    flown = ~moves | (~held_back & (np.abs(spent.sum(axis=1) / duration - 1.0) < 0.05))
    done = np.concatenate([np.zeros((len(size), 1)), np.cumsum(spent, axis=1)], axis=1)
    at = np.arange(1, 2 * n_dives + 1) / (2 * n_dives)
    shares = np.array(
        [
            np.interp(at, one / max(one[-1], 1e-9), np.linspace(0.0, 1.0, _POINTS + 1))
            for one in done
        ]
    )
    places = start + size[:, None] * _along_each(unit, shares)
    return Survey(
        start + size[:, None] * unit,
        places[:, 1::2],
        places[:, ::2],
        begin + duration * at[::2],
        flown,
    )


def _along(corners: Complex, share: Array) -> tuple[Complex, Complex]:
    """Return places at shares of the way from 0 past corners, shape (C, p), and unit vectors along it; 0 for a loop that stays."""
    shares = np.broadcast_to(share, (len(corners), share.size))
    before, after = _along_each(corners, shares - 1e-6), _along_each(corners, shares + 1e-6)
    way = after - before
    return _along_each(corners, shares), way / np.maximum(np.abs(way), 1e-30)


def _along_each(corners: Complex, shares: Array) -> Complex:
    legs = np.abs(np.diff(corners, axis=1, prepend=0.0))
    ends = np.concatenate([np.zeros((len(corners), 1)), np.cumsum(legs, axis=1)], axis=1)
    nodes = np.concatenate([np.zeros((len(corners), 1)), corners], axis=1)
    return np.asarray(
        [
            np.interp(share * end[-1], end, node)
            for share, end, node in zip(shares, ends, nodes, strict=True)
        ]
    )


def _time_along(
    known: Currents, way: tuple[Complex, Complex], times: Array, size: Array, speed: float
) -> Array:
    """Return the time of each piece of loops [s], shape (C, p), along which a vehicle keeps."""
    track, tangent = way
    u = known.at(track[None], times[None])[0] * np.conj(tangent)
    ahead = np.sqrt(np.maximum((_COUNTED * speed) ** 2 - u.imag**2, 0.0))
    over_ground = np.where(ahead > 0.0, ahead + u.real, 0.0)
    return np.asarray(size[:, None] / track.shape[1] / np.maximum(over_ground, _LEAST))


def clear(
    survey: Survey, start: complex, rings: Sequence[Ring], margin: float
) -> NDArray[np.bool_]:
    """Return which surveys keep clear of what is forbidden, shape (C,).

    Args:
        survey: C of them.
        start: [m].
        rings: What is forbidden, for surfacing too.
        margin: Distance kept [m].
    """
    corners = np.concatenate([np.full((len(survey.corners), 1), start), survey.corners], axis=1)
    return clear_lines(
        shapely.linestrings(np.stack([corners.real, corners.imag], axis=-1)), rings, margin
    )


def clear_lines(lines: NDArray[Any], rings: Sequence[Ring], margin: float) -> NDArray[np.bool_]:
    """Return which lines keep a margin [m] from rings."""
    found = np.ones(len(lines), dtype=bool)
    for ring in rings:
        if ring.outside:
            found &= shapely.covers(ring.area, lines) & ~shapely.dwithin(ring.line, lines, margin)
        else:
            found &= ~shapely.dwithin(ring.area, lines, margin)
    return found


#: Returns surveys of corners of shape (C, W), and which of them may be flown.
Make = Callable[[Complex], tuple[Survey, NDArray[np.bool_]]]

# Rounds of the local search, its first step as a share of the loop's extent, and by what it shrinks where nothing is better.
_REFINEMENTS, _FIRST, _SHRINKS = 10, 0.3, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """What a survey is to make certain.

    Attributes:
        known: Errors of the estimate.
        sought: The two numbers whose variance counts: east and north of where the stretch ends.
        variance: Of a profile's mean current [m^2/s^2].
        given: Rows of profiles that others bring anyway; None for none.
    """

    known: DepthMeans
    sought: Combined
    variance: float
    given: Rows | None = None

    def before(self) -> float:
        """Return the root mean square error of the end without a survey [m]."""
        cov = (
            self.sought.variance()
            if self.given is None
            else posterior(self.sought, self.given, self.variance)
        )
        return float(np.sqrt(np.trace(cov)))

    def judge(self, survey: Survey) -> Array:
        """Return the root mean square error of the end after each survey [m], shape (C,)."""
        rows = rows_at(self.known, survey.points, survey.times)
        rows = rows if self.given is None else stacked(rows, self.given)
        lower = lower_root(rows, self.variance)
        inside = np.linalg.solve(lower, self.sought.cross(rows).swapaxes(-1, -2))
        left = np.trace(self.sought.variance()) - np.sum(inside**2, axis=(-2, -1))
        return np.asarray(np.sqrt(np.maximum(left, 0.0)))


def allowed_errors(aim: Aim, survey: Survey, allowed: NDArray[np.bool_]) -> Array:
    """Return the errors after surveys [m], shape (C,); infinite for those that may or can not be flown."""
    found = np.full(len(allowed), np.inf)
    if allowed.any():
        found[allowed] = aim.judge(survey.picked(np.flatnonzero(allowed)))
    return found


def search(aim: Aim, make: Make, loops: Complex, errors: Array) -> tuple[Complex, float]:
    """Return the corners of the survey that leaves the least error, shape (W,), all 0 to wait, and that error [m].

    The best loop of each kind is refined, as those in other directions may end better where a part of the sea is closed; then the best
    of them with one corner more.

    Args:
        aim: What counts.
        make: Returns surveys of corners of shape (C, W), and which of them may be flown.
        loops: Corners in the order of ``shapes``.
        errors: That each loop leaves [m]; infinite for those that may not be flown.
    """
    best, error = loops[WAITING], float(errors[WAITING])
    for kind in np.arange(WAITING + 1, len(loops)).reshape(-1, DIRECTIONS):
        first = kind[np.argmin(errors[kind])]
        if np.isfinite(errors[first]):
            shape, left = refine(aim, make, loops[first], float(errors[first]))
            if left < error:
                best, error = shape, left
    if not best.any():
        return best, error
    nodes = np.concatenate([[0.0], best])
    longest = int(np.argmax(np.abs(np.diff(nodes))))
    # a corner in the middle of a leg changes nothing until it is moved
    shape, left = refine(
        aim, make, np.insert(best, longest, 0.5 * (nodes[longest] + nodes[longest + 1])), error
    )
    return (shape, left) if left < error else (best, error)


def refine(aim: Aim, make: Make, shape: Complex, error: float) -> tuple[Complex, float]:
    """Return the corners of a better loop nearby, shape (W,), and its error [m]: its corners are moved one by one while that helps.

    Args:
        aim: What counts.
        make: Returns surveys of shapes (C, W) and which of them may be flown.
        shape: shape (W,), of a survey; its last corner stays.
        error: Of it [m].
    """
    step = _FIRST * max(float(np.max(np.abs(shape))), 1e-9)
    directions = np.exp(2j * np.pi * np.arange(8) / 8)
    for _ in range(_REFINEMENTS):
        moved = np.repeat(shape[None], directions.size * (len(shape) - 1), axis=0)
        for corner in range(len(shape) - 1):
            moved[corner * directions.size : (corner + 1) * directions.size, corner] += (
                step * directions
            )
        survey, allowed = make(moved)
        errors = allowed_errors(aim, survey, allowed)
        best = int(np.argmin(errors))
        if errors[best] < error * (1.0 - 1e-4):
            shape, error = moved[best], float(errors[best])
        else:
            step *= _SHRINKS
    return shape, error
