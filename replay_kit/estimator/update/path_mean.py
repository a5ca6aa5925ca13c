"""A mean along a path: the exact weighted sum of the basis flows at the path's points."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import PathMean
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.basis.noise import BinNoise
from replay_kit.estimator.update.compression import Bins, ProfileRows
from replay_kit.estimator.update.observation_space import ObservationSpacePosterior
from replay_kit.estimator.update.posterior import Posterior, PredictedObservation
from replay_kit.estimator.update.representation import rows_taken
from replay_kit.estimator.update.screening import local_mean


@dataclass(frozen=True, slots=True, eq=False)
class PathRows(Bins):
    """A mean along a path: one row a component, y = H w + noise of unit variance.

    Attributes:
        design: shape (2, Z, r), H.
    """

    design: Array

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., 2); ``weights`` of shape (..., Z, r)."""
        return np.asarray(np.tensordot(weights, self.design, axes=([-2, -1], [1, 2])))


def mean_noise(mean: PathMean, basis: Basis, places: Array, representation_std: Array) -> BinNoise:
    """Return the noise of a mean along a path, as that of one bin.

    Args:
        mean: The mean.
        basis: Basis flows.
        places: shape (m, 2) [m], local east and north, of the points.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
    """
    by_level = basis.local_error(places, representation_std)
    between = depth_weights(DepthFunctions("hat", 0.0), mean.depth, basis.grid.levels)
    std = float(np.hypot(mean.used_std, mean.weight @ np.sum(between * by_level, axis=1)))
    return BinNoise(np.array([[1.0 / std]]), np.array([[std]]), float(np.log(std)))


def depth_means(mean: PathMean, basis: Basis) -> Array:
    """Return the weight of each level at each point in the mean, shape (m, Z); above and below the levels the nearest level holds."""
    return np.asarray(
        mean.weight[:, None] * depth_weights(basis.depth_functions, mean.depth, basis.grid.levels)
    )


def path_rows(mean: PathMean, basis: Basis, representation_std: Array) -> PathRows:
    """Return the rows of a mean along a path."""
    grid = basis.grid
    places = np.column_stack(to_local(grid.projection, mean.longitude, mean.latitude))
    by_level = depth_means(mean, basis)
    noise = mean_noise(mean, basis, places, representation_std)
    offset = np.einsum("mz,cmz->c", by_level, basis.horizontal.velocity(places, basis.offset))
    design = by_level.T @ basis.horizontal.velocity(places, basis.modes)
    return PathRows(
        np.ones((1, 1)), noise, local_mean(mean, grid.projection) - offset, design / noise.std[0]
    )


def profiles_before_path(rows: Iterable[ProfileRows | PathRows | None]) -> list[ProfileRows]:
    """Return the profiles up to the first mean along a path, after which there is another prior."""
    before = takewhile(lambda each: not isinstance(each, PathRows), rows)
    return [each for each in before if isinstance(each, ProfileRows)]


def predict_path_mean(posterior: Posterior, rows: PathRows) -> PredictedObservation[Posterior]:
    """Return the prediction of a mean along a path; its update gives a prior without rows, as these have no single place."""
    before = rows_taken(posterior)
    cross = before.matvec(rows.design)

    def update(lower: Array, whitened: Array, error_scale: float) -> ObservationSpacePosterior:
        scaled = np.stack([rows.design, cross]).reshape(2, 2, -1) / error_scale
        design, gain = (np.asarray(solve_triangular(lower, each, lower=True)) for each in scaled)
        return before.after_rows(whitened.T @ gain, design, gain)

    cov = rows.matvec(cross)
    mean = rows.matvec(before.mean.reshape(rows.design.shape[1:]))
    return PredictedObservation(
        mean, rows.matvec(before.bias_sensitivity).T, 0.5 * (cov + cov.T), update
    )
