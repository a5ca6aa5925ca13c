"""The state of the estimate through time, and its evolution: independent unknowns, each with its own decorrelation time.

Some of them are rotating pairs. Without observations every unknown has mean 0 and variance 1, always. Over a time dt it decays by phi =
exp(-dt / tau), and pairs rotate by omega dt; process noise keeps the variance constant:

    x <- phi R x,    P <- phi R P R' phi + diag(1 - phi^2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.estimator.update.rows import Assimilation


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingState(Assimilation):
    """The estimate at one time: that of the last observation used, or the mean of a group of profiles.

    Attributes:
        means: shape (n, 4): mean of the unknowns, and its sensitivity to heading, scale and shear errors of one unit outside the state.
        cov: shape (n, n), covariance of the unknowns.
    """

    means: Array
    cov: Array

    @property
    def mean(self) -> Array:
        """Mean of the unknowns, shape (n,)."""
        return self.means[:, 0]


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """The unknowns and their evolution.

    Attributes:
        scales: shape (n,), decorrelation time of each [s]; inf for a constant.
        first: shape (p,), positions of the first of each rotating pair.
        second: shape (p,), of the second.
        omega: shape (p,), angular velocity of each pair [rad/s]; positive from the first towards the negative second.
        parts: Positions of each part, by name.
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
        mean = self.predict_mean(mean, seconds)
        if self.first.size:
            cov = self.rotated(self.rotated(cov, seconds).T, seconds)
            # rotating rows, then columns, rounds differently on the two sides of the diagonal
            cov = 0.5 * (cov + cov.T)
        else:
            cov = cov.copy()
        # unknowns of one scale are adjacent: one number scales their block
        ends = np.append(np.flatnonzero(self.scales[1:] != self.scales[:-1]) + 1, self.size)
        starts = np.append(0, ends[:-1])
        for first, last in zip(starts, ends, strict=True):
            for other, end in zip(starts, ends, strict=True):
                kept = np.exp(-seconds / self.scales[first]) * np.exp(-seconds / self.scales[other])
                if kept != 1.0:
                    cov[first:last, other:end] *= kept
        cov[np.diag_indices_from(cov)] += -np.expm1(-2.0 * seconds / self.scales)
        return mean, cov

    def predict_mean(self, mean: Array, seconds: float) -> Array:
        """Return the mean of ``predict`` alone; ``mean`` of shape (n,) or (n, c)."""
        kept = np.exp(-seconds / self.scales)
        return np.asarray((kept if mean.ndim == 1 else kept[:, None]) * self.rotated(mean, seconds))

    def rotated(self, rows: Array, seconds: float) -> Array:
        """Return the unknowns, shape (n, ...), with pairs rotated over a time; a negative one rotates them back."""
        if self.first.size == 0:
            return rows
        out = rows.copy()
        shape = (-1, *[1] * (rows.ndim - 1))
        cosine, sine = (
            function(self.omega * seconds).reshape(shape) for function in (np.cos, np.sin)
        )
        out[self.first] = cosine * rows[self.first] + sine * rows[self.second]
        out[self.second] = cosine * rows[self.second] - sine * rows[self.first]
        return out
