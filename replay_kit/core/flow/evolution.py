"""How a flow changes after the time that it holds for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import root_of
from replay_kit.core.flow.field import FlowField
from replay_kit.core.flow.oscillation import Oscillation
from replay_kit.core.flow.process import ProcessModel

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
