"""A mean along a path: a weighted sum of what is seen at its points, exactly as the basis has it."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.horizontal import velocity_kernel
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import PathMean
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.basis.noise import BinNoise
from replay_kit.estimator.update.dense import DensePrior
from replay_kit.estimator.update.dual import Dual, initial
from replay_kit.estimator.update.forms import folded
from replay_kit.estimator.update.kalman import Bins
from replay_kit.estimator.update.posterior import Look, Posterior
from replay_kit.estimator.update.span import Span


@dataclass(frozen=True, slots=True, eq=False)
class PathRows(Bins):
    """A mean along a path: one row a component, y = H w + noise of unit variance.

    Attributes:
        design: shape (2, Z, r), H.
        values: shape (1, 2) [m/s], measured about the offset, local axes.
    """

    design: Array
    values: Array

    def times(self, weights: Array) -> Array:
        """Return weights seen through H, shape (..., 2); ``weights`` of shape (..., Z, r)."""
        return np.asarray(np.tensordot(weights, self.design, axes=([-2, -1], [1, 2])))


def mean_noise(mean: PathMean, levels: Array, representation_std: Array) -> BinNoise:
    """Return the noise of a mean along a path, as that of one bin.

    Args:
        mean: The mean.
        levels: shape (Z,) [m].
        representation_std: shape (Z,) [m/s], what the basis cannot show, by level.
    """
    std = float(np.hypot(mean.error_std, mean.weight @ np.interp(mean.depth, levels, representation_std)))
    return BinNoise(np.array([[1.0 / std]]), np.array([[std]]), float(np.log(std)))


def local_mean(mean: PathMean, basis: Basis) -> Array:
    """Return the mean along the local axes, shape (1, 2) [m/s], turned where the path ends."""
    u, v = rotate_to_local(basis.grid.projection, float(mean.longitude[-1]), float(mean.latitude[-1]), *mean.velocity)
    return np.array([[float(u), float(v)]])


def depth_means(mean: PathMean, basis: Basis) -> Array:
    """Return what share of the mean each level has at each point, shape (m, Z); above and below the levels the nearest counts."""
    return np.asarray(mean.weight[:, None] * depth_weights(basis.depth_functions, mean.depth, basis.grid.levels))


def path_rows(mean: PathMean, basis: Basis, representation_std: Array) -> PathRows:
    """Return the rows of a mean along a path."""
    grid = basis.grid
    places = np.column_stack(to_local(grid.projection, mean.longitude, mean.latitude))
    kernel_rows = velocity_kernel(basis.kernel, places, grid.nodes).reshape(2, len(places), -1)
    by_level = np.einsum("mz,cmn->czn", depth_means(mean, basis), kernel_rows)
    noise = mean_noise(mean, grid.levels, representation_std)
    offset = np.einsum("czn,nz->c", by_level, basis.offset)
    return PathRows(np.ones((1, 1)), noise, (by_level @ basis.modes) / noise.std[0], local_mean(mean, basis) - offset)


def look_along(posterior: Posterior, rows: PathRows) -> Look[Posterior]:
    """Return what a posterior expects of a mean along a path; it becomes a dense one, as its rows have no one place."""
    assert isinstance(posterior, Dual | Span)
    dense = folded(posterior)
    prior = dense.prior
    assert isinstance(prior, DensePrior)
    cross = prior.times(rows.design)

    def absorb(lower: Array, whitened: Array, error_scale: float) -> Dual:
        gain = np.asarray(np.linalg.solve(lower, cross.reshape(2, -1) / error_scale), dtype=np.float64)
        gained = whitened.T @ gain
        return initial(prior.less(prior.mean + gained[0], gain), dense.prior_answers + gained[1:].reshape(dense.prior_answers.shape))

    cov = rows.times(cross)
    return Look(rows.times(prior.mean.reshape(rows.design.shape[1:])), rows.times(dense.prior_answers).T, 0.5 * (cov + cov.T), absorb)
