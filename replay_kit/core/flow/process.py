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

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.core.flow.functions import hats


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
        return hats(times_ns, self.times_ns)

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
