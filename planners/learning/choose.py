"""Which survey leaves the least error at the end of a stretch without fixes: many judged at once, the best refined."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.learning.current import Complex
from planners.learning.loops import Survey
from planners.learning.rows import Combined, Rows, covariance, posterior, rows_at, stacked
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth_means import DepthMeans

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
        cov = self.sought.variance() if self.given is None else posterior(self.sought, self.given, self.variance)
        return float(np.sqrt(np.trace(cov)))

    def judge(self, survey: Survey) -> Array:
        """Return the root mean square error of the end after each survey [m], shape (C,)."""
        rows = rows_at(self.known, survey.points, survey.times)
        rows = rows if self.given is None else stacked(rows, self.given)
        lower = np.linalg.cholesky(covariance(rows, rows) + self.variance * np.eye(rows.now.shape[-2]))
        inside = np.linalg.solve(lower, self.sought.cross(rows).swapaxes(-1, -2))
        left = np.trace(self.sought.variance()) - np.sum(inside**2, axis=(-2, -1))
        return np.asarray(np.sqrt(np.maximum(left, 0.0)))


def allowed_errors(aim: Aim, survey: Survey, allowed: NDArray[np.bool_]) -> Array:
    """Return the errors after surveys [m], shape (C,); infinite for those that may or can not be flown."""
    found = np.full(len(allowed), np.inf)
    if allowed.any():
        found[allowed] = aim.judge(survey.picked(np.flatnonzero(allowed)))
    return found


def refine(aim: Aim, make: Callable[[Complex], tuple[Survey, NDArray[np.bool_]]], shape: Complex, error: float) -> tuple[Complex, float]:
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
            moved[corner * directions.size : (corner + 1) * directions.size, corner] += step * directions
        survey, allowed = make(moved)
        errors = allowed_errors(aim, survey, allowed)
        best = int(np.argmin(errors))
        if errors[best] < error * (1.0 - 1e-4):
            shape, error = moved[best], float(errors[best])
        else:
            step *= _SHRINKS
    return shape, error
