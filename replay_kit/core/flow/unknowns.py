"""Unknowns of an estimate: mean and covariance at one time, and their change to a later one."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.local import Oscillation
from replay_kit.core.flow.process import Process

_NS = 1e9


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Estimate of the unknowns at one time.

    Attributes:
        process: Model of the modes' weights and their change in time.
        offset: shape (M, Z), latent values of the flow whose weights are zero.
        x: shape (k,), mean.
        p: shape (k, k), covariance.
        time_ns: Time of the last observation [ns, UTC]; None before any.
        error: shape (Z, N) [m/s], representation error at the nodes.
        scaled: Factor on all variances, or a function that returns it.
        oscillation: Known oscillations; None without any.
        measured: shape (Z,), whether a level lies among measured depths; None where that is ignored.
    """

    process: Process
    offset: Array
    x: Array
    p: Array
    time_ns: int | None
    error: Array
    scaled: float | Callable[[], float] = 1.0
    oscillation: Oscillation | None = None
    measured: Mask | None = None

    @cached_property
    def scale(self) -> float:
        """Factor on all variances s."""
        return self.scaled() if callable(self.scaled) else self.scaled

    @cached_property
    def root(self) -> Array:
        """Factor F of the covariance, F F' = s P, shape (k, k).

        Raises:
            EstimatorError: The covariance is not a number.
        """
        if not np.isfinite(self.p).all():
            raise EstimatorError(
                "the estimate's covariance is not a number everywhere, so that it has no standard error"
            )
        try:
            return np.asarray(np.sqrt(self.scale) * np.linalg.cholesky(self.p))
        except np.linalg.LinAlgError:
            # rounding left a variance of nearly zero below it
            values, vectors = np.linalg.eigh(self.p)
            return np.asarray(vectors * np.sqrt(self.scale * np.maximum(values, 0.0)))

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields for a pickle, with the factor instead of its function."""
        return vars(replace(self, scaled=self.scale))

    def latent(self, modes: Array, time_ns: int) -> Array:
        """Return the latent values of the flow at a time [ns, UTC] for the present unknowns, shape (M, Z)."""
        return np.asarray(self.offset + modes @ self.process.weights(self.x, time_ns).T)

    def at(self, time_ns: int) -> "Unknowns":
        """Return the unknowns at a later time [ns, UTC]: means decay, variances return to 1; an earlier time has no effect."""
        constant = not np.isfinite(self.process.tau).any()
        if self.time_ns is None or time_ns <= self.time_ns or constant:
            return self
        kept = self.process.kept((time_ns - self.time_ns) / _NS)
        # symmetric to the last bit, as files keep one half
        p = self.p * np.outer(kept, kept)
        p[np.diag_indices_from(p)] += 1.0 - kept**2
        return replace(self, x=kept * self.x, p=p, time_ns=time_ns)

    def draws(self, modes: Array, times_ns: Sequence[int], n: int, seed: int) -> Iterator[Array]:
        """Yield at each time the latent values of n random currents, shape (n, M, Z).

        Args:
            modes: shape (M, r), latent values of the modes.
            times_ns: Times in order [ns, UTC], from the last observation on.
            n: Number of currents.
            seed: Seed of the random numbers.
        """
        rng, first = np.random.default_rng(seed), self.at(times_ns[0])
        mean, about = first.x, rng.standard_normal((n, len(first.x))) @ first.root.T
        for before, time_ns in zip([times_ns[0], *times_ns[:-1]], times_ns, strict=True):
            if time_ns > before:
                kept = self.process.kept((time_ns - before) / _NS)
                noise = rng.standard_normal(about.shape) * np.sqrt(self.scale * (1.0 - kept**2))
                mean, about = kept * mean, kept * about + noise
            weights = self.process.weights(mean + about, time_ns)
            yield self.offset + modes @ weights.swapaxes(1, 2)
