"""Measurements as rows of unit noise: the bins' errors, lossless compression of a profile, means along a path.

**Errors.** Each component of a profile errs with covariance N, the same for both:

    N_ij = s_i s_j exp(-|z_i - z_j| / L) + e_i^2 [i = j] + c^2,

with s the instrument's own errors, correlated along the profile over L, e the representation error of the basis, and c the error of the
platform's velocity, which all bins share. A platform of unknown velocity is the limit c -> inf: the profile is then known up to a
constant, and each component loses one degree of freedom. That is the same as estimating the platform's velocity with a flat prior beside
the weights and then taking the marginal of the weights.

**Compression** of a profile to at most 2 Z independent rows. All bins of a profile lie under one point, so its design is a product: H = D
(bins x Z) times G (2 x r), one row for each bin and component. Whitening by the bins' errors, W, and a QR factorisation W D = Q R leave
rows R G that hold all the bins' information on the weights; the component orthogonal to Q is pure noise and enters the normalised
innovation squared only.

**A mean along a path** is the exact weighted sum of the basis flows at the path's points.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.update.screening import local_values

# Between levels the representation error is linear; above and below them that of the nearest holds.
_LINEAR = DepthFunctions("hat", 0.0)
# Share of the largest row of R below which a row is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class BinNoise:
    """The whitening of a profile's bins, and its inverse.

    Attributes:
        whiten: shape (m, n) [s/m]; m = n, or n - 1 where the platform's velocity is not known.
        unwhiten: shape (n, m) [m/s]; after ``whiten`` it restores a profile, without its constant part where that is not known.
        log_scale: Half the logarithm of the determinant of N, without the shared error where that is infinite.
    """

    whiten: Array
    unwhiten: Array
    log_scale: float

    @property
    def std(self) -> Array:
        """Standard deviation of each bin's error [m/s], shape (n,); about the profile's own mean where only that is known."""
        return np.asarray(np.sqrt(np.einsum("nm,nm->n", self.unwhiten, self.unwhiten)))

    @property
    def half_log_det(self) -> float:
        """Half the log-determinant of one component's error covariance: of all bins, or of their differences where only these are known."""
        known, bins = self.whiten.shape
        return (
            self.log_scale
            if known == bins
            else float(np.linalg.slogdet(np.diff(self.unwhiten, axis=0))[1])
        )


def bin_noise(covariance: Array, relative: bool) -> BinNoise:
    """Return the noise of a measurement's values; see the module.

    Args:
        covariance: shape (n, n) [m^2/s^2], of one component, without the shared error where that is infinite.
        relative: Whether it is infinite.
    """
    lower = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    whiten = np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True))
    log_scale = float(np.log(np.diag(lower)).sum())
    if not relative:
        return BinNoise(whiten, lower, log_scale)
    complement = _orthogonal_complement(whiten.sum(axis=1))
    return BinNoise(complement.T @ whiten, lower @ complement, log_scale)


def measurement_noise(
    observation: LinearMeasurement,
    used: NDArray[np.intp],
    basis: Basis,
    representation_std: Array,
    places: Array,
) -> BinNoise:
    """Return the noise of a measurement's usable values.

    Args:
        observation: The measurement.
        used: Positions of its usable values.
        basis: Basis flows.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
        places: shape (P, 2) or (1, 2) [m], local east and north, of the representation error.
    """
    between = depth_weights(_LINEAR, observation.depth, basis.grid.levels)
    extra = np.sum(between * basis.local_error(places, representation_std), axis=1)
    if observation.weights is not None:
        extra = observation.weights @ extra
    covariance = observation.covariance(used)
    covariance[np.diag_indices_from(covariance)] += extra[used] ** 2
    return bin_noise(covariance, observation.reference == "relative")


def _orthogonal_complement(vector: Array) -> Array:
    """Return an orthonormal basis, shape (n, n - 1), of the complement of a vector: the other columns of its Householder reflection."""
    reflector = vector / np.linalg.norm(vector)
    reflector[0] += np.copysign(1.0, reflector[0])
    return np.eye(vector.size)[:, 1:] - np.outer(reflector, reflector[1:]) * (
        2.0 / (reflector @ reflector)
    )


def compress(noise: BinNoise, functions: Array) -> tuple[Array, Array]:
    """Return orthonormal columns Q, shape (m, k), and R, shape (k, q), with Q R the whitened functions.

    Differences between values do not determine all functions of depth: what is left of a constant is rounding, and makes no row.

    Args:
        noise: Of n values, of which m combinations are known.
        functions: shape (n, q), at the values.
    """
    q, r = np.linalg.qr(noise.whiten @ functions)
    known, bins = noise.whiten.shape
    size = np.abs(r).max(axis=1)
    kept = size > _ROUNDING * size.max(initial=0.0) if known < bins else np.ones(len(r), np.bool_)
    return (q, r) if kept.all() or not kept.any() else (q[:, kept], r[kept])


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A profile's bins and the k rows for each component into which they are compressed.

    Attributes:
        q: shape (m, k), orthonormal columns.
        noise: Error of the n bins, of which m combinations are known.
        values: shape (n, c) [m/s], measured about the estimator's reference current.
        components: shape (c, 2), of the local axes, that are measured.
    """

    q: Array
    noise: BinNoise
    values: Array
    components: Array

    @property
    def dof(self) -> int:
        """Number of independent measured values in all components."""
        return len(self.components) * len(self.q)

    @property
    def half_log_det(self) -> float:
        """Half the log-determinant of the error covariance of all components."""
        return len(self.components) * self.noise.half_log_det

    def ones(self) -> Array:
        """Return the rows of a velocity of one in all bins, shape (k,)."""
        return np.asarray(self.q.T @ self.noise.whiten.sum(axis=1))

    def compress(self, values: Array) -> tuple[Array, float]:
        """Return the rows of bin values, shape (c k,), and the squared norm of the compression residual.

        Args:
            values: shape (n, c) [m/s].
        """
        whitened = self.noise.whiten @ values
        rows = self.q.T @ whitened
        return rows.T.ravel(), max(float(np.sum(whitened**2) - np.sum(rows**2)), 0.0)

    def whitened_residual(self, rows: Array) -> Array:
        """Return measured minus predicted bins in units of their error, shape (m, c); ``rows``, shape (c k,), are the predicted rows."""
        by_component = rows.reshape(len(self.components), -1)
        return np.asarray(self.noise.whiten @ self.values - self.q @ by_component.T)

    def residual(self, rows: Array) -> Array:
        """Return measured minus predicted bins along the local axes, shape (n, 2) [m/s]; see ``whitened_residual``."""
        return np.asarray(self.noise.unwhiten @ self.whitened_residual(rows) @ self.components)

    def expand_variance(self, cov: Array, noise: float = 0.0) -> Array:
        """Return the variance of the bins along the local axes, shape (n, 2) [m^2/s^2].

        Args:
            cov: shape (c k, c k), covariance of the rows.
            noise: Multiple of the bins' error variance to add.
        """
        k = self.q.shape[1]
        bins = self.noise.unwhiten @ self.q
        by_component = [
            np.einsum("nk,kl,nl->n", bins, cov[start : start + k, start : start + k], bins)
            for start in range(0, len(cov), k)
        ]
        variance = np.column_stack(by_component)
        if noise:
            variance += noise * np.square(self.noise.std)[:, None]
        return np.asarray(variance @ self.components**2)


@dataclass(frozen=True, slots=True, eq=False)
class ProfileRows(Bins):
    """A profile compressed: y = H w + noise of unit variance, with k = min(m, Z) rows a component.

    Attributes:
        r: shape (k, Z), the whitened depth factor.
        basis: shape (c, r), the modes' velocity at the point along each component.
    """

    r: Array
    basis: Array

    at_one_place: ClassVar[Literal[True]] = True

    def design(self) -> Array:
        """Return H, shape (c k, Z r), component after component."""
        rows: Array = np.einsum("kz,cm->ckzm", self.r, self.basis)
        return rows.reshape(len(self.basis) * len(self.r), -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., c k); ``weights`` of shape (..., Z, r)."""
        rows: Array = self.r @ (weights @ self.basis.T)  # (..., k, c)
        return np.swapaxes(rows, -1, -2).reshape(*weights.shape[:-2], -1)


def dependence_inflation(residual: Array, size: NDArray[np.intp]) -> Array:
    """Return the factors by which correlated errors inflate the error variance of profiles' bins, shape (n,), at least 1.

    Bins smoothed by an inversion, or affected by structure that the basis cannot represent, leave residuals that are correlated
    along the profile; treated as independent they would count many times over. For a first-order autoregressive error of
    lag-one correlation rho the mean of n bins has (1 + rho) / (1 - rho) times the variance of n independent ones. The
    residuals' own mean square is applied too when it is above one. Below three standard errors of rho the factor is 1.

    Args:
        residual: shape (n, m, 2), measured minus estimated over the bins' error, neighbours in depth next to each other; 0 beyond
            the last bin.
        size: shape (n,), number of values, of both components.
    """
    square = np.sum(residual**2, axis=(1, 2))
    product = np.sum(residual[:, 1:] * residual[:, :-1], axis=(1, 2))
    rho = np.divide(product, square, out=np.zeros_like(square), where=square > 0.0)
    rho = np.where((rho > 3.0 / np.sqrt(size)) & (size > 2), rho, 0.0)
    return np.where(rho > 0.0, (1.0 + rho) / (1.0 - rho) * np.maximum(1.0, square / size), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class PathRows(Bins):
    """Sums over several places: y = H w + noise of unit variance, one row for each value that is known.

    Attributes:
        by_level: shape (c k, Z, r), H.
    """

    by_level: Array

    at_one_place: ClassVar[Literal[False]] = False

    def design(self) -> Array:
        """Return H, shape (c k, Z r)."""
        return self.by_level.reshape(len(self.by_level), -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., c k); ``weights`` of shape (..., Z, r)."""
        return np.asarray(np.tensordot(weights, self.by_level, axes=([-2, -1], [1, 2])))


#: Rows of a measurement, in one of two forms.
Rows = ProfileRows | PathRows


def places_of(observation: LinearMeasurement, projection: Projection) -> Array:
    """Return the places of a measurement's points, shape (P, 2) or (1, 2) [m], local east and north."""
    return np.column_stack(to_local(projection, observation.longitude, observation.latitude))


def measurement_rows(
    observation: LinearMeasurement, used: NDArray[np.intp], basis: Basis, noise: BinNoise
) -> Rows:
    """Return the rows of a measurement's usable values, compressed where all of them lie at one place.

    Args:
        observation: The measurement.
        used: Positions of its usable values.
        basis: Basis flows.
        noise: Of these values, the same for each component.
    """
    projection = basis.grid.projection
    values, components = local_values(observation, used, projection)
    at_points, weights = basis.depth_weights(observation.depth), observation.weights
    if observation.at_one_place:
        at_values = at_points[used] if weights is None else weights[used] @ at_points
        offset, modes = basis.at_place(places_of(observation, projection)[0])
        q, r = compress(noise, at_values)
        about = values - at_values @ offset.T @ components.T
        return ProfileRows(q, noise, about, components, r, components @ modes)
    assert weights is not None, "each value is a sum over places"
    places = places_of(observation, projection)
    at_levels = weights[used, :, None] * at_points  # (n, P, Z)
    offsets = basis.horizontal.velocity(places, basis.offset)
    known = np.einsum("npz,dpz,cd->nc", at_levels, offsets, components)
    modes = basis.horizontal.velocity(places, basis.modes)  # (2, P, r)
    of_values = np.stack([each.T @ modes for each in at_levels])  # (n, 2, Z, r)
    design = np.einsum("kn,cd,ndzr->ckzr", noise.whiten, components, of_values, optimize=True)
    by_level = design.reshape(-1, *design.shape[2:])
    return PathRows(np.eye(len(noise.whiten)), noise, values - known, components, by_level)
