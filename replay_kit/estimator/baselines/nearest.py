"""The nearest member: the one with the least sum of squared misfits to the measurements so far (the paper's baseline)."""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.baselines.columns import FlowColumns, certain_flow, default_kernel, embed_columns
from replay_kit.estimator.baselines.profiles import Predictions, innovation_of, usable_bins
from replay_kit.estimator.basis.modes import ensemble_slices
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.update.screening import rejected, scatter


@dataclass(frozen=True, slots=True, eq=False)
class MisfitState:
    """How far each member is from the measurements so far.

    Attributes:
        sum_of_squares: shape (E,), of the misfits over the bins' errors.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    sum_of_squares: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class NearestMember(Estimator[MisfitState]):
    """Chooses among the members; without a measurement, the one nearest to their mean.

    Attributes:
        members: The members as flows; misfits are taken from them at the measurements' places.
        distance: shape (E,), of each member from the mean, for the choice before any measurement and among equals.
        time_ns: Time of the forecast.
    """

    members: FlowColumns
    distance: Array
    time_ns: int | None

    def initial(self) -> MisfitState:
        """Return the state before any observation."""
        return MisfitState(np.zeros(self.distance.size), None)

    def chosen(self, state: MisfitState) -> int:
        """Return the position of the member that a state stands for."""
        return int(np.lexsort((self.distance, state.sum_of_squares))[0])

    def step(self, state: MisfitState, observation: Observation) -> tuple[MisfitState, Innovation]:
        """Return the state after an observation, and the innovation, which has no standard deviation."""
        bins = usable_bins(observation, self.members.grid)
        if bins.used.size == 0:
            return state, rejected(observation, bins.flags, bins.reasons)
        by_member = np.einsum("nz,czm->mnc", bins.depth_weights, self.members.at_place(bins.place))
        misfit = (bins.values - by_member) / np.hypot(observation.error_std[bins.used, None], observation.common_std)
        after = MisfitState(state.sum_of_squares + np.sum(misfit**2, axis=(1, 2)), observation.time_ns)
        before, now, prior = (by_member[self.chosen(s)] for s in (state, after, self.initial()))
        return after, innovation_of(observation, bins, Predictions(before, now, prior, np.full_like(before, np.nan)), np.nan)

    def misfit(self, state: MisfitState, observation: Observation) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        bins = usable_bins(observation, self.members.grid)
        at_levels = self.members.at_place(bins.place)[..., self.chosen(state)]
        return scatter(observation.depth.size, bins.used, bins.values - bins.depth_weights @ at_levels.T)

    def flow(self, state: MisfitState) -> FlowEstimate:
        """Return the chosen member."""
        time_ns = self.time_ns if state.time_ns is None else state.time_ns
        return certain_flow(self.members, np.eye(self.distance.size)[self.chosen(state)], time_ns)


def build_nearest(ensemble: Ensemble, config: EstimatorConfig) -> NearestMember:
    """Return the nearest-member baseline of an ensemble."""
    slices = ensemble_slices(ensemble)
    members = embed_columns(ensemble.grid, default_kernel(ensemble.grid, config), slices, config.nugget)
    distance = np.sum((slices - slices.mean(axis=0)) ** 2, axis=(1, 2))
    return NearestMember(members, distance, ensemble.time_ns)
