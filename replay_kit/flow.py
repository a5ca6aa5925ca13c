"""The current estimate as one frozen value: what a planner or an analyst holds.

A flow is a sum over levels of a depth function times an incompressible horizontal kernel field,

    f(x, y, z) = sum_j d_j(z) K((x, y), nodes) latent[:, j],

so it is divergence-free in the horizontal wherever it is evaluated. Its uncertainty, when it has one, is a covariance of
weights w of r modes a level: f = K modes w summed over levels in the same way. Estimates, baselines, truths and ensemble
members are all this one value.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.errors import EstimatorError
from replay_kit.geodesy import inside_grid
from replay_kit.kernels.depth import DepthFunctions, depth_weights
from replay_kit.kernels.horizontal import HorizontalKernel, stream_function_kernel, velocity_kernel
from replay_kit.types import Array, Grid

if TYPE_CHECKING:
    import xarray as xr

# Points evaluated at once: bounds the memory of the kernel matrix to some 10 MB for a thousand nodes.
_CHUNK = 512


@dataclass(frozen=True, slots=True, eq=False)
class FlowEstimate:
    """A horizontally divergence-free flow in a box, with its uncertainty when known.

    Outside the levels the flow of the nearest level holds; outside the grid's horizontal extent the kernel fades to zero and
    nothing is known. Points on land get a value too: ask ``grid.wet``.

    Attributes:
        grid: Grid, local frame and land mask it was built on; its wet top points are the kernel's nodes.
        kernel: Horizontal kernel.
        depth_functions: How levels combine.
        latent: shape (2N, Z), latent velocities of the flow, all east then all north.
        modes: shape (2N, r), latent velocities of the modes the uncertainty is expressed in; r = 0 without uncertainty.
        weight_cov: shape (rZ, rZ) [m^2/s^2 of mode amplitude], covariance of the weights, level after level.
        time_ns: Time it holds for [ns, UTC]; None when unknown.
    """

    grid: Grid
    kernel: HorizontalKernel
    depth_functions: DepthFunctions
    latent: Array
    modes: Array
    weight_cov: Array
    time_ns: int | None

    @property
    def nodes(self) -> Array:
        """Kernel nodes, shape (N, 2) [m]."""
        return self.grid.nodes

    @property
    def levels(self) -> Array:
        """Levels, shape (Z,) [m]."""
        return self.grid.levels

    @property
    def n_modes(self) -> int:
        """Number of modes of the uncertainty; 0 when the flow has none."""
        return int(self.modes.shape[1])

    def velocity(self, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Array:
        """Return the velocity [m/s], local east and north, at points of the local frame.

        Args:
            east: [m], any shape; the three broadcast together.
            north: [m].
            depth: [m], positive down.

        Returns:
            Array of the broadcast shape with one more axis of length 2.
        """
        points, depths, shape = _flatten(east, north, depth)
        out = np.empty((depths.size, 2))
        for part in _chunks(depths.size):
            out[part] = self._contract(points[part], depths[part], self.latent)
        return out.reshape(*shape, 2)

    def stream_function(self, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Array:
        """Return psi [m^2/s] with u = dpsi/dy, v = -dpsi/dx, at points of the local frame; shapes as in ``velocity``."""
        points, depths, shape = _flatten(east, north, depth)
        out = np.empty(depths.size)
        for part in _chunks(depths.size):
            by_level = stream_function_kernel(self.kernel, points[part], self.nodes) @ self.latent
            out[part] = np.sum(by_level * depth_weights(self.depth_functions, depths[part], self.levels), axis=1)
        return out.reshape(shape)

    def standard_error(self, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> Array:
        """Return the standard deviation [m/s] of each velocity component; shapes as in ``velocity``.

        It is NaN outside the grid's outline and below the last level, where nothing is known.

        Raises:
            EstimatorError: The flow carries no uncertainty.
        """
        self._require_uncertainty("standard_error")
        points, depths, shape = _flatten(east, north, depth)
        variance = np.empty((depths.size, 2))
        for part in _chunks(depths.size):
            basis = (velocity_kernel(self.kernel, points[part], self.nodes) @ self.modes).reshape(2, -1, self.n_modes)
            weights = depth_weights(self.depth_functions, depths[part], self.levels)
            variance[part] = self._variance(basis, weights)
            known = inside_grid(self.grid, *points[part].T) & (depths[part] <= self.levels[-1])
            variance[part][~known] = np.nan
        return np.sqrt(np.maximum(variance, 0.0)).reshape(*shape, 2)

    def sample(self, n: int, seed: int) -> tuple["FlowEstimate", ...]:
        """Return n flows drawn from the Gaussian that the estimate stands for; the same seed gives the same flows.

        Raises:
            EstimatorError: The flow carries no uncertainty.
        """
        self._require_uncertainty("sample")
        values, vectors = np.linalg.eigh(self.weight_cov)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = factor @ np.random.default_rng(seed).standard_normal((values.size, n))
        by_level = draws.T.reshape(n, self.levels.size, self.n_modes)
        certain = replace(self, modes=np.empty((self.modes.shape[0], 0)), weight_cov=np.empty((0, 0)))
        return tuple(replace(certain, latent=self.latent + self.modes @ weights.T) for weights in by_level)

    def to_xarray(
        self, longitude: ArrayLike | None = None, latitude: ArrayLike | None = None, depth: ArrayLike | None = None
    ) -> "xr.Dataset":
        """Return velocity and standard error on a grid as a CF dataset; see ``replay_kit.flow_netcdf.to_dataset``."""
        from replay_kit.flow_netcdf import to_dataset

        return to_dataset(self, longitude, latitude, depth)

    def save(self, path: str | Path) -> None:
        """Write the flow to NetCDF without loss; ``replay_kit.flow_netcdf.load`` reads it back."""
        from replay_kit.flow_netcdf import save

        save(self, Path(path))

    def _contract(self, points: Array, depths: Array, latent: Array) -> Array:
        by_level = velocity_kernel(self.kernel, points, self.nodes) @ latent
        weights = depth_weights(self.depth_functions, depths, self.levels)
        return np.asarray(np.sum(by_level.reshape(2, depths.size, -1) * weights, axis=2).T)

    def _variance(self, basis: Array, weights: Array) -> Array:
        """Return diag(H P H'), shape (P, 2): pairs of levels in turn, because a hat meets only its neighbours."""
        out = np.zeros((weights.shape[0], 2))
        r = self.n_modes
        for j in range(self.levels.size):
            for k in range(j + 1):
                both = weights[:, j] * weights[:, k] * (1.0 if j == k else 2.0)
                touched = np.flatnonzero(both)
                if touched.size:
                    block = self.weight_cov[j * r : (j + 1) * r, k * r : (k + 1) * r]
                    for component in range(2):
                        rows = basis[component, touched]
                        out[touched, component] += both[touched] * np.einsum("pr,pr->p", rows @ block, rows)
        return out

    def _require_uncertainty(self, what: str) -> None:
        if self.n_modes == 0:
            raise EstimatorError(f"{what} needs an estimate with a covariance, but this flow (a truth, a member or a sample) carries none")


def _flatten(east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    e, n, d = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (east, north, depth)))
    return np.column_stack([e.ravel(), n.ravel()]), d.ravel(), d.shape


def _chunks(size: int) -> Iterator[slice]:
    for start in range(0, size, _CHUNK):
        yield slice(start, min(start + _CHUNK, size))
