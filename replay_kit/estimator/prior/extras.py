"""Unknowns beside those of the slow current, where they are asked for: oscillations over the region, errors of the instrument."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.biases import Biases
from replay_kit.estimator.prior.oscillations import Oscillations

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Extras:
    """The unknowns, those of oscillations first.

    Attributes:
        oscillations: Uniform over the region.
        biases: Of the instrument.
        reference_ns: For which the oscillations' unknowns are given [ns, UTC].
    """

    oscillations: Oscillations
    biases: Biases
    reference_ns: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.oscillations.size + self.biases.size

    @property
    def tau(self) -> Array:
        """Decorrelation time of each unknown, shape (size,) [s]; inf for constants."""
        return np.repeat(
            [self.oscillations.scale, np.inf], [self.oscillations.size, self.biases.size]
        )

    def functions(self, depth: Array) -> Array:
        """Return the functions of depth that both components share, shape (n, K)."""
        return np.hstack([self.oscillations.weights(depth), self.biases.functions(depth)])

    def column(self, time_ns: int, relative: Array | None) -> Array:
        """Return the effect of one unit of each unknown on the functions' amplitudes, shape (2, K, size).

        Args:
            time_ns: [ns, UTC].
            relative: shape (2,) [m/s], mean velocity relative to the platform, local axes; None where the log does not state it.
        """
        seconds = np.array([(time_ns - self.reference_ns) / _NS])
        turning = np.stack(
            [self.oscillations.at(self.oscillations.factor(c), seconds) for c in range(2)]
        )
        errors = self.biases.factor(relative)
        n, m = turning.shape[1], errors.shape[1]
        out = np.zeros((2, n + m, self.size))
        out[:, :n, : turning.shape[2]], out[:, n:, turning.shape[2] :] = turning, errors
        return out

    def sums(self, weights: Array, depth: Array, times_ns: NDArray[np.int64]) -> Array:
        """Return the effect of one unit of each unknown on sums over points, shape (2, n, size); errors of an instrument have none.

        Args:
            weights: shape (n, P).
            depth: shape (P,) [m].
            times_ns: shape (P,) [ns, UTC].
        """
        seconds, knots = (times_ns - self.reference_ns) / _NS, self.oscillations.weights(depth)
        rows = [
            weights @ self.oscillations.at(knots @ self.oscillations.factor(c), seconds)
            for c in range(2)
        ]
        return np.pad(np.stack(rows), ((0, 0), (0, 0), (0, self.biases.size)))
