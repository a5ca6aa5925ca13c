"""The least error that an estimator could reach: the least-squares fit of the truth within its span, at the scored points."""

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.horizontal import velocity_kernel
from replay_kit.estimator.baselines.columns import FlowColumns
from replay_kit.estimator.baselines.ensemble_mean import EnsembleMean
from replay_kit.estimator.baselines.etkf import Etkf
from replay_kit.estimator.baselines.naive import Naive3D
from replay_kit.estimator.baselines.nearest import NearestMember
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.filter import ReducedBasisEstimator
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length


def bound(estimator: object, at: ScoredPoints) -> float:
    """Return the least RMSE [m/s] of any flow in the span of an estimator; NaN for one without a fixed span."""
    if isinstance(estimator, ReducedBasisEstimator):
        return _basis_bound(estimator.basis, at)
    if isinstance(estimator, Naive3D):
        return _column_bound(estimator.modes, at, at.velocity)
    if isinstance(estimator, Etkf):
        return _column_bound(estimator.columns(), at, _misfit_of_mean(estimator, at))
    if isinstance(estimator, EnsembleMean):
        return rms_length(_misfit_of_mean(estimator.ensemble, at))
    if isinstance(estimator, NearestMember):
        by_member = estimator.members.velocity(at.points, at.depth) - at.velocity[..., None]
        return float(np.sqrt(np.sum(by_member**2, axis=1).mean(axis=0).min()))
    return float("nan")


def _basis_bound(basis: Basis, at: ScoredPoints) -> float:
    """Return the bound of weights that every level has of its own: each depth is fitted by itself.

    That is exact when the truth has the basis's levels, and a bound of the bound when it has others.
    """
    left = []
    for depth in np.unique(at.depth):
        here = at.depth == depth
        kernel = velocity_kernel(basis.kernel, at.points[here], basis.grid.nodes)
        offset = kernel @ basis.offset @ depth_weights(basis.depth_functions, np.array([depth]), basis.grid.levels)[0]
        left.append(_residual(kernel @ basis.modes, at.velocity[here].T.ravel() - offset).reshape(2, -1).T)
    return rms_length(np.concatenate(left))


def _misfit_of_mean(etkf: Etkf, at: ScoredPoints) -> Array:
    return at.velocity - etkf.flow(etkf.initial()).velocity(*at.place)


def _column_bound(columns: FlowColumns, at: ScoredPoints, misfit: Array) -> float:
    design = columns.velocity(at.points, at.depth)
    return rms_length(_residual(design.reshape(-1, design.shape[-1]), misfit.ravel()).reshape(-1, 2))


def _residual(design: Array, values: Array) -> Array:
    solution = scipy.linalg.lstsq(design, values, cond=1e-10, lapack_driver="gelsd")[0]
    return np.asarray(values - design @ solution)
