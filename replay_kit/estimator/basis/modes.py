"""From ensemble members to a basis: kernel embedding, singular value decomposition, weights of each member.

Stacked vectors hold all east, then all north components at the N wet nodes of a level; in matrices of slices the levels of a
member are adjacent columns, member after member: column e Z + z.

On a grid that is a product in depth the kernel matrix is K_z (x) K_h, so beta = K_h^-1 F K_z^-T: one symmetric system of 2N instead of 2NZ
unknowns, solved for all members at once by the eigenvectors of K_h. For hat functions K_z at the levels is the identity. With the paper's
l_z = 100 m the Gaussian factor is nearly singular where levels are closer, and sags where they are farther.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import HorizontalFunctions, HorizontalKernel, NodeKernel
from replay_kit.core.flow.lattice import lattice_over
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator.basis.embedding import LEAST_NUGGET, embed
from replay_kit.estimator.basis.shifts import shifted_copies

# The paper's length in cells: 10 km on its cells of 8.6 km.
LENGTH_IN_CELLS = 1.16
# The default's: with the paper's, the field sags between nodes.
DEFAULT_LENGTH_IN_CELLS = 2.0
# Points of a lattice, in all and for each node, beyond which the kernel's columns are cheaper.
_MOST_FUNCTIONS, _MOST_FUNCTIONS_A_NODE = 4096, 16


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Basis flows of a region, and the members in them.

    Attributes:
        grid: The ensemble's grid; its wet top points are the nodes.
        horizontal: The horizontal functions; M of them.
        depth_functions: How levels combine.
        offset: shape (M, Z), latent values of the flow whose weights are zero.
        modes: shape (M, r), latent values of the basis flows, the same at every level.
        singular_values: shape (R,), of all modes, R >= r.
        member_weights: shape (E, Z, r).
        truncation_std: shape (Z,) [m/s], RMS truncation error of the members for each component.
    """

    grid: Grid
    horizontal: HorizontalFunctions
    depth_functions: DepthFunctions
    offset: Array
    modes: Array
    singular_values: Array
    member_weights: Array
    truncation_std: Array

    @property
    def n_modes(self) -> int:
        """Number of modes r for each level."""
        return int(self.modes.shape[1])

    def flow(self, mean: Array, covariance: Array | Callable[[tuple[int, ...] | None], Array], time_ns: int | None) -> FlowEstimate:
        """Return the flow of weights.

        Args:
            mean: shape (Z r,), level after level.
            covariance: shape (Z r, Z r), or a function that computes that of some levels' weights, None for all.
            time_ns: Time it holds for [ns, UTC].
        """
        latent = self.offset + self.modes @ mean.reshape(self.grid.levels.size, -1).T
        return FlowEstimate(self.grid, self.horizontal, self.depth_functions, latent, self.modes, covariance, time_ns)

    def at_place(self, place: Array) -> tuple[Array, Array]:
        """Return the velocity [m/s] at a place of the offset at each level, shape (2, Z), and of each mode, shape (2, r).

        Args:
            place: shape (2,) [m], local east and north.
        """
        offset, modes = (self.horizontal.velocity(place[None], latent)[:, 0] for latent in (self.offset, self.modes))
        return offset, modes

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array:
        """Return a velocity minus its least-squares fit by the basis, shape (P, 2) [m/s].

        Every level has weights of its own, so each depth is fitted alone: exact at the basis's levels, a lower bound elsewhere.

        Args:
            points: shape (P, 2) [m], local east and north.
            depth: shape (P,) [m].
            velocity: shape (P, 2) [m/s], local axes.
        """
        out = np.empty_like(velocity)
        for value in np.unique(depth):
            here = depth == value
            weights = depth_weights(self.depth_functions, np.array([value]), self.grid.levels)[0]
            offset = (self.horizontal.velocity(points[here], self.offset) @ weights).ravel()
            modes = self.horizontal.velocity(points[here], self.modes).reshape(-1, self.n_modes)
            out[here] = fit_residual(modes, velocity[here].T.ravel() - offset).reshape(2, -1).T
        return out

    def representation_std(self, config: EstimatorConfig) -> Array:
        """Return the representation error by level, shape (Z,) [m/s]: the configured one, else that of the truncation."""
        stated = config.representation_error_std
        return self.truncation_std if stated is None else np.full_like(self.truncation_std, stated)


def build_basis(ensemble: Ensemble, config: EstimatorConfig) -> Basis:
    """Return the basis of the configuration's preset."""
    slices = ensemble_slices(ensemble)
    functions = _functions(ensemble, slices, config)
    if config.preset == "paper":
        return _paper_basis(ensemble.grid, slices, functions, DepthFunctions("gaussian", config.length_vertical), config.modes)
    few = bool(ensemble.made_from) and (config.modes is None or (ensemble.n_members - 1) * slices.shape[1] < config.modes)
    shift = (correlation_length(ensemble) if config.shift_distance is None else config.shift_distance) if few else 0.0
    basis = _default_basis(ensemble.grid, slices, functions, config, shift)
    return replace(basis, truncation_std=np.hypot(basis.truncation_std, ensemble.representation_error_std))


def ensemble_slices(ensemble: Ensemble) -> Array:
    """Return the members' velocities at the nodes, shape (E, Z, 2N) [m/s].

    Below the sea floor a column keeps the velocity of its deepest wet level, so that modes have no jump there; the grid's mask
    keeps such points out of every result.
    """
    top = ensemble.grid.wet[0]
    at_nodes = ensemble.velocity[..., top]  # (E, 2, Z, N)
    for z in range(1, at_nodes.shape[2]):
        dry = ~ensemble.grid.wet[z][top]
        at_nodes[:, :, z, dry] = at_nodes[:, :, z - 1, dry]
    return np.moveaxis(at_nodes, 2, 1).reshape(ensemble.n_members, ensemble.grid.levels.size, -1)


def cell_size(grid: Grid) -> tuple[float, float]:
    """Return the median spacing of grid points [m] along its two directions, the one nearer to east-west first."""
    along_i = np.hypot(np.diff(grid.east, axis=1), np.diff(grid.north, axis=1))
    along_j = np.hypot(np.diff(grid.east, axis=0), np.diff(grid.north, axis=0))
    sizes = float(np.median(along_i)), float(np.median(along_j))
    i_is_east = np.median(np.abs(np.diff(grid.east, axis=1))) >= np.median(np.abs(np.diff(grid.north, axis=1)))
    return sizes if i_is_east else sizes[::-1]


def correlation_length(ensemble: Ensemble) -> float:
    """Return the correlation length of the members' anomalies [m]: the standard deviation over that of the gradient.

    That is the scale of the correlation's parabola at zero distance (Daley 1991, Atmospheric Data Analysis, section 4.3), pooled over
    components, levels and both directions of the grid. It is at least one cell, the resolution of the grid.
    """
    grid = ensemble.grid
    anomalies = ensemble.velocity - ensemble.velocity.mean(axis=0)
    variance = float(np.mean(anomalies[..., grid.wet] ** 2))
    slopes = []
    for axis in (0, 1):
        spacing = np.hypot(np.diff(grid.east, axis=axis), np.diff(grid.north, axis=axis))
        both_wet = np.diff(grid.wet.astype(np.int8), axis=axis + 1) == 0
        both_wet &= np.delete(grid.wet, -1, axis=axis + 1)
        slopes.append(np.mean((np.diff(anomalies, axis=axis + 3) / spacing)[..., both_wet] ** 2))
    cell = float(np.sqrt(np.prod(cell_size(grid))))
    slope = float(np.mean(slopes))
    return max(cell, float(np.sqrt(variance / slope))) if slope > 0.0 else cell


def embed_member(ensemble: Ensemble, member: int, config: EstimatorConfig) -> FlowEstimate:
    """Return one member, or a truth, as a flow without uncertainty: hats in depth, the default kernel."""
    slices = ensemble_slices(ensemble)[member]
    functions = _functions(ensemble, slices[None], config.model_copy(update={"preset": "default"}))
    latent = embed(functions, ensemble.grid.nodes, slices.T, config.nugget)
    nothing = np.empty((latent.shape[0], 0)), np.empty((0, 0))
    return FlowEstimate(ensemble.grid, functions, DepthFunctions("hat", config.length_vertical), latent, *nothing, ensemble.time_ns)


def _functions(ensemble: Ensemble, slices: Array, config: EstimatorConfig) -> HorizontalFunctions:
    speed = config.speed or float(np.sqrt(np.mean(slices[:, 0] ** 2)))
    if config.preset == "paper":
        length = config.length_horizontal or 10_000.0
        return NodeKernel(HorizontalKernel(length, length, speed), ensemble.grid.nodes)
    return default_functions(ensemble.grid, config, speed)


def default_functions(grid: Grid, config: EstimatorConfig, speed: float = 1.0) -> HorizontalFunctions:
    """Return the default preset's horizontal functions, which interpolate a velocity from the nodes to other places.

    Args:
        grid: Its cells give the lengths.
        config: May state a length instead.
        speed: Amplitude [m/s].
    """
    if config.length_horizontal is not None:
        lengths = config.length_horizontal, config.length_horizontal
    else:
        east, north = cell_size(grid)
        lengths = DEFAULT_LENGTH_IN_CELLS * east, DEFAULT_LENGTH_IN_CELLS * north
    kernel, nodes = HorizontalKernel(*lengths, speed), grid.nodes
    lattice = lattice_over(kernel, nodes)
    # without a nugget the lattice's equations are singular; of lengths far below a cell it has many points for each node
    exact = config.nugget < LEAST_NUGGET or lattice.size > max(_MOST_FUNCTIONS, _MOST_FUNCTIONS_A_NODE * len(nodes))
    return NodeKernel(kernel, nodes) if exact else lattice


def fit_residual(design: Array, values: Array) -> Array:
    """Return values, shape (n,), minus their least-squares fit by the columns of a design, shape (n, m)."""
    solution = scipy.linalg.lstsq(design, values, cond=1e-10, lapack_driver="gelsd")[0]
    return np.asarray(values - design @ solution)


def _svd(columns: Array, n_modes: int | None) -> tuple[Array, Array]:
    """Return the leading left singular vectors, signs fixed, and all singular values."""
    u, s, _ = scipy.linalg.svd(columns, full_matrices=False, lapack_driver="gesdd")
    largest = np.argmax(np.abs(u), axis=0)
    u = u * np.sign(u[largest, np.arange(u.shape[1])])
    rank = int(np.sum(s > s[0] * 1e-12))
    return u[:, : min(n_modes or rank, rank)], s


def _paper_basis(grid: Grid, slices: Array, functions: HorizontalFunctions, depth_functions: DepthFunctions, n_modes: int | None) -> Basis:
    """The paper's: latents of the product kernel K_z x K_h without a nugget, SVD of all latent slices, weights about zero."""
    n_members, n_levels, size = slices.shape
    kernel_of_depth = depth_weights(depth_functions, grid.levels, grid.levels)
    by_level = np.linalg.solve(kernel_of_depth, slices.transpose(1, 0, 2).reshape(n_levels, -1))
    by_member = np.asarray(by_level, dtype=np.float64).reshape(n_levels, n_members, size)
    latent = embed(functions, grid.nodes, by_member.transpose(1, 0, 2).reshape(-1, size).T, 0.0)  # (2N, E Z)
    modes, singular_values = _svd(latent, n_modes)
    weights = (modes.T @ latent).T.reshape(n_members, n_levels, -1)
    return Basis(grid, functions, depth_functions, np.zeros((size, n_levels)), modes, singular_values, weights, np.zeros(n_levels))


def _default_basis(grid: Grid, slices: Array, functions: HorizontalFunctions, config: EstimatorConfig, shift: float) -> Basis:
    """Hat functions of depth; SVD of the velocity anomalies about the ensemble mean, which is the offset.

    With a ``shift`` above 0 [m], copies of the anomalies shifted by it are among them: a few lagged forecasts span hardly any current but
    their own, and what a basis does not span, the estimate's standard error does not contain.
    """
    n_members, n_levels, size = slices.shape
    mean: Array = slices.mean(axis=0)
    anomalies = (slices - mean).reshape(-1, size).T  # (2N, E Z)
    spanned = shifted_copies(slices - mean, grid.nodes, shift).reshape(-1, size).T if shift > 0.0 else anomalies
    velocity_modes, singular_values = _svd(spanned, config.modes)
    weights = velocity_modes.T @ anomalies
    truncated = (anomalies - velocity_modes @ weights).reshape(size, n_members, n_levels)
    velocities: Array = np.hstack([mean.T, velocity_modes])
    latents = embed(functions, grid.nodes, velocities, config.nugget)
    return Basis(
        grid,
        functions,
        DepthFunctions("hat", config.length_vertical),
        latents[:, :n_levels],
        latents[:, n_levels:],
        singular_values,
        weights.T.reshape(n_members, n_levels, -1),
        np.sqrt(np.mean(truncated**2, axis=(0, 1))),
    )
