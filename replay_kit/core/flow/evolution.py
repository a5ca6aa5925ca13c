"""How a flow changes after the time that it holds for: the process model, and the estimate of its unknowns.

The process model is the prior of the weights through time, with a state of independent unknowns. The weights at time t are

    w(t) = m(t) + sum_f T_f(t) c_f + s(t) sum_b L_b b_b,

with m the ensemble mean, T_f the anomaly of a member or of one of its shifted copies, which moves and grows with the member's forecast,
L_b the directions of the localised covariance, and s the growth of the ensemble's spread. The coefficients c and b are independent
Ornstein-Uhlenbeck processes of unit variance, each with its own decorrelation time, so that

    cov(w(t), w(t')) = exp(-|t - t'| / tau_c) T(t)' T(t') + exp(-|t - t'| / tau_b) s(t) s(t') L' L.

At one time this is the hybrid prior of a static estimate, and the filter equals the static one to 1e-12. T_f moves and grows with its own
forecast, so that information on c_f holds downstream. tau_b is estimated from the correlation of the ensemble's anomalies between
neighbouring times. Everything is linear between the forecast's times and constant outside them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import root_of
from replay_kit.core.flow.field import FlowField
from replay_kit.core.flow.local import Oscillation


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

    def shares(self, times_ns: NDArray[np.int64]) -> Array:
        """Return the share of each forecast time at times [ns, UTC], shape (P, T): linear between these, constant outside them."""
        if self.times_ns.size == 1:
            return np.ones((len(times_ns), 1))
        last = self.times_ns.size - 2
        before = np.clip(np.searchsorted(self.times_ns, times_ns) - 1, 0, last)
        out = np.zeros((len(times_ns), self.times_ns.size))
        first, step = self.times_ns[before], np.diff(self.times_ns)[before]
        share = np.clip((times_ns - first) / step, 0.0, 1.0)
        rows = np.arange(len(times_ns))
        out[rows, before], out[rows, before + 1] = 1.0 - share, share
        return out

    def project_sum(self, levels: Array, modes: Array, shares: Array) -> tuple[Array, Array]:
        """Return the sum of the current over points, each at its own time: without the unknowns, and of one unit of each.

        Args:
            levels: shape (P, Z), the weight of each level at each point.
            modes: shape (c, P, r), the modes' velocity at the points.
            shares: shape (P, T), see ``shares``.

        Returns:
            shapes (c,) and (F + B, c) [m/s].
        """
        axes = ([-2, -1], [1, 2])
        known = np.zeros(len(modes))
        trajectories = np.zeros((self.trajectories.shape[1], len(modes)))
        for k in np.flatnonzero(shares.any(axis=0)):
            of_time = (shares[:, k, None] * levels).T @ modes  # (c, Z, r)
            known += np.tensordot(self.mean[k], of_time, axes)
            trajectories += np.tensordot(self.trajectories[k], of_time, axes)
        local = ((shares @ self.spread)[:, None] * levels).T @ modes
        return known, np.concatenate([trajectories, np.tensordot(self.local, local, axes)])

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


Flow = TypeVar("Flow", bound=FlowField)


def constant(flow: Flow, time_ns: int) -> Flow:
    """Return the flow of a static estimate for another time [ns, UTC]: it holds at any time as it is."""
    return replace(flow, time_ns=time_ns)


def sample_through(
    flow: Flow, times_ns: Sequence[int], n: int, seed: int
) -> tuple[tuple[Flow, ...], ...]:
    """Return n currents drawn through time from an estimate: of each the flows at the times [ns, UTC].

    Where the current changes, so do they, and they part at the rate at which the estimate becomes uncertain. Of an estimate that does not
    change each holds at all times.

    Raises:
        EstimatorError: The flow carries no uncertainty.
    """
    if isinstance(flow.later, Evolution) and flow.n_modes:
        return flow.later.sample(flow, times_ns, n, seed)
    return tuple(
        tuple(constant(one, time_ns) for time_ns in times_ns) for one in flow.sample(n, seed)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Evolution:
    """The change of an estimate with time: called with the flow and a time [ns, UTC], it returns the flow for that time.

    Attributes:
        process: Prior of the weights through time.
        offset: shape (2N, Z), latent velocities of the flow whose weights are 0.
        mean: shape (n,), of the process's unknowns after the last observation.
        covariance: Returns their covariance, shape (n, n); it is computed when first asked for.
        time_ns: Time of both [ns, UTC]; None before any observation, where they hold at any time.
        oscillation: Known beside the slow current, which flows are without; None where there is none.
    """

    process: ProcessModel
    offset: Array
    mean: Array
    covariance: Callable[[], Array]
    time_ns: int | None
    oscillation: Oscillation | None = None

    def __call__(self, flow: Flow, time_ns: int) -> Flow:
        """Return the flow for a time; for one before the last observation, at the time of that observation."""
        return self.unknowns_at(time_ns).flow(
            flow, time_ns if self.time_ns is None else max(time_ns, self.time_ns)
        )

    def flow(self, flow: Flow, time_ns: int) -> Flow:
        """Return the flow of the unknowns as they are.

        Args:
            flow: A flow on the same basis.
            time_ns: Of the process [ns, UTC].
        """
        weights = self.process.weights(self.mean, time_ns)

        @cache
        def covariance(levels: tuple[int, ...] | None) -> Array:
            chosen = slice(None) if levels is None else list(levels)
            loading = self.process.loading(time_ns)[:, chosen].reshape(self.process.size, -1)
            return np.asarray(loading.T @ self.covariance() @ loading)

        return replace(
            flow,
            latent=self.offset + flow.modes @ weights.T,
            covariance=covariance,
            time_ns=time_ns,
            later=self,
        )

    def sample(
        self, flow: Flow, times_ns: Sequence[int], n: int, seed: int
    ) -> tuple[tuple[Flow, ...], ...]:
        """Return n currents drawn through time: of each the flows at the times, without uncertainty.

        The unknowns are drawn at the first time; from each time to the next they decay and take up process noise, so that the currents
        drawn have the estimate's mean and covariance at every time, and the process's correlation between times.

        Args:
            flow: A flow on the same basis.
            times_ns: Of the process, in order; those before the last observation count as its time [ns, UTC].
            n: Number of currents.
            seed: The same seed gives the same currents.
        """
        times = [
            time_ns if self.time_ns is None else max(time_ns, self.time_ns) for time_ns in times_ns
        ]
        rng, first = np.random.default_rng(seed), self.unknowns_at(times[0])
        factor = root_of(first.covariance())
        unknowns = first.mean + rng.standard_normal((n, factor.shape[1])) @ factor.T
        mean_flow, drawn = flow.mean_flow(), list[list[Flow]]()
        for before, time_ns in zip([times[0], *times[:-1]], times, strict=True):
            past = (time_ns - before) / 1e9 / self.process.scales
            if time_ns > before:
                unknowns = np.exp(-past) * unknowns + np.sqrt(
                    -np.expm1(-2.0 * past)
                ) * rng.standard_normal(unknowns.shape)
            moved = np.tensordot(unknowns, self.process.loading(time_ns), 1) + self.process.mean_at(
                time_ns
            )
            latent = self.offset + flow.modes @ np.swapaxes(moved, 1, 2)
            drawn.append([replace(mean_flow, latent=one, time_ns=time_ns) for one in latent])
        return tuple(zip(*drawn, strict=True))

    def trimmed(self) -> "Evolution":
        """Return the evolution without the forecast's times that are over."""
        return (
            self
            if self.time_ns is None
            else replace(self, process=self.process.since(self.time_ns))
        )

    def unknowns_at(self, time_ns: int) -> "Evolution":
        """Return the unknowns at a time [ns, UTC]: each decays, and process noise keeps the prior's variance of 1."""
        if self.time_ns is None or time_ns <= self.time_ns:
            return self
        past = (time_ns - self.time_ns) / 1e9 / self.process.scales
        kept = np.exp(-past)

        @cache
        def covariance() -> Array:
            return np.asarray(
                kept[:, None] * self.covariance() * kept + np.diag(-np.expm1(-2.0 * past))
            )

        return replace(self, mean=kept * self.mean, covariance=covariance, time_ns=time_ns)
