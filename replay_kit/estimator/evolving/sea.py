"""The prior of the weights through time, in a state of independent unknowns.

The weights at time t are

    w(t) = m(t) + sum_f T_f(t) c_f + s(t) sum_b L_b b_b,

with m the ensemble's mean, T_f the anomaly of a member or of one of its shifted copies, which moves and grows as the member's forecast
does, L_b the directions of the localised covariance, and s how the ensemble's spread grows. The coefficients c and b are independent,
of unit variance, and forgotten at their own rates: Ornstein-Uhlenbeck processes, so that

    cov(w(t), w(t')) = exp(-|t - t'| / tau_c) T(t)' T(t') + exp(-|t - t'| / tau_b) s(t) s(t') L' L.

At one time this is the hybrid prior of a static estimate. Between the forecast's times all is linear; outside them the nearest holds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Sea:
    """How the weights' prior goes through time.

    Attributes:
        times_ns: shape (T,) [ns, UTC], increasing.
        mean: shape (T, Z, r), m.
        trajectories: shape (T, F, Z, r), T_f.
        spread: shape (T,), s.
        local: shape (B, Z, r), L_b.
        trajectory_scale: tau_c [s]; inf never forgets.
        local_scale: tau_b [s]; inf never forgets.
    """

    times_ns: NDArray[np.int64]
    mean: Array
    trajectories: Array
    spread: Array
    local: Array
    trajectory_scale: float
    local_scale: float

    def __str__(self) -> str:
        """Return in words what is forgotten, and how fast."""
        days = [scale / 86_400.0 for scale in (self.local_scale, self.trajectory_scale)]
        if not np.isfinite(days).any():
            return f"nothing is forgotten; {self.size} unknowns"
        words = [f"{value:.1f} days" if np.isfinite(value) else "never" for value in days]
        return f"what is local is forgotten over {words[0]}, mixtures of the members over {words[1]}; {self.size} unknowns"

    @property
    def size(self) -> int:
        """Number of unknowns F + B."""
        return int(self.trajectories.shape[1]) + len(self.local)

    @property
    def scales(self) -> Array:
        """How long each unknown is remembered, shape (F + B,) [s]."""
        return np.repeat([self.trajectory_scale, self.local_scale], [self.trajectories.shape[1], len(self.local)])

    def mean_at(self, time_ns: int) -> Array:
        """Return m, shape (Z, r)."""
        before, after, share = self._between(time_ns)
        return np.asarray((1.0 - share) * self.mean[before] + share * self.mean[after])

    def loading(self, time_ns: int) -> Array:
        """Return what one of each unknown does to the weights, shape (F + B, Z, r)."""
        before, after, share = self._between(time_ns)
        trajectories = (1.0 - share) * self.trajectories[before] + share * self.trajectories[after]
        return np.concatenate([trajectories, self._spread_at(time_ns) * self.local])

    def weights(self, unknowns: Array, time_ns: int) -> Array:
        """Return the weights of unknowns, shape (F + B,), about the basis's offset: shape (Z, r)."""
        before, after, share = self._between(time_ns)
        coefficients, rest = np.split(unknowns, [self.trajectories.shape[1]])
        parts = [np.tensordot(coefficients, self.trajectories[k], 1) for k in (before, after)]
        moved = (1.0 - share) * parts[0] + share * parts[1]
        return np.asarray(self.mean_at(time_ns) + moved + self._spread_at(time_ns) * np.tensordot(rest, self.local, 1))

    def seen(self, basis: Array, time_ns: int) -> Array:
        """Return what one of each unknown does to the current at a place, level by level: shape (F + B, Z, c) [m/s].

        The same as ``loading(time_ns) @ basis.T``, without making the loading.

        Args:
            basis: shape (c, r), the modes' velocity at the place.
            time_ns: [ns, UTC].
        """
        before, after, share = self._between(time_ns)
        trajectories = self.trajectories[before] @ basis.T
        if share > 0.0:
            trajectories = (1.0 - share) * trajectories + share * (self.trajectories[after] @ basis.T)
        return np.concatenate([trajectories, self._spread_at(time_ns) * (self.local @ basis.T)])

    def _spread_at(self, time_ns: int) -> float:
        before, after, share = self._between(time_ns)
        return float((1.0 - share) * self.spread[before] + share * self.spread[after])

    def _between(self, time_ns: int) -> tuple[int, int, float]:
        """Return the positions of the times before and after, and how far between them a time lies."""
        after = int(np.searchsorted(self.times_ns, time_ns))
        if after == 0 or after == self.times_ns.size:
            nearest = min(after, self.times_ns.size - 1)
            return nearest, nearest, 0.0
        first, last = int(self.times_ns[after - 1]), int(self.times_ns[after])
        return after - 1, after, (time_ns - first) / (last - first)
