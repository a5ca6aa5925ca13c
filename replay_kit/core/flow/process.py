"""The process model: the prior of the weights through time, with a state of independent unknowns.

The weights at time t are

    w(t) = m(t) + sum_f T_f(t) c_f + s(t) sum_b L_b b_b,

with m the ensemble mean, T_f the anomaly of a member or of one of its shifted copies, which moves and grows with the member's forecast,
L_b the directions of the localised covariance, and s the growth of the ensemble's spread. The coefficients c and b are independent
Ornstein-Uhlenbeck processes of unit variance, each with its own decorrelation time, so that

    cov(w(t), w(t')) = exp(-|t - t'| / tau_c) T(t)' T(t') + exp(-|t - t'| / tau_b) s(t) s(t') L' L.

At one time this is the hybrid prior of a static estimate, and the filter equals the static one to 1e-12. T_f moves and grows with its own
forecast, so that information on c_f holds downstream. tau_b is estimated from the correlation of the ensemble's anomalies between
neighbouring times. Everything is linear between the forecast's times and constant outside them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class ProcessModel:
    """The prior of the weights through time.

    Attributes:
        times_ns: shape (T,) [ns, UTC], increasing.
        mean: shape (T, Z, r), m.
        trajectories: shape (T, F, Z, r), T_f.
        spread: shape (T,), s.
        local: shape (B, Z, r), L_b.
        trajectory_scale: tau_c [s]; inf for constants.
        local_scale: tau_b [s]; inf for constants.
    """

    times_ns: NDArray[np.int64]
    mean: Array
    trajectories: Array
    spread: Array
    local: Array
    trajectory_scale: float
    local_scale: float

    def __str__(self) -> str:
        """Return the decorrelation times as text."""
        days = [scale / 86_400.0 for scale in (self.local_scale, self.trajectory_scale)]
        if not np.isfinite(days).any():
            return f"constant in time; {self.size} unknowns"
        words = [f"{value:.1f} days" if np.isfinite(value) else "infinite" for value in days]
        return f"decorrelation time {words[0]} for local corrections, {words[1]} for mixtures of the members; {self.size} unknowns"

    @property
    def size(self) -> int:
        """Number of unknowns F + B."""
        return int(self.trajectories.shape[1]) + len(self.local)

    @property
    def scales(self) -> Array:
        """Decorrelation time of each unknown, shape (F + B,) [s]."""
        return np.repeat(
            [self.trajectory_scale, self.local_scale], [self.trajectories.shape[1], len(self.local)]
        )

    def since(self, time_ns: int) -> "ProcessModel":
        """Return the process without the forecast's times that count only before a time [ns, UTC]."""
        kept = slice(max(int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1, 0), None)
        return replace(
            self,
            times_ns=self.times_ns[kept],
            mean=self.mean[kept],
            trajectories=self.trajectories[kept],
            spread=self.spread[kept],
        )

    def mean_at(self, time_ns: int) -> Array:
        """Return m, shape (Z, r)."""
        return self._interpolate(time_ns, lambda k: self.mean[k])

    def loading(self, time_ns: int) -> Array:
        """Return the effect of one unit of each unknown on the weights, shape (F + B, Z, r)."""
        return np.concatenate([self.trajectories_at(time_ns), self.spread_at(time_ns) * self.local])

    def trajectories_at(self, time_ns: int) -> Array:
        """Return T_f at a time [ns, UTC], shape (F, Z, r)."""
        return self._interpolate(time_ns, lambda k: self.trajectories[k])

    def weights(self, unknowns: Array, time_ns: int) -> Array:
        """Return the weights of unknowns, shape (F + B,), about the basis's offset: shape (Z, r)."""
        coefficients, rest = np.split(unknowns, [self.trajectories.shape[1]])
        moved = self._interpolate(
            time_ns, lambda k: np.tensordot(coefficients, self.trajectories[k], 1)
        )
        return np.asarray(
            self.mean_at(time_ns)
            + moved
            + self.spread_at(time_ns) * np.tensordot(rest, self.local, 1)
        )

    def project(self, basis: Array, time_ns: int) -> Array:
        """Return the effect of one unit of each unknown on the current at a place, level by level: shape (F + B, Z, c) [m/s].

        The same as ``loading(time_ns) @ basis.T``, without making the loading.

        Args:
            basis: shape (c, r), the modes' velocity at the place.
            time_ns: [ns, UTC].
        """
        trajectories = self._interpolate(time_ns, lambda k: self.trajectories[k] @ basis.T)
        return np.concatenate([trajectories, self.spread_at(time_ns) * (self.local @ basis.T)])

    def spread_at(self, time_ns: int) -> float:
        """Return s at a time [ns, UTC]."""
        return float(self._interpolate(time_ns, lambda k: self.spread[k]))

    def _interpolate(self, time_ns: int, at: Callable[[int], Array]) -> Array:
        """Return a function of the position of a forecast time, linear between these times and constant outside them."""
        after = int(np.searchsorted(self.times_ns, time_ns))
        if after == 0 or after == self.times_ns.size:
            return at(min(after, self.times_ns.size - 1))
        first, last = int(self.times_ns[after - 1]), int(self.times_ns[after])
        share = (time_ns - first) / (last - first)
        return np.asarray((1.0 - share) * at(after - 1) + share * at(after))
