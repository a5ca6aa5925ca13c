"""Whole three-dimensional flows as columns: the members themselves, or modes made of them, one coefficient each."""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, HorizontalFunctions, depth_weights
from replay_kit.core.grid import Grid
from replay_kit.estimator.basis.embedding import embed
from replay_kit.estimator.basis.modes import default_functions, fit_residual

HATS = DepthFunctions("hat", 1.0)
_CHUNK = 512  # points at once: bounds the memory of the matrices


@dataclass(frozen=True, slots=True, eq=False)
class FlowColumns:
    """Flows on one grid, hats in depth.

    Attributes:
        grid: Their grid.
        horizontal: The horizontal functions.
        latent: shape (m, Z, M), latent values.
    """

    grid: Grid
    horizontal: HorizontalFunctions
    latent: Array

    def at_place(self, place: Array) -> Array:
        """Return the columns' velocity at the levels under a place, shape (2, Z, m) [m/s].

        Args:
            place: shape (2,) [m], local east and north.
        """
        m, n_levels, size = self.latent.shape
        at_place = self.horizontal.velocity(place[None], self.latent.reshape(-1, size).T)
        return np.asarray(at_place.reshape(2, m, n_levels).transpose(0, 2, 1))

    def velocity(self, points: Array, depth: Array) -> Array:
        """Return the columns' velocity at points, shape (P, 2, m) [m/s].

        Args:
            points: shape (P, 2) [m], local east and north.
            depth: shape (P,) [m].
        """
        m, n_levels, size = self.latent.shape
        out = np.empty((depth.size, 2, m))
        for start in range(0, depth.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            at_levels = self.horizontal.velocity(points[part], self.latent.reshape(-1, size).T)
            weights = depth_weights(HATS, depth[part], self.grid.levels)
            out[part] = np.einsum("cpmz,pz->pcm", at_levels.reshape(2, -1, m, n_levels), weights)
        return out

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array:
        """Return a velocity, shape (P, 2) [m/s], minus its least-squares fit by the columns; the places are those of ``velocity``."""
        design = self.velocity(points, depth)
        return fit_residual(design.reshape(-1, design.shape[-1]), velocity.ravel()).reshape(-1, 2)


def embed_columns(grid: Grid, velocity: Array, config: EstimatorConfig) -> FlowColumns:
    """Return flows with given velocities at the nodes.

    Args:
        grid: Their grid.
        velocity: shape (m, Z, 2N) [m/s].
        config: Length of the default preset's kernel, if it states one, and nugget.
    """
    functions = default_functions(grid, config)
    latent = embed(functions, grid.nodes, velocity.reshape(-1, velocity.shape[-1]).T, config.nugget)
    return FlowColumns(grid, functions, latent.T.reshape(*velocity.shape[:2], -1))


def flow_of_ensemble(
    columns: FlowColumns,
    mean: Array,
    anomalies: Array,
    config: EstimatorConfig,
    time_ns: int | None,
) -> FlowEstimate:
    """Return the flow whose mean and covariance are those of columns of velocities.

    The mean is exact. The covariance is expressed in the anomalies' leading ``config.modes`` slices; the variance of the others is missing.

    Args:
        columns: Flows on the same grid.
        mean: shape (Z, 2N) [m/s], at the nodes.
        anomalies: shape (k, Z, 2N) [m/s], scaled so that the covariance is the sum of their outer products.
        config: Number of modes and nugget.
        time_ns: Time it holds for.
    """
    n_levels, size = mean.shape
    slices = anomalies.reshape(-1, size)
    vectors = np.linalg.eigh(slices.T @ slices)[1][:, ::-1]
    modes = vectors[:, : min(config.modes or size, size, slices.shape[0])]
    weights = (slices @ modes).reshape(anomalies.shape[0], -1)
    latents = embed(
        columns.horizontal,
        columns.grid.nodes,
        np.asarray(np.hstack([mean.T, modes]), dtype=np.float64),
        config.nugget,
    )
    return FlowEstimate(
        columns.grid,
        columns.horizontal,
        HATS,
        latents[:, :n_levels],
        latents[:, n_levels:],
        weights.T @ weights,
        time_ns,
    )


def deterministic_flow(
    columns: FlowColumns, coefficients: Array, time_ns: int | None
) -> FlowEstimate:
    """Return a sum of columns as a flow without uncertainty.

    Args:
        columns: The flows.
        coefficients: shape (m,).
        time_ns: Time it holds for.
    """
    latent = np.tensordot(coefficients, columns.latent, axes=1).T
    return FlowEstimate(
        columns.grid,
        columns.horizontal,
        HATS,
        latent,
        np.empty((latent.shape[0], 0)),
        np.empty((0, 0)),
        time_ns,
    )
