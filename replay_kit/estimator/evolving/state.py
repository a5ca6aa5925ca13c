"""The state: independent unknowns, each forgotten at its own rate, some turning in pairs.

Without observations every unknown has mean 0 and variance 1, always. Over a time dt it keeps phi = exp(-dt / tau) of itself, and pairs turn
by omega dt; what is forgotten comes back as noise, so the variance stays:

    x <- phi R x,    P <- phi R P R' phi + diag(1 - phi^2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.types import Array


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
            mean: shape (n,).
            cov: shape (n, n).
            seconds: At least 0.
        """
        if seconds == 0.0:
            return mean, cov
        kept = np.exp(-seconds / self.scales)
        mean, cov = kept * self.turned(mean, seconds), self.turned(self.turned(cov, seconds).T, seconds)
        if self.first.size:
            # a turn of rows and columns in turn rounds differently on the two sides of the diagonal
            cov = 0.5 * (cov + cov.T)
        cov = cov * np.outer(kept, kept)
        cov[np.diag_indices_from(cov)] += -np.expm1(-2.0 * seconds / self.scales)
        return mean, cov

    def forecast_mean(self, mean: Array, seconds: float) -> Array:
        """Return the mean of ``predict`` alone."""
        return np.asarray(np.exp(-seconds / self.scales) * self.turned(mean, seconds))

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


def update(mean: Array, cov: Array, design: Array, innovation: Array, error_scale: float) -> tuple[Array, Array]:
    """Return mean and covariance after rows with independent noise.

    Args:
        mean: shape (n,).
        cov: shape (n, n).
        design: shape (m, n).
        innovation: shape (m,), rows minus their mean.
        error_scale: Standard deviation of the noise.
    """
    cross = design @ cov
    lower = np.linalg.cholesky(cross @ design.T + error_scale**2 * np.eye(innovation.size))
    both = np.linalg.solve(lower, np.column_stack([cross, innovation]))
    gain, whitened = both[:, :-1], both[:, -1]
    return mean + gain.T @ whitened, cov - gain.T @ gain
