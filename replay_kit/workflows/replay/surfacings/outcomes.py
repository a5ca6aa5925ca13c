"""Predicted surfacing from a model of dives, and its score with the actual fix."""

from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import (
    SHARES,
    Basis,
    DiveForecast,
    DiveOutcome,
    ellipse_of,
    forecast_place,
)
from replay_kit.estimator.next_dive.mixture import Mixture, Persistence
from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess, ProcessState


@dataclass(frozen=True, slots=True, eq=False)
class Before:
    """Knowledge before a dive.

    Attributes:
        model: Model of dives.
        state: State of the model after the dives so far; None before the first, as it is large.
        persistence: Baseline prediction, as in the last dive.
    """

    model: MeanCurrentProcess
    state: ProcessState | None = None
    persistence: Persistence = field(default_factory=Persistence)

    @property
    def known(self) -> ProcessState:
        """State of the model; its initial state before the first dive."""
        return self.model.initial() if self.state is None else self.state

    def forecast(
        self, dive: DiveMean, start: Fix, number: int, basis: Basis = "mean_currents"
    ) -> DiveForecast:
        """Return the predicted end of a dive.

        Args:
            dive: Time, duration, velocity through the water, depths and backgrounds of the dive; its current is not used.
            start: Fix before it.
            number: Number of the dive.
            basis: Basis of the prediction.
        """
        return self._placed(self.model.forecast(self.known, dive), dive, start, number, basis)

    def _placed(
        self, expected: Mixture, dive: DiveMean, start: Fix, number: int, basis: Basis
    ) -> DiveForecast:
        longitude, latitude = forecast_place(start, dive.seconds, dive.way + expected.mean)
        cov = dive.seconds**2 * expected.cov
        inner, outer = (
            ellipse_of(longitude, latitude, cov, radius) for radius in expected.radii(SHARES)
        )
        return DiveForecast(
            dive=number,
            earlier=self.known.dives,
            start=start,
            time_ns=start.time_ns + round(dive.seconds * 1e9),
            longitude=longitude,
            latitude=latitude,
            inner=inner,
            outer=outer,
            persistence_radius=self.persistence.radius(SHARES[1]) * dive.seconds,
            basis=basis,
        )

    def after(
        self, dive: DiveMean, fixes: tuple[Fix, Fix], number: int, basis: Basis = "mean_currents"
    ) -> "tuple[Before, DiveOutcome]":
        """Return the knowledge after a dive, and its predicted end with the score.

        Args:
            dive: The dive with its observations.
            fixes: Fixes before and after it.
            number: Number of the dive.
            basis: Basis of the prediction.
        """
        start, end = fixes
        expected = self.model.forecast(self.known, dive)
        last = self.persistence.velocity
        off = np.nan if last is None else float(np.hypot(*(dive.velocity - last)))
        outcome = DiveOutcome(
            forecast=self._placed(expected, dive, start, number, basis),
            fix=Fix(*end),
            log_score=expected.log_density(dive.velocity),
            persistence_log_score=self.persistence.log_density(dive.velocity),
            persistence_distance=off * dive.seconds,
        )
        state = self.model.step(self.known, dive)
        return Before(self.model, state, self.persistence.after(dive.velocity)), outcome
