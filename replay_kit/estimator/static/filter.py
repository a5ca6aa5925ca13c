"""The static estimator: an immutable problem, an immutable state, and one step shared by online and offline use."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import constant
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.basis.modes import build_basis, mean_variance
from replay_kit.estimator.basis.slices import cell_size, correlation_length
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.prior.amplitude import (
    AmplitudePrior,
    MeanAmplitude,
    before_the_log,
    scaled_prior,
)
from replay_kit.estimator.prior.centre import fitted_kernels
from replay_kit.estimator.prior.fit import choose_settings, left_out_amplitude, members_in_basis
from replay_kit.estimator.prior.hybrid import (
    HybridPrior,
    Prior,
    diagonal_prior,
    hybrid_prior,
    with_mean_amplitude,
)
from replay_kit.estimator.static.group import (
    StaticEstimator,
    fitting_step,
    group_column,
    own_column,
    profiles_of,
    rows_alone,
)
from replay_kit.estimator.static.state import FilterState, SpreadFit, with_mean_averaged
from replay_kit.estimator.update.group_step import GroupColumn, GroupedEstimator
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup, current_gradient
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import Posterior, PriorCrossCovariance, means
from replay_kit.estimator.update.representation import (
    PathProducts,
    PosteriorCovariance,
    inflated,
    predict,
    prefetch,
    select_representation,
)
from replay_kit.estimator.update.screening import ScreenedGroup, screen_group
from replay_kit.estimator.update.stack import Stack


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasisEstimator(StaticEstimator):
    """The paper's 2.5D estimator, in both presets."""

    supports_path_means = True
    # the products of so many observations with the prior covariance are computed together: it is read once for all
    block_size = 16

    @property
    def state_size(self) -> int:
        """Number of weights in all."""
        return int(self.prior.mean.size)

    @property
    def common_part(self) -> Prior:
        """The prior."""
        return self.prior

    def initial(self) -> FilterState:
        """Return the prior as a state."""
        return self.initial_with(self.spread)

    def prior_with(self, amplitude: MeanAmplitude) -> Prior:
        """Return the prior with a Gaussian of the ensemble mean's amplitude."""
        if self.basis.mean_weights is None or not isinstance(self.prior, HybridPrior):
            return self.prior
        moved = amplitude.moved(self.basis.member_anomalies)
        return AmplitudePrior(self.prior, self.basis.mean_weights, amplitude, moved)

    def step(self, state: FilterState, observation: Measurement) -> tuple[FilterState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin leaves the state unchanged.
        """
        return next(self.steps(state, [observation]))

    def steps(
        self, state: FilterState, observations: Iterable[Measurement]
    ) -> Iterator[tuple[FilterState, Innovation]]:
        """Yield the state after each observation, and its innovation.

        The same as repeated ``step``, but products that do not depend on earlier observations are computed for ``block_size`` of them
        at once: several times faster, and equal to rounding. While the prior's amplitude is fitted, it is ``step``.
        """
        source = iter(observations)
        while state.is_fitting:
            measurement = next(source, None)
            if measurement is None:
                return
            (stepped,) = fitting_step(self, state, measurement)
            state = stepped.after
            yield state, stepped.innovation
        yield from self.alone(state, source)

    def step_group(self, state: FilterState, group: ProfileGroup) -> list[Stepped[FilterState]]:
        """Return the outcome of the profiles of a group."""
        if state.is_fitting:
            return fitting_step(self, state, group)
        return GroupedEstimator.step_group(self, state, group)

    def alone(
        self, state: FilterState, measurements: Iterable[Measurement]
    ) -> Iterator[tuple[FilterState, Innovation]]:
        """Yield the state after each observation, and its innovation, with the prior's amplitude as it is."""
        source = iter(measurements)
        while block := [
            (screened, rows_alone(self, screened))
            for each in islice(source, self._block(state))
            for screened in (screen_group((each,), None, self.grid),)
        ]:
            prefetched: Iterator[PriorCrossCovariance] = iter(())
            products = PathProducts(rows for _, rows in block)
            made_by: Posterior | None = None
            for index, (screened, rows) in enumerate(block):
                innovation, posterior = screened.unused(0), state.posterior
                if rows is not None:
                    # what was prefetched holds until the posterior changes its representation or its prior
                    if made_by is None or made_by.prefetched_for is not posterior.prefetched_for:
                        made_by = posterior
                        prefetched = prefetch(posterior, [each for _, each in block[index:]])
                    predicted = predict(posterior, rows, prefetched, products)
                    if not rows.at_one_place:
                        made_by = None
                    screened = screened.following(state.last)
                    if screened.rejected:
                        innovation = screened.unused(0)
                    else:
                        at = own_column(self, state, rows, predicted)
                        update = self.evaluated(state, at)
                        (stepped,) = self.assimilated(screened, at, (state, update))
                        state, innovation = stepped.after, stepped.innovation
                yield state, innovation

    def _block(self, state: FilterState) -> int:
        """Return how many observations to take together: the prior of an average of the mean's amplitude is another one.

        After a mean along a path there is no average any more.
        """
        posterior, amplitude = state.posterior, state.mean_amplitude
        due = (
            amplitude.until_due(posterior.n)
            if amplitude
            and isinstance(posterior, ObservationSpacePosterior)
            and isinstance(posterior.prior, AmplitudePrior | HybridPrior)
            else None
        )
        return min(self.block_size, due or self.block_size)

    def group_column(self, state: FilterState, screened: ScreenedGroup) -> GroupColumn[FilterState]:
        """Return the estimate of the column that the usable profiles see: of the current at the levels."""
        return group_column(self, state, screened)

    def group_mean(self, state: FilterState, screened: ScreenedGroup) -> tuple[Stack, Array]:
        """Return the usable measurements, and the mean of their column: of one its rows', of several profiles that at the levels."""
        rows = rows_alone(self, screened) if len(screened.events) == 1 else None
        rows = rows or profiles_of(self, screened)
        return rows.stack, rows.matvec(self.by_level(state.mean))

    def with_posterior(
        self, at: GroupColumn[FilterState], posterior: Posterior, jacobian: float
    ) -> FilterState:
        """Return the state after a group."""
        time_ns = at.stack.observations[-1].time_ns
        return replace(at.state, posterior=select_representation(posterior), time_ns=time_ns)

    def inflated(self, state: FilterState, factor: float) -> FilterState:
        """Return a state whose covariance is multiplied by a factor, and the variance of the mean's amplitude averaged over."""
        if factor > 1.0:
            state = replace(state, posterior=inflated(state.posterior, factor))
        return with_mean_averaged(state, self.basis)

    def weights(self, states: Sequence[FilterState]) -> Sequence[Array | None]:
        """Return the means of states, each of shape (Z r,): those of neighbours in one run cost little more than one of them."""
        return list(means([state.posterior for state in states])) if states else []

    def flow(self, state: FilterState) -> FlowEstimate:
        """Return the current estimate of a state; its covariance is computed when first asked for."""
        return self.flow_of(state.mean, PosteriorCovariance(state.posterior), state.time_ns)

    def flow_of(
        self,
        mean: Array,
        covariance: Array | Callable[[tuple[int, ...] | None], Array],
        time_ns: int | None,
    ) -> FlowEstimate:
        """Return the current estimate of weights.

        Args:
            mean: shape (Z r,).
            covariance: shape (Z r, Z r), or a function that computes that of some levels' weights, None for all.
            time_ns: Of the last observation used [ns, UTC]; None for the forecast's.
        """
        flow = self.basis.flow(mean, covariance, self.time_ns if time_ns is None else time_ns)
        return replace(flow, later=constant)

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """Number of modes for each level, and of elements of the basis."""
        return self.basis.n_modes, self.basis.modes.size

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus its least-squares fit by the basis, shape (P, 2) [m/s]."""
        return self.basis.span_residual(points, depth, velocity)

    def notes(self) -> list[str]:
        """Return the settings of the prior, which may have been fitted."""
        return [f"prior: {self.prior.settings}"] if self.prior.settings else []

    def bias_notes(self, state: FilterState) -> list[str]:
        """Return the amplitude of the prior, where it is fitted."""
        return [] if state.spread is None else [str(state.spread)]

    def spread_record(self, state: FilterState) -> dict[str, str]:
        """Return the amplitude of the prior's covariance in a state, and what it was fitted to."""
        if state.spread is None:
            return {}
        return {
            "amplitude": repr(state.spread.amplitude),
            "by_scale": " ".join(map(repr, state.spread.tilt)),
            "measurements": str(state.spread.fitted_to),
        }


def build_estimator(
    ensemble: Ensemble, config: EstimatorConfig, gating: GatingConfig | None = None
) -> ReducedBasisEstimator:
    """Return the estimator of the configuration's preset for an ensemble.

    Args:
        ensemble: The forecast at one time.
        config: Preset, basis and prior.
        gating: Gate and covariance inflation of the default preset; None accepts every profile with its stated errors.
    """
    basis = build_basis(ensemble, config)
    if config.preset == "paper":
        variances = scaled_prior(diagonal_prior(basis.member_weights), config.spread)
        return ReducedBasisEstimator(
            basis, variances, config.paper_error_std, basis.truncation_std, ensemble.time_ns
        )
    members = members_in_basis(basis)
    settings = choose_settings(members, correlation_length(ensemble), config)
    prior = hybrid_prior(members.weights, members.shifted(settings), settings)
    spread, amplitude = None, None
    if config.spread == "fit" or (config.spread is None and ensemble.made_from):
        expected = left_out_amplitude(members, settings)
        spread = SpreadFit(
            expected, expected, 0, 0.5 * float(np.sqrt(np.prod(cell_size(ensemble.grid))))
        )
    if basis.mean_weights is not None:
        # one of both is fitted to the log
        amplitude = (
            before_the_log(fitted_kernels(members, settings))
            if config.mean_variance is None
            and spread is None
            and not isinstance(config.spread, float)
            else None
        )
        prior = with_mean_amplitude(
            prior, basis.mean_weights, amplitude.variance if amplitude else mean_variance(config)
        )
    scaled, grouping = scaled_prior(prior, config.spread), Grouping(current_gradient(ensemble))
    representation_std = basis.representation_std(config)
    return ReducedBasisEstimator(
        basis,
        scaled,
        None,
        representation_std,
        ensemble.time_ns,
        gating,
        spread,
        grouping,
        amplitude,
    )
