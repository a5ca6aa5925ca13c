"""The state: independent unknowns, each forgotten at its own rate, some turning in pairs.

Without observations every unknown has mean 0 and variance 1, always. Over a time dt it keeps phi = exp(-dt / tau) of itself, and pairs turn
by omega dt; what is forgotten comes back as noise, so the variance stays:

    x <- phi R x,    P <- phi R P R' phi + diag(1 - phi^2).
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.estimator.update.posterior import Look


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The unknowns.

    Attributes:
        scales: shape (n,), how long each is remembered [s]; inf for ever.
        first: shape (p,), positions of the first of each pair that turns.
        second: shape (p,), of the second.
        omega: shape (p,), angular velocity of each pair [rad/s]; a positive one turns the first towards the second's negative.
        parts: Name of each part to its positions.
    """

    scales: Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    omega: Array
    parts: dict[str, slice]

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        return self.scales.size

    def predict(self, mean: Array, cov: Array, seconds: float) -> tuple[Array, Array]:
        """Return mean and covariance after a time without observations.

        Args:
            mean: shape (n,) or (n, c).
            cov: shape (n, n).
            seconds: At least 0.
        """
        if seconds == 0.0:
            return mean, cov
        mean = self.forecast_mean(mean, seconds)
        if self.first.size:
            cov = self.turned(self.turned(cov, seconds).T, seconds)
            # a turn of rows, then of columns, rounds differently on the two sides of the diagonal
            cov = 0.5 * (cov + cov.T)
        else:
            cov = cov.copy()
        # unknowns of one scale follow one another: one number scales their block
        ends = np.append(np.flatnonzero(self.scales[1:] != self.scales[:-1]) + 1, self.size)
        starts = np.append(0, ends[:-1])
        for first, last in zip(starts, ends, strict=True):
            for other, end in zip(starts, ends, strict=True):
                kept = np.exp(-seconds / self.scales[first]) * np.exp(-seconds / self.scales[other])
                if kept != 1.0:
                    cov[first:last, other:end] *= kept
        cov[np.diag_indices_from(cov)] += -np.expm1(-2.0 * seconds / self.scales)
        return mean, cov

    def forecast_mean(self, mean: Array, seconds: float) -> Array:
        """Return the mean of ``predict`` alone; ``mean`` of shape (n,) or (n, c)."""
        kept = np.exp(-seconds / self.scales)
        return np.asarray((kept if mean.ndim == 1 else kept[:, None]) * self.turned(mean, seconds))

    def turned(self, rows: Array, seconds: float) -> Array:
        """Return the unknowns, shape (n, ...), with pairs turned by a time; a negative one turns back."""
        if self.first.size == 0:
            return rows
        out = rows.copy()
        shape = (-1, *[1] * (rows.ndim - 1))
        cosine, sine = (function(self.omega * seconds).reshape(shape) for function in (np.cos, np.sin))
        out[self.first] = cosine * rows[self.first] + sine * rows[self.second]
        out[self.second] = cosine * rows[self.second] - sine * rows[self.first]
        return out


@dataclass(frozen=True, eq=False)
class Along(Look[tuple[Array, Array]]):
    """What a state expects of rows.

    Attributes:
        cross: shape (m, n), the rows times the state's covariance.
    """

    cross: Array


def look_along(means: Array, cov: Array, design: Array) -> Along:
    """Return what is expected of rows, and how they change means and covariance.

    Args:
        means: shape (n, 1 + b), of which the first column is the state's mean, the others its answers to errors of one unit.
        cov: shape (n, n).
        design: shape (m, n).
    """
    cross = design @ cov

    def absorb(lower: Array, whitened: Array, error_scale: float) -> tuple[Array, Array]:
        gain = np.asarray(scipy.linalg.solve_triangular(lower, cross / error_scale, lower=True))
        return means + gain.T @ whitened, cov - gain.T @ gain

    spread = cross @ design.T
    return Along(design @ means[:, 0], design @ means[:, 1:], 0.5 * (spread + spread.T), absorb, cross)
