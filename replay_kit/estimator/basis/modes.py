"""Basis of an ensemble: kernel embedding, singular value decomposition and member weights.

Stacked vectors hold all east, then all north components at the N wet nodes of a level; in matrices of slices the levels of a
member are adjacent columns, member after member: column e Z + z.

On a grid that is a product in depth the kernel matrix is K_z (x) K_h, so beta = K_h^-1 F K_z^-T. This symmetric system has 2N instead of
2NZ unknowns; the eigenvectors of K_h solve it for all members at once. For hat functions K_z at the levels is the identity. With
the paper's l_z = 100 m the Gaussian factor is nearly singular where levels are closer, and sags where they are farther.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalFunctions,
    HorizontalKernel,
    NodeKernel,
    depth_weights,
    gradient,
    lattice_over,
)
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator.basis.embedding import LEAST_NUGGET, embed, embedding
from replay_kit.estimator.basis.shifts import shifted_copies, shifted_residual
from replay_kit.estimator.basis.slices import (
    cell_size,
    correlation_length,
    decompose,
    ensemble_slices,
    exact_svd,
    gathered_slices,
    products,
    slice_blocks,
    strongest_functions,
    surface_speed,
)

# The paper's length in cells: 10 km on its cells of 8.6 km.
LENGTH_IN_CELLS = 1.16
# The default's: with the paper's, the field sags between nodes.
DEFAULT_LENGTH_IN_CELLS = 2.0
# Variance of the amplitude of the ensemble mean, whose mean is 1.
_MEAN_VARIANCE = 0.1
# Latent values are the currents times the inverse of the levels' kernel, and their covariance has its condition twice: beyond this number
# float64 keeps no digit of what the levels' independent errors sum up to, and the factors of that covariance do not exist.
_WORST_CONDITION = float(1.0 / np.sqrt(np.finfo(np.float64).eps))
# Vertical functions at least, and slices for each mode, from which modes are found: more of them, weaker ones, change the modes little.
_LEAST_FUNCTIONS, _SLICES_A_MODE = 8, 4
# Points of a lattice, in all and for each node, beyond which the kernel's columns are cheaper.
_MOST_FUNCTIONS, _MOST_FUNCTIONS_A_NODE = 4096, 16


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Basis flows of a region and the members' weights.

    Attributes:
        grid: Grid of the ensemble; its wet points at the first level are the nodes.
        horizontal: Horizontal functions; M of them.
        depth_functions: Vertical functions of the levels.
        offset: Latent values of the flow with zero weights, shape (M, Z).
        modes: Latent values of the basis flows, shape (M, r), equal at every level.
        singular_values: Singular values of all modes, shape (R,), R >= r.
        member_weights: Weights of the members, shape (E, Z, r).
        mean_weights: Weights of the ensemble mean's projection, shape (Z, r); None if its amplitude is certain.
        representation: Representation error at the nodes, shape (Z, N) [m/s]; configured, or estimated from members.
        potential: Latent values of a potential, shape (M, Z), with the divergent part of the ensemble mean as its gradient; None
            if negligible.
    """

    grid: Grid
    horizontal: HorizontalFunctions
    depth_functions: DepthFunctions
    offset: Array
    modes: Array
    singular_values: Array
    member_weights: Array
    representation: Array
    mean_weights: Array | None = None
    potential: Array | None = None

    @property
    def n_modes(self) -> int:
        """Number of modes per level, r."""
        return int(self.modes.shape[1])

    @property
    def at_nodes(self) -> Array:
        """Velocities of the modes at the nodes, shape (2N, r) [m/s per unit weight]."""
        at_nodes = self.horizontal.velocity(self.grid.nodes, self.modes)
        return at_nodes.reshape(-1, self.n_modes)

    def depth_weights(self, depth: Array) -> Array:
        """Return the interpolation weights of the levels at depths [m], shape (n, Z)."""
        return depth_weights(self.depth_functions, depth, self.grid.levels)

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array:
        """Return the residual of velocities fitted by the basis with least squares, shape (P, 2) [m/s].

        Weights differ from level to level, so each depth is fitted separately: exact at the levels, a lower bound elsewhere.

        Args:
            points: Local east and north, shape (P, 2) [m].
            depth: Depths of the points, shape (P,) [m].
            velocity: Velocities on local axes, shape (P, 2) [m/s].
        """
        out = np.empty_like(velocity)
        for value in np.unique(depth):
            here = depth == value
            weights = self.depth_weights(np.array([value]))[0]
            offset = (self.horizontal.velocity(points[here], self.offset) @ weights).ravel()
            modes = self.horizontal.velocity(points[here], self.modes).reshape(-1, self.n_modes)
            out[here] = fit_residual(modes, velocity[here].T.ravel() - offset).reshape(2, -1).T
        return out


def mean_variance(config: EstimatorConfig) -> float:
    """Return the prior variance of the ensemble mean's amplitude: configured, or 0.1, over which a constant estimate averages."""
    return _MEAN_VARIANCE if config.mean_variance is None else config.mean_variance


def build_basis(
    series: Sequence[Ensemble], config: EstimatorConfig, length: float | None = None
) -> Basis:
    """Return the basis of the configuration's preset.

    Args:
        series: Forecast at each time, same members and grid; the paper's preset uses the first.
        config: Preset and basis.
        length: Correlation length of the members [m], if known.

    Raises:
        EstimatorError: The paper's vertical functions are nearly dependent at the levels.
    """
    first = series[0]
    if config.preset == "paper":
        return _paper_basis(first, config)
    spanned = (len(series) * first.n_members - 1) * first.grid.levels.size
    few = bool(first.made_from) if config.modes is None else spanned < config.modes
    apart = config.shift_distance
    if apart is None:
        apart = correlation_length(*series) if length is None else length
    return _default_basis(series, config, apart, apart if few else 0.0)


def embed_member(ensemble: Ensemble, member: int, config: EstimatorConfig) -> FlowEstimate:
    """Return a member, or a truth, as an estimate without uncertainty: hat functions of depth, default kernel."""
    alone = replace(ensemble, velocity=ensemble.velocity[member : member + 1])
    functions = default_functions(ensemble.grid, config, config.speed or surface_speed(alone))
    latent = embed(functions, ensemble.grid.nodes, ensemble_slices(alone)[0].T, config.nugget)
    return FlowEstimate(
        ensemble.grid,
        functions,
        DepthFunctions("hat", config.length_vertical),
        latent,
        np.empty((latent.shape[0], 0)),
        ensemble.time_ns,
    )


def default_functions(
    grid: Grid, config: EstimatorConfig, speed: float = 1.0
) -> HorizontalFunctions:
    """Return the default preset's horizontal functions, which interpolate velocities between nodes.

    Args:
        grid: Grid, whose cell size sets the length.
        config: Settings, which may state a length instead.
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
    exact = config.nugget < LEAST_NUGGET or lattice.size > max(
        _MOST_FUNCTIONS, _MOST_FUNCTIONS_A_NODE * len(nodes)
    )
    return NodeKernel(kernel, nodes) if exact else lattice


def fit_residual(design: Array, values: Array) -> Array:
    """Return the residual of a least-squares fit, shape (n,), of values by the columns of a design matrix, shape (n, m)."""
    solution = scipy.linalg.lstsq(design, values, cond=1e-10, lapack_driver="gelsd")[0]
    return np.asarray(values - design @ solution)


def _paper_basis(ensemble: Ensemble, config: EstimatorConfig) -> Basis:
    """Return the paper's basis: product kernel K_z x K_h without a nugget, SVD of all latent slices, weights about zero."""
    grid, slices = ensemble.grid, ensemble_slices(ensemble)
    length = config.length_horizontal or 10_000.0
    functions = NodeKernel(
        HorizontalKernel(length, length, config.speed or surface_speed(ensemble)), grid.nodes
    )
    depth_functions = DepthFunctions("gaussian", config.length_vertical)
    n_members, n_levels, size = slices.shape
    kernel_of_depth = depth_weights(depth_functions, grid.levels, grid.levels)
    condition = float(np.linalg.cond(kernel_of_depth))
    if not condition < _WORST_CONDITION:
        raise EstimatorError(
            f"preset paper: with l_z = {config.length_vertical:g} m (estimator.length_vertical) the covariance of the levels "
            f"{', '.join(f'{level:g}' for level in grid.levels)} m has the condition {condition:.1e}, expected less than "
            f"{_WORST_CONDITION:.1e}: choose levels farther apart (forecast.levels) or a shorter length"
        )
    by_level = np.asarray(np.linalg.solve(kernel_of_depth, slices), np.float64)
    latent = embed(functions, grid.nodes, by_level.reshape(-1, size).T, 0.0)  # (2N, E Z)
    modes, singular_values = exact_svd(latent, config.modes)
    weights = (modes.T @ latent).T.reshape(n_members, n_levels, -1)
    return Basis(
        grid,
        functions,
        depth_functions,
        np.zeros((size, n_levels)),
        modes,
        singular_values,
        weights,
        np.zeros((n_levels, len(grid.nodes))),
    )


def _n_corners(wet: NDArray[np.bool_]) -> int:
    """Return the number of corners of wet cells, shape (J, I): values of a stream function that affect them."""
    cells = np.pad(wet, 1)
    return int(np.count_nonzero(cells[1:, 1:] | cells[:-1, 1:] | cells[1:, :-1] | cells[:-1, :-1]))


def _default_basis(
    series: Sequence[Ensemble], config: EstimatorConfig, apart: float, shift: float
) -> Basis:
    """Return the default basis: hat functions of depth, SVD of velocity anomalies about the ensemble mean, the offset.

    The decomposition includes the mean, scaled by the standard deviation of its amplitude. So the modes span it like the anomalies,
    and none is spent on it if its amplitude is certain.

    With a ``shift`` above 0 [m] it includes copies of the anomalies shifted by that distance. A few lagged forecasts span hardly any
    other current, and a standard error lacks what the basis does not span. The representation error is that of
    members shifted by ``apart`` [m].
    """
    grid, nodes, n_levels = series[0].grid, series[0].grid.nodes, series[0].grid.levels.size
    functions = default_functions(grid, config, config.speed or surface_speed(*series))
    mean, n_fields = np.empty((n_levels, 2, len(nodes))), len(series) * series[0].n_members
    mean_scale = float(np.sqrt(mean_variance(config) * n_fields))

    def fields() -> Iterator[tuple[slice, Array]]:
        """Yield blocks of nodes with anomalies and the scaled mean, shape (T E + 1, Z, 2, n)."""
        for part, block in slice_blocks(series):
            here = mean[..., part] = block.mean(axis=0)
            yield part, np.concatenate([block - here, mean_scale * here[None]])

    def levels() -> Iterator[tuple[slice, Array]]:
        return ((part, block.reshape(-1, 2, block.shape[3])) for part, block in fields())

    if shift > 0.0:
        whole = gathered_slices(levels, len(nodes)).T
        copies = shifted_copies(whole[None, :-n_levels], nodes, shift).reshape(-1, whole.shape[1])
        both = np.concatenate([copies, whole[-n_levels:]]).reshape(-1, 2, len(nodes))
        # copies, taken node by node, diverge, and modes beyond the number of flows without divergence would be alike
        most = min(config.modes or 2 * len(nodes), _n_corners(grid.wet[0]))
        vectors, values = decompose(lambda: [(slice(None), both)], len(nodes), most)
    else:
        modes = config.modes or n_fields * n_levels
        count = max(_LEAST_FUNCTIONS, -(-_SLICES_A_MODE * modes // n_fields))
        strongest = strongest_functions(fields, count)

        def spanned() -> Iterator[tuple[slice, Array]]:
            for part, block in fields():
                each = strongest @ block.reshape(*block.shape[:2], -1)
                yield part, each.reshape(-1, 2, block.shape[3])

        vectors, values = decompose(spanned, len(nodes), config.modes)
    every = products(levels, vectors)
    given = np.hstack([mean.reshape(n_levels, -1).T, vectors])
    # no second copy of the vectors is to take memory beside the band of a large region
    del vectors
    latents, potential = _embedded(functions, nodes, given, mean, config.nugget)
    velocity_modes = functions.velocity(nodes, latents[:, n_levels:]).reshape(2 * len(nodes), -1)
    missed = shifted_residual(series, mean.reshape(n_levels, -1), velocity_modes, apart)
    error = np.hypot(missed, series[0].representation_error_std)
    if config.representation_error_std is not None:
        error = np.full_like(missed, config.representation_error_std)
    return Basis(
        grid,
        functions,
        DepthFunctions("hat", config.length_vertical),
        latents[:, :n_levels],
        latents[:, n_levels:],
        values,
        every[:-n_levels].reshape(n_fields, n_levels, -1),
        error,
        every[-n_levels:] / mean_scale if mean_scale else None,
        potential,
    )


def _embedded(
    functions: HorizontalFunctions, nodes: Array, given: Array, mean: Array, nugget: float
) -> tuple[Array, Array]:
    """Return the latent values of the ensemble mean and the modes, shape (M, Z + r), and the potential, shape (M, Z); see ``Basis``.

    The factor of a large region takes most of the memory: it is computed once, then released.

    Args:
        functions: Horizontal functions.
        nodes: Positions of the nodes, shape (N, 2) [m].
        given: Velocities of mean and modes, shape (2N, Z + r) [m/s].
        mean: Velocities of the mean, shape (Z, 2, N) [m/s].
        nugget: See ``embedding``.
    """
    latent_of = embedding(functions, nodes, nugget)
    latents = latent_of(given)
    lost = mean.transpose(1, 2, 0) - functions.velocity(nodes, latents[:, : len(mean)])
    # of a stream function whose flow, turned by 90 degrees, is what the embedding loses of the mean
    turned = gradient(gradient(gradient(lost)))
    return latents, latent_of(turned.reshape(2 * len(nodes), -1))
