"""A current field with its uncertainty: an immutable value that evaluates itself.

A flow is a sum over levels of a depth function times a sum of incompressible horizontal functions h,

    f(x, y, z) = sum_j d_j(z) h(x, y) latent[:, j],

so it is divergence-free in the horizontal wherever it is evaluated. Its uncertainty, when it has one, is a covariance of
weights w of r modes a level: f = h modes w summed over levels in the same way. Estimates, baselines, truths and ensemble
members are all this one value, as ``FlowEstimate``.
"""

# keeps the signatures in help() short: the names of types, not what they stand for
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.covariance import quadratic_form, root_of, sums_for, symmetric
from replay_kit.core.flow.factors import (
    CovarianceFactors,
    FactoredCovariance,
    WeightCovariance,
    covariance_of_sum,
)
from replay_kit.core.flow.functions import DepthFunctions, HorizontalFunctions, depth_weights
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.geodesy import inside_grid, rotate_to_geographic, to_geographic
from replay_kit.core.grid import Grid

# Points evaluated at once: bounds the memory of the kernel matrix to some 10 MB for a thousand nodes.
_CHUNK = 512


@dataclass(frozen=True, eq=False)
class FlowField:
    """A horizontally divergence-free flow in a box, with its uncertainty when known.

    Outside the levels the flow of the nearest level continues; outside the grid's horizontal extent it fades to zero. Below the last
    level and outside the extent nothing is known: there standard errors are NaN, and a dataset (``to_xarray``) has NaN in both.
    Points on land have a value too; ``grid.wet`` is the land mask.

    Attributes:
        grid: Grid, local frame and land mask it was built on; its wet top points are the nodes.
        horizontal: The horizontal functions; M of them.
        depth_functions: How levels combine.
        latent: shape (M, Z), latent values of the flow.
        modes: shape (M, r), latent values of the modes the uncertainty is expressed in; r = 0 without uncertainty.
        covariance: Of the weights, or a function that returns it for some levels' weights, None for all; read ``weight_cov``.
        time_ns: Time it holds for [ns, UTC]; None when unknown.
        later: Makes the estimate for another time [ns, UTC] from it, as ``evolution`` does; None when the flow has no model of time.
        local: Current about the vehicle beside the flow, which no velocity here includes; None where none is known.
        about: Global attributes that datasets of it have beside their own: what its inputs are cited by, who made it.
    """

    grid: Grid
    horizontal: HorizontalFunctions
    depth_functions: DepthFunctions
    latent: Array
    modes: Array
    covariance: WeightCovariance
    time_ns: int | None
    later: Callable[[Self, int], Self] | None = None
    local: LocalCurrent | None = None
    about: Mapping[str, str] = field(default_factory=dict)

    def at(self, time_ns: int) -> Self:
        """Return the estimate for a time [ns, UTC]; where the current changes, its uncertainty grows with time.

        Raises:
            EstimatorError: The flow carries no model of time, as one of a truth or of a baseline.
        """
        self.require_model_of_time()
        assert self.later is not None
        return self.later(self, time_ns)

    def require_model_of_time(self) -> None:
        """Raise EstimatorError when the flow has no model of time, so that ``at`` cannot answer."""
        if self.later is None:
            raise EstimatorError(
                "the flow has no model of time (a truth, a member, a sample, a baseline's estimate, or one saved by an earlier version); "
                "ask the estimate of a replay for another time"
            )

    @property
    def nodes(self) -> Array:
        """Nodes of the grid, shape (N, 2) [m]."""
        return self.grid.nodes

    @property
    def levels(self) -> Array:
        """Levels, shape (Z,) [m]."""
        return self.grid.levels

    @cached_property
    def kept_covariance(self) -> Array | CovarianceFactors:
        """What is saved, pickled and sampled: the covariance's factors where they are fewer numbers than half of it, else the matrix."""
        if not callable(self.covariance):
            return self.covariance
        factors = (
            self.covariance.factors() if isinstance(self.covariance, FactoredCovariance) else None
        )
        return symmetric(self.covariance(None)) if factors is None else factors

    @cached_property
    def weight_cov(self) -> Array:
        """Covariance of the weights, shape (rZ, rZ) [m^2/s^2 of mode amplitude], level after level."""
        kept = self.kept_covariance
        return kept(None) if isinstance(kept, CovarianceFactors) else kept

    @cached_property
    def weight_factor(self) -> Array:
        """A factor F of the covariance of the weights, F F' = ``weight_cov``, shape (rZ, rank): kept, so that further samples are quick.

        Raises:
            EstimatorError: The covariance is not a number.
        """
        return root_of(self.weight_cov)

    def __reduce__(self) -> tuple[type[Self], tuple[object, ...]]:
        """Pickle the covariance or its factors, not the estimator's state from which they would be computed."""
        parts = (
            self.grid,
            self.horizontal,
            self.depth_functions,
            self.latent,
            self.modes,
            self.kept_covariance,
            self.time_ns,
        )
        return type(self), (*parts, None, self.local)

    @property
    def n_modes(self) -> int:
        """Number of modes of the uncertainty; 0 when the flow has none."""
        return int(self.modes.shape[1])

    def velocity(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the velocity [m/s] at points of the local frame.

        Args:
            east: [m], any shape; the three broadcast together.
            north: [m].
            depth: [m], positive down.
            true_axes: Whether the components are towards true east and true north, instead of the local frame's.

        Returns:
            Array of the broadcast shape with one more axis of length 2.
        """
        points, depths, shape = _flatten(east, north, depth)
        out = np.empty((depths.size, 2))
        for places, part, at in _by_place(points):
            by_level = self._components(places, self.latent, true_axes)
            weights = depth_weights(self.depth_functions, depths[part], self.levels)
            out[part] = np.einsum("cpz,pz->pc", by_level[:, at], weights)
        return out.reshape(*shape, 2)

    def standard_error(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the standard deviation [m/s] of each velocity component; arguments and shapes as in ``velocity``.

        It is NaN outside the grid's outline and below the last level, where nothing is known.

        Raises:
            EstimatorError: The flow carries no uncertainty.
        """
        self._require_uncertainty("standard_error")
        points, depths, shape = _flatten(east, north, depth)
        distinct, of_point = np.unique(depths, return_inverse=True)
        covariances, shares = self.covariances(
            depth_weights(self.depth_functions, distinct, self.levels)
        )
        variance = np.empty((depths.size, 2))
        for places, part, at in _by_place(points):
            basis = self._components(places, self.modes, true_axes)
            variance[part] = _variance(covariances, basis, at, shares[of_point[part]])
        variance[~self._known(points, depths)] = np.nan
        return np.sqrt(np.maximum(variance, 0.0)).reshape(*shape, 2)

    def velocity_covariance(
        self, east: ArrayLike, north: ArrayLike, depth: ArrayLike, true_axes: bool = False
    ) -> Array:
        """Return the covariance between the velocities at a few points, shape (2P, 2P) [m^2/s^2], all east then all north.

        For few points it costs a small share of a first ``standard_error``, which prepares for many. NaN where nothing is known.

        Args:
            east: [m], P values; the three broadcast together.
            north: [m].
            depth: [m], positive down.
            true_axes: Whether the components are towards true east and true north, instead of the local frame's.

        Raises:
            EstimatorError: The flow carries no uncertainty.
        """
        self._require_uncertainty("velocity_covariance")
        points, depths, _ = _flatten(east, north, depth)
        weights = depth_weights(self.depth_functions, depths, self.levels)
        basis = self._components(points, self.modes, true_axes)
        design = (weights[None, :, :, None] * basis[:, :, None]).reshape(
            2 * len(points), self.levels.size, self.n_modes
        )
        if isinstance(self.covariance, FactoredCovariance) and "weight_cov" not in vars(self):
            covariance = self.covariance.of_combinations(design)
        else:
            flat = design.reshape(len(design), -1)
            covariance = flat @ self.weight_cov @ flat.T
        unknown = np.tile(~self._known(points, depths), 2)
        covariance[unknown] = covariance[:, unknown] = np.nan
        return covariance

    def sample(self, n: int, seed: int) -> tuple[Self, ...]:
        """Return n flows drawn from the estimate's Gaussian; the same seed gives the same flows.

        Raises:
            EstimatorError: The flow carries no uncertainty.
        """
        self._require_uncertainty("sample")
        if isinstance(self.kept_covariance, CovarianceFactors):
            by_level = self.kept_covariance.draws(n, seed)
        else:
            factor = self.weight_factor
            draws = factor @ np.random.default_rng(seed).standard_normal((factor.shape[1], n))
            by_level = draws.T.reshape(n, self.levels.size, self.n_modes)
        mean_flow = self.mean_flow()
        return tuple(
            replace(mean_flow, latent=self.latent + self.modes @ weights.T) for weights in by_level
        )

    def mean_flow(self) -> Self:
        """Return the mean alone: the same flow without uncertainty, model of time and local current."""
        return replace(
            self, modes=self.modes[:, :0], covariance=np.empty((0, 0)), later=None, local=None
        )

    def _components(self, places: Array, latent: Array, true_axes: bool) -> Array:
        """Return the two components, shape (2, M, k), at places, shape (M, 2), of flows with latent values, shape (size, k)."""
        rows = self.horizontal.velocity(places, latent)
        if not true_axes:
            return rows
        longitude, latitude = to_geographic(self.grid.projection, *places.T)
        return np.stack(
            rotate_to_geographic(self.grid.projection, longitude[:, None], latitude[:, None], *rows)
        )

    def covariances(self, weights: Array) -> tuple[list[Array], Array]:
        """Return covariances of the modes' amplitudes, shape (r, r), and the share of each in that at each depth, shape (D, T).

        Covariances of single levels and of sums of two cost a small share of the whole one, unless that is known already, or most pairs
        of levels are needed.

        Args:
            weights: shape (D, Z), of each level at each depth.
        """
        sums, shares = sums_for(weights)
        whole = (
            not callable(self.covariance)
            or "weight_cov" in vars(self)
            or len(sums) > 2 * self.levels.size
        )
        source = self.weight_cov if whole else self.covariance
        parts = [covariance_of_sum(source, levels, self.n_modes) for levels in sums]
        if len(weights) > len(sums):
            return parts, shares
        return [
            np.asarray(sum(share * part for share, part in zip(row, parts, strict=True) if share))
            for row in shares
        ], np.eye(len(weights))

    def _known(self, points: Array, depths: Array) -> NDArray[np.bool_]:
        return np.asarray(inside_grid(self.grid, *points.T) & (depths <= self.levels[-1]))

    def _require_uncertainty(self, what: str) -> None:
        if self.n_modes == 0:
            raise EstimatorError(
                f"{what} needs an estimate with a covariance, but this flow (a truth, a member or a sample) carries none"
            )


def _variance(
    covariances: Sequence[Array], basis: Array, at: NDArray[np.intp], shares: Array
) -> Array:
    """Return diag(H P H'), shape (P, 2).

    Args:
        covariances: Of the modes' amplitudes, shape (r, r).
        basis: shape (2, M, r), the modes at the places.
        at: shape (P,), each point's place: one quadratic form serves all points over it.
        shares: shape (P, T), of each covariance at each point.
    """
    out = np.zeros((len(shares), 2))
    for covariance, share in zip(covariances, shares.T, strict=True):
        touched = np.flatnonzero(share)
        if touched.size:
            places, of_point = np.unique(at[touched], return_inverse=True)
            for component in range(2):
                out[touched, component] += (
                    share[touched] * quadratic_form(basis[component, places], covariance)[of_point]
                )
    return out


def _flatten(
    east: ArrayLike, north: ArrayLike, depth: ArrayLike
) -> tuple[Array, Array, tuple[int, ...]]:
    e, n, d = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (east, north, depth)))
    return np.column_stack([e.ravel(), n.ravel()]), d.ravel(), d.shape


def _chunks(size: int) -> Iterator[slice]:
    for start in range(0, size, _CHUNK):
        yield slice(start, min(start + _CHUNK, size))


def _by_place(points: Array) -> Iterator[tuple[Array, NDArray[np.intp], NDArray[np.intp]]]:
    """Yield some places, shape (M, 2), the positions of the points that lie there, and which of the places each lies at.

    On a grid, and along a profile, many points lie over one place: what depends on the place alone is computed once.
    """
    east_north, at = np.unique(points[:, 0] + 1j * points[:, 1], return_inverse=True)
    order = np.argsort(at, kind="stable")
    for part in _chunks(east_north.size):
        first, last = np.searchsorted(at, [part.start, part.stop], sorter=order)
        points_here = order[first:last]
        places = east_north[part]
        yield np.column_stack([places.real, places.imag]), points_here, at[points_here] - part.start
