"""Baselines of the paper: the naive 3D basis, and the member nearest to the measurements.

Both have one unknown per three-dimensional flow, where the 2.5D basis has weights per depth slice. The naive basis has the singular vectors
of members with a diagonal prior, so that the estimate stays in the members' span. The nearest member has the least sum of squared
differences from the measurements so far.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.extensions import additions
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement
from replay_kit.estimator.basis.embedding import embed
from replay_kit.estimator.basis.modes import Basis, default_functions
from replay_kit.estimator.basis.slices import ensemble_slices
from replay_kit.estimator.build import independent_process
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.interface import Estimator, Stepped, require_estimator
from replay_kit.estimator.update.columns import Column, Observer
from replay_kit.estimator.update.innovations import misfits
from replay_kit.estimator.update.screening import screened


def naive_3d(ensemble: Ensemble, config: EstimatorConfig) -> ReducedBasisEstimator:
    """Return the naive 3D estimator of an ensemble, with ``config.modes`` modes or one per member.

    Velocities and hats in depth replace the paper's latents and Gaussians, as in the default preset.
    """
    slices = ensemble_slices(ensemble)
    members = slices.reshape(ensemble.n_members, -1)
    vectors, values, _ = scipy.linalg.svd(members.T, full_matrices=False)
    rank = int(np.sum(values > 1e-12 * values[0]))
    vectors = vectors[:, : min(config.modes or rank, rank)]
    weights = members @ vectors
    flows = vectors.T.reshape(-1, *slices.shape[1:])
    return _flow_filter(
        ensemble, flows, (weights.mean(axis=0), weights.var(axis=0, ddof=1)), config
    )


def _flow_filter(
    ensemble: Ensemble, flows: Array, prior: tuple[Array, Array], config: EstimatorConfig
) -> ReducedBasisEstimator:
    """Return the filter with one unknown per whole flow.

    Args:
        ensemble: Ensemble, for grid and time.
        flows: shape (m, Z, 2N) [m/s], at the nodes.
        prior: Mean and variance of the weights, shapes (m,).
        config: Kernel and error model.
    """
    n, n_levels, size = flows.shape
    functions = default_functions(ensemble.grid, config)
    # every slice of every flow is a mode, which one unknown and one level alone have
    latents = embed(functions, ensemble.grid.nodes, flows.reshape(-1, size).T, config.nugget)
    fields, levels = np.ogrid[:n, :n_levels]
    each = np.zeros((n, n_levels, n * n_levels))
    each[fields, levels, fields * n_levels + levels] = 1.0
    mean, variance = prior
    patterns = np.sqrt(variance)[:, None, None] * each
    process = independent_process(ensemble.time_ns, np.tensordot(mean, each, 1), patterns)
    nothing = np.zeros((n_levels, len(ensemble.grid.nodes)))
    error = nothing + (config.representation_error_std or 0.0)
    basis = Basis(
        ensemble.grid,
        functions,
        DepthFunctions("hat", config.length_vertical),
        np.zeros((latents.shape[0], n_levels)),
        latents,
        np.ones(n),
        each,
        error,
    )
    stated = config.paper_error_std if config.preset == "paper" else None
    observer = Observer(basis, process, nothing, stated_std=stated)
    return ReducedBasisEstimator(observer, None, None, ensemble.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class MemberErrors:
    """Distance of each member from the measurements so far.

    Attributes:
        sum_of_squares: shape (E,), squares of measured minus member over the errors.
        time_ns: Time of the last observation used [ns, UTC]; None before the first.
    """

    sum_of_squares: Array
    time_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NearestMember(Estimator[MemberErrors]):
    """Estimator that selects the nearest member; without a measurement, the one nearest to the mean.

    Attributes:
        members: Filter whose unknowns are the members' weights.
        distance: shape (E,), distance of each member from the mean, for the choice before any measurement and between ties.
    """

    members: ReducedBasisEstimator
    distance: Array

    def initial(self) -> MemberErrors:
        """Return the state before any observation."""
        return MemberErrors(np.zeros(self.distance.size))

    def usable(self, observation: Measurement) -> bool:
        """Return whether a measurement has a usable value."""
        ((group,), _) = screened([observation], self.members.grid, relative=False)
        return group.is_used

    def chosen(self, state: MemberErrors) -> Array:
        """Return the weights of the members, shape (E,): one for the nearest, zero for the others."""
        nearest = np.lexsort((self.distance, state.sum_of_squares))[0]
        return np.asarray(np.eye(self.distance.size)[nearest])

    def assimilate(
        self, state: MemberErrors, block: Sequence[Any]
    ) -> tuple[MemberErrors, list[Stepped[MemberErrors]]]:
        """Return the state after measurements, and the outcome of each."""
        found = []
        for event in block:
            (group,), _ = screened([event], self.members.grid, relative=False)
            after, innovation = state, group.unused(0)
            for column in self.members.observer.columns([group]):
                squares = state.sum_of_squares + _squares(column)
                after = MemberErrors(squares, column.time_ns)
                before, now = (
                    misfits(group, column, column.design @ self.chosen(each))
                    for each in (state, after)
                )
                innovation = replace(
                    innovation, innovation=before, residual=now, accepted=True, decision="accepted"
                )
            found.append(Stepped(event, state, after, innovation))
            state = after
        return state, found

    def flow(self, state: MemberErrors) -> FlowEstimate:
        """Return the nearest member."""
        flow = self.members.flow(self.members.initial())
        assert flow.unknowns is not None
        weights = self.members.observer.process.weights(self.chosen(state), 0)
        latent = flow.unknowns.offset + flow.modes @ weights.T
        time_ns = self.members.time_ns if state.time_ns is None else state.time_ns
        return replace(flow.mean_flow(), latent=latent, time_ns=time_ns)


def nearest_member(ensemble: Ensemble, config: EstimatorConfig) -> NearestMember:
    """Return the nearest-member baseline of an ensemble."""
    slices = ensemble_slices(ensemble)
    n = ensemble.n_members
    members = _flow_filter(ensemble, slices, (np.zeros(n), np.ones(n)), config)
    distance = np.sum((slices - slices.mean(axis=0)) ** 2, axis=(1, 2))
    return NearestMember(members, distance)


def _squares(column: Column) -> Array:
    """Return the squares of measured minus each unknown's current over the errors, shape (k,)."""
    total = np.zeros(column.design.shape[1])
    for part in column.parts:
        (y,), (left,), *_ = column.compressed(part)
        total += np.square(y[:, None] - column.rows(part) @ column.design).sum(axis=0) + left
    return total


#: Builders of baselines, by the names of ``--estimator``.
BASELINES: dict[str, Callable[[Ensemble, EstimatorConfig], Estimator[Any]]] = {
    "naive3d": naive_3d,
    "nearest": nearest_member,
}


def build_named(ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the configured baseline or estimator of another package.

    Raises:
        ConfigError: The name is unknown, or its value is no estimator.
    """
    if config.name in BASELINES:
        return BASELINES[config.name](ensemble, config)
    if config.name not in (added := additions("estimators", callable, "a function")):
        known = ", ".join(("reduced_basis", *BASELINES, *added))
        raise ConfigError(f"estimator: expected one of {known}, got '{config.name}'")
    return require_estimator(added[config.name](ensemble, config), f"estimator {config.name}")
