"""The nearest member: the one with the least sum of squared differences from the measurements so far (the paper's baseline)."""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import deterministic_flow, embed_columns
from replay_kit.estimator.baselines.profiles import ColumnBaseline, Predictions, ProfileBins
from replay_kit.estimator.basis.slices import ensemble_slices


@dataclass(frozen=True, slots=True, eq=False)
class MemberErrors:
    """The distance of each member from the measurements so far.

    Attributes:
        sum_of_squares: shape (E,), of measured minus member over the bins' errors.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    sum_of_squares: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class NearestMember(ColumnBaseline[MemberErrors]):
    """Chooses among the members; without a measurement, the one nearest to their mean.

    Attributes:
        columns: The members as flows; compared with the measurements at their places.
        time_ns: Time of the forecast.
        distance: shape (E,), of each member from the mean, for the choice before any measurement and between equals.
    """

    distance: Array

    @property
    def state_size(self) -> int:
        """Number of members E."""
        return self.distance.size

    def initial(self) -> MemberErrors:
        """Return the state before any observation."""
        return MemberErrors(np.zeros(self.distance.size), None)

    def chosen(self, state: MemberErrors) -> int:
        """Return the position of the nearest member of a state."""
        return int(np.lexsort((self.distance, state.sum_of_squares))[0])

    def assimilate(
        self, state: MemberErrors, bins: ProfileBins
    ) -> tuple[MemberErrors, Predictions]:
        """Return the state after a profile, and the predictions of its bins, without a standard deviation."""
        by_member = np.moveaxis(self.at_bins(bins), -1, 0)
        errors = (bins.values - by_member) / bins.error_std()[:, None]
        after = MemberErrors(
            state.sum_of_squares + np.sum(errors**2, axis=(1, 2)), bins.observation.time_ns
        )
        before, now, prior = (by_member[self.chosen(s)] for s in (state, after, self.initial()))
        return after, Predictions(before, now, prior, np.full_like(before, np.nan))

    def predict_bins(self, state: MemberErrors, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        return self.at_bins(bins)[..., self.chosen(state)]

    def flow(self, state: MemberErrors) -> FlowEstimate:
        """Return the chosen member."""
        return deterministic_flow(
            self.columns,
            np.eye(self.distance.size)[self.chosen(state)],
            self.time_of(state.time_ns),
        )

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus that of the member with the least root mean square difference, shape (P, 2) [m/s]."""
        residual = velocity[..., None] - self.columns.velocity(points, depth)
        return np.asarray(residual[..., np.argmin(np.sum(residual**2, axis=(0, 1)))])


def build_nearest(ensemble: Ensemble, config: EstimatorConfig) -> NearestMember:
    """Return the nearest-member baseline of an ensemble."""
    slices = ensemble_slices(ensemble)
    members = embed_columns(ensemble.grid, slices, config)
    distance = np.sum((slices - slices.mean(axis=0)) ** 2, axis=(1, 2))
    return NearestMember(members, ensemble.time_ns, distance)
