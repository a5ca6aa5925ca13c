"""Which survey leaves the least error at the end of a stretch without fixes: many judged at once, the best of each kind refined."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.front.current import Complex
from planners.learning.loops import DIRECTIONS, WAITING, Survey
from planners.learning.rows import Combined, Rows, lower_root, posterior, rows_at, stacked
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import DepthMeans

#: Returns surveys of corners of shape (C, W), and which of them may be flown.
Make = Callable[[Complex], tuple[Survey, NDArray[np.bool_]]]

# Rounds of the local search, its first step as a share of the loop's extent, and by what it shrinks where nothing is better.
_ROUNDS, _FIRST, _SHRINKS = 10, 0.3, 0.5


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
    for _ in range(_ROUNDS):
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
