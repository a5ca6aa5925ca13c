"""Unknowns of an estimate and the current as their function.

The weights of the modes at time t are

    w(t) = m(t) + sum_i x_i L_i(t),    x_i independent, of mean 0 and variance 1,

with m the ensemble mean. An L_i is the anomaly of a member or of one of its shifted copies, which moves and grows with the member's own
forecast; the ensemble mean, whose amplitude is uncertain; or a direction of the localised covariance, which grows as the ensemble's spread.
Each x_i is an Ornstein-Uhlenbeck process with a decorrelation time of its own,

    cov(x_i(t), x_i(t')) = exp(-|t - t'| / tau_i);

a constant estimate has tau = inf. Everything is linear between the forecast's times and constant outside them. In depth the L_i are sums of
K vertical functions, fewer than the levels.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Mask, Times
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import hat_weights
from replay_kit.core.flow.local import Oscillation


@dataclass(frozen=True, eq=False)
class Process:
    """Model of the k = F + B unknowns of an estimate.

    Attributes:
        times_ns: shape (T,) [ns, UTC], increasing.
        mean: shape (T, Z, r), ensemble mean m.
        moving: shape (T, F, K, r), patterns of unknowns given at each time.
        fixed: shape (B, K, r), patterns scaled by the spread alone.
        spread: shape (T,), factor of ``fixed``.
        functions: shape (K, Z), vertical functions.
        tau: shape (k,) [s], decorrelation times; inf if constant.
    """

    times_ns: Times
    mean: Array
    moving: Array
    fixed: Array
    spread: Array
    functions: Array
    tau: Array

    @property
    def size(self) -> int:
        """Number of unknowns k."""
        return int(self.moving.shape[1]) + len(self.fixed)

    @property
    def is_constant(self) -> bool:
        """Whether the current is constant in time."""
        return self.times_ns.size == 1 and not np.isfinite(self.tau).any()

    def __str__(self) -> str:
        """Return the decorrelation times as text."""
        days = np.unique(self.tau[np.isfinite(self.tau)]) / 86_400.0
        if not days.size:
            return f"constant in time; {self.size} unknowns"
        return f"decorrelation times {', '.join(f'{day:.1f}' for day in days)} days; {self.size} unknowns"

    def shares(self, times_ns: Times) -> Array:
        """Return the linear weights of the forecast times at times [ns, UTC], shape (n, T); constant outside them."""
        return hat_weights(times_ns, self.times_ns)

    def mean_at(self, time_ns: int) -> Array:
        """Return m at a time [ns, UTC], shape (Z, r)."""
        return self._at(time_ns, self.mean)

    def loading(self, time_ns: int) -> Array:
        """Return L at a time [ns, UTC], shape (k, K, r)."""
        if self.times_ns.size == 1:
            return self._constant_loading
        (shares,) = self.shares(np.array([time_ns]))
        return np.concatenate([self._at(time_ns, self.moving), (shares @ self.spread) * self.fixed])

    def weights(self, unknowns: Array, time_ns: int) -> Array:
        """Return the weights of unknowns, shape (..., k), at a time [ns, UTC]: shape (..., Z, r)."""
        in_functions = np.tensordot(unknowns, self.loading(time_ns), 1)
        return np.asarray(self.mean_at(time_ns) + self.functions.T @ in_functions)

    def project(self, modes: Array, times_ns: Times) -> tuple[Array, Array]:
        """Return the current at points for zero unknowns, and per unit of each unknown.

        Args:
            modes: shape (n, 2, r) [m/s per unit weight], modes at the points.
            times_ns: shape (n,) [ns, UTC].

        Returns:
            shapes (n, 2, Z) and (n, 2, K, k) [m/s].
        """
        shares, n = self.shares(times_ns), len(modes)
        flat, at = modes.reshape(2 * n, -1).T, np.flatnonzero(shares.any(axis=0))
        known = sum(shares[:, j, None, None] * (modes @ self.mean[j].T) for j in at)
        moving = sum(shares[:, j, None] * _times(self.moving[j], flat, n) for j in at)
        fixed = (shares @ self.spread)[:, None] * _times(self.fixed, flat, n)
        unit = np.concatenate([moving, fixed])
        return np.asarray(known), np.ascontiguousarray(unit.transpose(2, 3, 1, 0))

    def project_sums(self, sums: Array, shares: Array) -> tuple[Array, Array]:
        """Return sums of the current over points for zero unknowns, and per unit of each unknown.

        Args:
            sums: shape (T, m, Z, r), sums of the modes' currents over points, by level, weighted for each forecast time.
            shares: shape (T,), weights of the forecast times; those of 0 are not read.

        Returns:
            shapes (m,) and (m, k) [m/s].
        """
        at, axes, in_functions = np.flatnonzero(shares), ([1, 2], [1, 2]), self.functions @ sums
        known = sum(np.tensordot(sums[j], self.mean[j], 2) for j in at)
        moving = sum(np.tensordot(in_functions[j], self.moving[j], axes) for j in at)
        fixed = np.tensordot(np.tensordot(self.spread, in_functions, 1), self.fixed, axes)
        return np.asarray(known), np.hstack([moving, fixed])

    def kept(self, seconds: float) -> Array:
        """Return the factor exp(-dt / tau) of each unknown after a time [s], shape (k,)."""
        return np.asarray(np.exp(-seconds / self.tau))

    def since(self, time_ns: int) -> "Process":
        """Return the process without forecast times that matter only before a time [ns, UTC]."""
        first = max(int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1, 0)
        changing = ("times_ns", "mean", "moving", "spread")
        return replace(self, **{name: getattr(self, name)[first:] for name in changing})

    @cached_property
    def _constant_loading(self) -> Array:
        """Loading of a forecast at one time."""
        return np.concatenate([self.moving[0], self.spread[0] * self.fixed])

    def _at(self, time_ns: int, values: Array) -> Array:
        (shares,) = self.shares(np.array([time_ns]))
        return np.asarray(sum(shares[j] * values[j] for j in np.flatnonzero(shares)))


def _times(patterns: Array, flat: Array, n: int) -> Array:
    """Return the products of patterns, shape (b, K, r), with the modes at n points, shape (r, 2 n): shape (b, K, n, 2)."""
    rows = patterns.reshape(-1, patterns.shape[2]) @ flat
    return np.asarray(rows.reshape(*patterns.shape[:2], n, 2))


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
