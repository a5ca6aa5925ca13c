"""The estimator: a frozen problem, a frozen state, and one step that online and offline use share."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import TrustConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import velocity_kernel
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation, PathMean, Reason
from replay_kit.estimator.basis.modes import Basis, build_basis, correlation_length
from replay_kit.estimator.basis.noise import bin_noise
from replay_kit.estimator.basis.paths import PathRows, look_along, path_rows
from replay_kit.estimator.prior.fit import choose_settings, members_in
from replay_kit.estimator.prior.hybrid import Prior, diagonal_prior, hybrid_prior
from replay_kit.estimator.update.biases import NAMES, Evidence, unit_columns
from replay_kit.estimator.update.dual import initial
from replay_kit.estimator.update.forms import in_cheaper_form, inflated
from replay_kit.estimator.update.gate import Watch
from replay_kit.estimator.update.kalman import ProfileRows, compress_profile
from replay_kit.estimator.update.observation import look_at
from replay_kit.estimator.update.posterior import Ahead, Look, Posterior, means
from replay_kit.estimator.update.screening import as_profile, is_repeated, rejected, repeated, scatter, screen, usable

# Observations whose products with the prior covariance are computed together when they are known: one reading of it for all.
BLOCK = 16
_NO_WATCH_YET, _NO_EVIDENCE_YET = Watch(), Evidence()


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """What is known of the weights at one time.

    Attributes:
        posterior: Of the weights, in the form that is cheaper at the time.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        watch: Over the latest verdicts.
        last: Observation offered last; the same once more is no news.
        evidence: Of errors of the instrument.
    """

    posterior: Posterior
    time_ns: int | None
    watch: Watch = _NO_WATCH_YET
    last: Observation | PathMean | None = None
    evidence: Evidence = _NO_EVIDENCE_YET

    @property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level; computed when first asked for."""
        return self.posterior.mean


def means_of(states: Sequence[FilterState]) -> Array:
    """Return the means of states, shape (m, Z r): those of neighbours in one run cost little more than one of them."""
    return means([state.posterior for state in states])


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasisEstimator:
    """The paper's 2.5D estimator, in both presets.

    Attributes:
        basis: Basis flows.
        prior: Of the weights.
        error_std: Error of every bin [m/s], replacing the bins' own (paper); None adds ``representation_std`` to the bins' own.
        representation_std: shape (Z,) [m/s], what a bin sees and the basis cannot show, by level.
        time_ns: Time of the forecast.
        trust: Gate and watch; None believes every profile as it is (paper).
    """

    basis: Basis
    prior: Prior
    error_std: float | None
    representation_std: Array
    time_ns: int | None
    trust: TrustConfig | None = None

    takes_paths = True

    @property
    def state_size(self) -> int:
        """Number of weights in all."""
        return int(self.prior.mean.size)

    def initial(self) -> FilterState:
        """Return the prior as a state."""
        n_levels = self.basis.grid.levels.size
        return FilterState(initial(self.prior, np.zeros((len(NAMES), n_levels, self.prior.mean.size // n_levels))), None)

    def step(self, state: FilterState, observation: Observation | PathMean) -> tuple[FilterState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin leaves the state untouched.
        """
        return next(self.steps(state, [observation]))

    def steps(self, state: FilterState, observations: Iterable[Observation | PathMean]) -> Iterator[tuple[FilterState, Innovation]]:
        """Yield the state after each observation, and its innovation.

        The same as ``step`` over and over, but what does not depend on the observations before is computed for ``BLOCK`` of them at
        once: several times quicker, and equal to rounding.
        """
        source = iter(observations)
        while block := [self._screened(observation) for observation in islice(source, BLOCK)]:
            ahead: Iterator[Ahead] = iter(())
            made_by: Posterior | None = None
            for index, screened in enumerate(block):
                innovation = screened.said
                rows, known = screened.rows, None
                if isinstance(rows, ProfileRows):
                    if made_by is None or type(made_by) is not type(state.posterior) or made_by.prior is not state.posterior.prior:
                        made_by = state.posterior
                        ahead = iter(made_by.ahead([later.rows for later in block[index:] if isinstance(later.rows, ProfileRows)]))
                    known = next(ahead)
                if rows is not None and is_repeated(state.last, screened.observation):
                    innovation = repeated(screened.said, Reason.DUPLICATE)
                elif isinstance(rows, ProfileRows) and known is not None:
                    state, innovation = self._absorbed(state, screened, rows, state.posterior.look(rows, known))
                elif isinstance(rows, PathRows):
                    state, innovation = self._absorbed(state, screened, rows, look_along(state.posterior, rows))
                yield state, innovation

    def _absorbed(
        self, state: FilterState, screened: "_Screened", rows: ProfileRows | PathRows, look: Look[Posterior]
    ) -> tuple[FilterState, Innovation]:
        """Return the state after an observation that is expected to be as ``look`` says, and the innovation."""
        looked = look_at(rows, screened.values, look, self.trust, self.error_std is None, state.watch.settled)
        misfit = rows.misfit(screened.values, look.mean)
        columns = unit_columns(screened.observation, screened.used, self.basis.grid.projection, rows, misfit)
        posterior = state.posterior
        if looked.believed:
            posterior = in_cheaper_form(look.posterior(look.told(looked.innovation, columns), looked.error_scale))
        watch, grown = state.watch.after(looked.verdict, self.trust)
        if grown > 1.0:
            posterior = inflated(posterior, grown)
        # the state's own prior may be an earlier posterior
        prior = rows.times(self.prior.mean.reshape(self.basis.grid.levels.size, -1))
        time_ns = screened.observation.time_ns if looked.believed else state.time_ns
        said = looked.said(screened.said, screened.used, prior, grown)
        evidence = looked.evidence(state.evidence, screened.observation, columns)
        return FilterState(posterior, time_ns, watch, screened.observation, evidence), said

    def _screened(self, observation: Observation | PathMean) -> "_Screened":
        whole = as_profile(observation)
        flags, reasons = screen(whole, self.basis.grid, relative=True)
        used, said = np.flatnonzero(usable(flags)), rejected(whole, flags, reasons)
        if used.size == 0:
            return _Screened(observation, used, said, None, np.empty((0, 2)))
        return _Screened(observation, used, said, *self._rows_of(observation, used))

    def _rows_of(self, observation: Observation | PathMean, used: NDArray[np.intp]) -> tuple[ProfileRows | PathRows, Array]:
        if isinstance(observation, PathMean):
            rows = path_rows(observation, self.basis, self.representation_std)
            return rows, rows.values
        return self.rows(observation, used)

    def usable(self, observation: Observation | PathMean) -> bool:
        """Return whether an observation has a bin that ``step`` would use."""
        return self._screened(observation).rows is not None

    def misfit(self, state: FilterState, observation: Observation | PathMean) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        return self.misfit_of(state.mean, observation)

    def misfit_of(self, mean: Array, observation: Observation | PathMean) -> Array:
        """Return measured minus predicted by weights, shape (Z r,); see ``misfit``."""
        screened = self._screened(observation)
        size = screened.said.depth.size
        if screened.rows is None:
            return np.full((size, 2), np.nan)
        expected = screened.rows.times(mean.reshape(self.basis.grid.levels.size, -1))
        return scatter(size, screened.used, screened.rows.misfit(screened.values, expected))

    def flow(self, state: FilterState) -> FlowEstimate:
        """Return the current estimate that a state stands for; its covariance is computed when first asked for."""
        return self.flow_of(state.mean, cache(state.posterior.covariance), state.time_ns)

    def flow_of(self, mean: Array, covariance: Array | Callable[[tuple[int, ...] | None], Array], time_ns: int | None) -> FlowEstimate:
        """Return the current estimate of weights.

        Args:
            mean: shape (Z r,).
            covariance: shape (Z r, Z r), or what computes that of some levels, None for all.
            time_ns: Of the last observation used [ns, UTC]; None for the forecast's.
        """
        latent = self.basis.offset + self.basis.modes @ mean.reshape(self.basis.grid.levels.size, -1).T
        at = self.time_ns if time_ns is None else time_ns
        flow = FlowEstimate(self.basis.grid, self.basis.kernel, self.basis.depth_functions, latent, self.basis.modes, covariance, at)
        # a static estimate holds at any time as it is
        return replace(flow, later=lambda time_ns: replace(flow, time_ns=time_ns))

    def rows(self, observation: Observation, used: NDArray[np.intp]) -> tuple[ProfileRows, Array]:
        """Return the compressed rows of the usable bins and their velocity about the offset, shape (n, 2), local axes."""
        projection = self.basis.grid.projection
        east, north = to_local(projection, observation.longitude, observation.latitude)
        kernel_row = velocity_kernel(self.basis.kernel, np.array([[east, north]]), self.basis.grid.nodes)
        weights = depth_weights(self.basis.depth_functions, observation.depth[used], self.basis.grid.levels)
        depth, common, correlation = observation.depth[used], observation.common_std, observation.correlation_depth
        if self.error_std is not None:
            noise = bin_noise(depth, np.full(used.size, self.error_std), np.zeros(used.size), 0.0 if np.isfinite(common) else np.inf, 0.0)
        else:
            representation = np.interp(depth, self.basis.grid.levels, self.representation_std)
            noise = bin_noise(depth, observation.error_std[used], representation, common, correlation)
        u, v = rotate_to_local(projection, observation.longitude, observation.latitude, *observation.velocity[used].T)
        values = np.column_stack([u, v]) - weights @ (kernel_row @ self.basis.offset).T
        return compress_profile(weights, kernel_row @ self.basis.modes, noise), values


@dataclass(frozen=True, slots=True, eq=False)
class _Screened:
    """An observation screened.

    Attributes:
        observation: As it came.
        used: shape (n,), its usable bins.
        said: What is said of it when it is not used.
        rows: Of the usable bins; None without any.
        values: shape (n, 2) [m/s], of the usable bins about the offset, local axes.
    """

    observation: Observation | PathMean
    used: NDArray[np.intp]
    said: Innovation
    rows: ProfileRows | PathRows | None
    values: Array


def build_estimator(ensemble: Ensemble, config: EstimatorConfig, trust: TrustConfig | None = None) -> ReducedBasisEstimator:
    """Return the estimator of the configuration's preset for an ensemble.

    Args:
        ensemble: The forecast at one time.
        config: Preset, basis and prior.
        trust: Gate and watch of the default preset; None believes every profile as it is.
    """
    basis = build_basis(ensemble, config)
    if config.preset == "paper":
        return ReducedBasisEstimator(
            basis, diagonal_prior(basis.member_weights), config.paper_error_std, basis.truncation_std, ensemble.time_ns
        )
    representation = basis.truncation_std
    if config.representation_error_std is not None:
        representation = np.full_like(representation, config.representation_error_std)
    members = members_in(basis)
    settings = choose_settings(members, correlation_length(ensemble), config)
    prior = hybrid_prior(members.weights, members.velocity_modes, members.nodes, settings)
    return ReducedBasisEstimator(basis, prior, None, representation, ensemble.time_ns, trust)
