"""How a flow changes after the time that it holds for."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.field import FlowField
from replay_kit.core.flow.process import ProcessModel

Flow = TypeVar("Flow", bound=FlowField)


def constant(flow: Flow, time_ns: int) -> Flow:
    """Return the flow of a static estimate for another time [ns, UTC]: it holds at any time as it is."""
    return replace(flow, time_ns=time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Evolution:
    """The change of an estimate with time: called with the flow and a time [ns, UTC], it returns the flow for that time.

    Attributes:
        process: Prior of the weights through time.
        offset: shape (2N, Z), latent velocities of the flow whose weights are 0.
        mean: shape (n,), of the process's unknowns after the last observation.
        covariance: Returns their covariance, shape (n, n); it is computed when first asked for.
        time_ns: Time of both [ns, UTC]; None before any observation, where they hold at any time.
    """

    process: ProcessModel
    offset: Array
    mean: Array
    covariance: Callable[[], Array]
    time_ns: int | None

    def __call__(self, flow: Flow, time_ns: int) -> Flow:
        """Return the flow for a time; for one before the last observation, at the time of that observation."""
        return self._after(time_ns).flow(flow, time_ns if self.time_ns is None else max(time_ns, self.time_ns))

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

        return replace(flow, latent=self.offset + flow.modes @ weights.T, covariance=covariance, time_ns=time_ns, later=self)

    def trimmed(self) -> "Evolution":
        """Return the evolution without the forecast's times that are over."""
        return self if self.time_ns is None else replace(self, process=self.process.since(self.time_ns))

    def _after(self, time_ns: int) -> "Evolution":
        """Return the unknowns at a time: each decays, and process noise keeps the prior's variance of 1."""
        if self.time_ns is None or time_ns <= self.time_ns:
            return self
        past = (time_ns - self.time_ns) / 1e9 / self.process.scales
        kept = np.exp(-past)

        @cache
        def covariance() -> Array:
            return np.asarray(kept[:, None] * self.covariance() * kept + np.diag(-np.expm1(-2.0 * past)))

        return replace(self, mean=kept * self.mean, covariance=covariance, time_ns=time_ns)
