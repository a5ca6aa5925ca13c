"""The estimator: a frozen problem, a frozen state, and one step that online and offline use share."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from replay_kit.config import EstimatorConfig
from replay_kit.estimator.dual import initial
from replay_kit.estimator.fit import choose_settings, members_in
from replay_kit.estimator.forms import in_cheaper_form
from replay_kit.estimator.kalman import ProfileRows, compress_profile, dependence_inflation
from replay_kit.estimator.modes import Basis, build_basis, correlation_length
from replay_kit.estimator.posterior import Ahead, Posterior, means
from replay_kit.estimator.prior import Prior, diagonal_prior, hybrid_prior
from replay_kit.estimator.screening import rejected, scatter, screen, usable
from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import rotate_to_local, to_local
from replay_kit.kernels.depth import depth_weights
from replay_kit.kernels.horizontal import velocity_kernel
from replay_kit.types import Array, Ensemble, Innovation, Observation

# Observations whose products with the prior covariance are computed together when they are known: one reading of it for all.
BLOCK = 16


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """What is known of the weights at one time.

    Attributes:
        posterior: Of the weights, in the form that is cheaper at the time.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    posterior: Posterior
    time_ns: int | None

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
    """

    basis: Basis
    prior: Prior
    error_std: float | None
    representation_std: Array
    time_ns: int | None

    def initial(self) -> FilterState:
        """Return the prior as a state."""
        return FilterState(initial(self.prior, self.basis.grid.levels.size), None)

    def step(self, state: FilterState, observation: Observation) -> tuple[FilterState, Innovation]:
        """Return the state after an observation, and the innovation.

        An observation without a usable bin leaves the state untouched.
        """
        return next(self.steps(state, [observation]))

    def steps(self, state: FilterState, observations: Iterable[Observation]) -> Iterator[tuple[FilterState, Innovation]]:
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
                if screened.profile is not None:
                    if made_by is None or type(made_by) is not type(state.posterior) or made_by.prior is not state.posterior.prior:
                        made_by = state.posterior
                        ahead = iter(made_by.ahead([later.profile[0] for later in block[index:] if later.profile is not None]))
                    state, innovation = self._step(state, screened, *screened.profile, next(ahead))
                yield state, innovation

    def _step(
        self, state: FilterState, screened: "_Screened", rows: ProfileRows, values: Array, ahead: Ahead
    ) -> tuple[FilterState, Innovation]:
        observation, used = screened.observation, screened.used
        look = state.posterior.look(rows, ahead)
        innovation = values - rows.expand(look.mean)
        compressed, left_out = rows.compress(innovation)
        posterior, mean = look.posterior(compressed, 1.0)
        inflation = 1.0
        if self.error_std is None and used.size > 1:
            inflation = dependence_inflation((values - rows.expand(mean)) / rows.error_std[:, None])
            if inflation > 1.0:
                posterior, mean = look.posterior(compressed, np.sqrt(inflation))
        # the state's own prior may be an earlier posterior
        unmeasured = rows.times(self.prior.mean.reshape(self.basis.grid.levels.size, -1))
        variance = rows.expand_variance(look.cov) + np.square(rows.error_std)[:, None]
        said = replace(
            screened.said,
            innovation=scatter(observation.depth.size, used, innovation),
            innovation_std=scatter(observation.depth.size, used, np.sqrt(variance)),
            residual=scatter(observation.depth.size, used, values - rows.expand(mean)),
            prior_innovation=scatter(observation.depth.size, used, values - rows.expand(unmeasured)),
            nis=look.nis(compressed) + left_out,
            dof=2 * used.size,
            accepted=True,
            error_inflation=inflation,
        )
        return FilterState(in_cheaper_form(posterior), observation.time_ns), said

    def _screened(self, observation: Observation) -> "_Screened":
        flags, reasons = screen(observation, self.basis.grid)
        used = np.flatnonzero(usable(flags))
        return _Screened(observation, used, rejected(observation, flags, reasons), self.rows(observation, used) if used.size else None)

    def usable(self, observation: Observation) -> bool:
        """Return whether an observation has a bin that ``step`` would use."""
        flags, _ = screen(observation, self.basis.grid)
        return bool(np.any(usable(flags)))

    def misfit(self, state: FilterState, observation: Observation) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        return self.misfit_of(state.mean, observation)

    def misfit_of(self, mean: Array, observation: Observation) -> Array:
        """Return measured minus predicted by weights, shape (Z r,); see ``misfit``."""
        flags, _ = screen(observation, self.basis.grid)
        used = np.flatnonzero(usable(flags))
        out = np.full((observation.depth.size, 2), np.nan)
        if used.size:
            rows, values = self.rows(observation, used)
            out[used] = values - rows.expand(rows.times(mean.reshape(self.basis.grid.levels.size, -1)))
        return out

    def flow(self, state: FilterState) -> FlowEstimate:
        """Return the current estimate that a state stands for; its covariance is computed when first asked for."""
        return self.flow_of(state.mean, state.posterior.covariance, state.time_ns)

    def flow_of(self, mean: Array, covariance: Array | Callable[[], Array], time_ns: int | None) -> FlowEstimate:
        """Return the current estimate of weights.

        Args:
            mean: shape (Z r,).
            covariance: shape (Z r, Z r), or what computes it.
            time_ns: Of the last observation used [ns, UTC]; None for the forecast's.
        """
        latent = self.basis.offset + self.basis.modes @ mean.reshape(self.basis.grid.levels.size, -1).T
        at = self.time_ns if time_ns is None else time_ns
        return FlowEstimate(self.basis.grid, self.basis.kernel, self.basis.depth_functions, latent, self.basis.modes, covariance, at)

    def rows(self, observation: Observation, used: NDArray[np.intp]) -> tuple[ProfileRows, Array]:
        """Return the compressed rows of the usable bins and their velocity about the offset, shape (n, 2), local axes."""
        projection = self.basis.grid.projection
        east, north = to_local(projection, observation.longitude, observation.latitude)
        kernel_row = velocity_kernel(self.basis.kernel, np.array([[east, north]]), self.basis.grid.nodes)
        weights = depth_weights(self.basis.depth_functions, observation.depth[used], self.basis.grid.levels)
        own = np.hypot(observation.error_std[used], observation.common_std)
        if self.error_std is not None:
            error_std = np.full(used.size, self.error_std)
        else:
            representation = np.interp(observation.depth[used], self.basis.grid.levels, self.representation_std)
            error_std = np.hypot(own, representation)
        u, v = rotate_to_local(projection, observation.longitude, observation.latitude, *observation.velocity[used].T)
        values = np.column_stack([u, v]) - weights @ (kernel_row @ self.basis.offset).T
        return compress_profile(weights, kernel_row @ self.basis.modes, error_std), values


@dataclass(frozen=True, slots=True, eq=False)
class _Screened:
    """An observation screened.

    Attributes:
        observation: As it came.
        used: shape (n,), its usable bins.
        said: What is said of it when it is not used.
        profile: Its rows, and its values about the offset; None without usable bins.
    """

    observation: Observation
    used: NDArray[np.intp]
    said: Innovation
    profile: tuple[ProfileRows, Array] | None


def build_estimator(ensemble: Ensemble, config: EstimatorConfig) -> ReducedBasisEstimator:
    """Return the estimator of the configuration's preset for an ensemble."""
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
    return ReducedBasisEstimator(basis, prior, None, representation, ensemble.time_ns)
