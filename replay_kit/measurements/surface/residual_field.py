"""Field of the residuals of radar total vectors from an estimate.

An estimate has no divergence and changes over days; the sea surface has divergence, fronts and tides. Residual components are independent
with covariance s^2 exp(-d / L) at distance d, and errors f times those stated. Earlier times give s, L and f (maximum likelihood), as
stated errors may be of the method and common to hours. For that a measurement keeps its vectors, averaged to small boxes if there are many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import LinearMeasurement

# m, lengths of the field that are tried, errors as shares of its size, and the share of its variance that keeps equal places apart
_LENGTHS, _ERRORS, _NUGGET = np.geomspace(5e3, 80e3, 9), np.geomspace(0.05, 3.0, 7), 1e-6


@dataclass(frozen=True, slots=True)
class ResidualField:
    """Covariance of the residual field.

    Attributes:
        std: s [m/s], standard deviation of a component.
        length: L [m], correlation length.
        error_factor: f, factor on the stated errors of vectors.
    """

    std: float
    length: float
    error_factor: float

    @classmethod
    def likeliest(cls, times: Sequence[tuple[LinearMeasurement, Array]]) -> "ResidualField":
        """Return the maximum-likelihood field of residuals.

        Args:
            times: Total vectors of each time, and their residuals, shape (n, 2) [m/s]; NaN without an estimate.
        """
        seen = [
            (_distances(places, places), errors, residual)
            for places, errors, residual in (_with_residuals(*each) for each in times)
        ]
        number = sum(residual.size for *_, residual in seen)
        usual = float(np.median(np.concatenate([vectors.error_std for vectors, _ in times])))
        best, found = -np.inf, cls(0.0, 0.0, 0.0)
        for length, error in product(_LENGTHS.tolist(), _ERRORS.tolist()):
            unit, square, log_det = cls(1.0, length, error / usual), 0.0, 0.0
            for apart, errors, residual in seen:
                lower = np.linalg.cholesky(unit._covariance(apart, errors))
                white = solve_triangular(lower, residual, lower=True)
                square += float(np.sum(white**2))
                log_det += 4.0 * float(np.log(np.diag(lower)).sum())
            # the field's size is that under which all of it is likeliest
            likelihood = -number * np.log(square / number) - log_det
            if likelihood > best:
                std = float(np.sqrt(square / number))
                best, found = likelihood, cls(std, length, std * unit.error_factor)
        return found

    def between(
        self, seen: LinearMeasurement, residual: Array, longitude: Array, latitude: Array
    ) -> tuple[Array, Array]:
        """Return the field at positions, shape (m, 2) [m/s], and the standard error of a component, shape (m,) [m/s].

        The cost is cubic in the number of vectors.

        Args:
            seen: Total vectors of one time.
            residual: Their residuals, shape (n, 2) [m/s]; NaN without an estimate.
            longitude: shape (m,) [degrees].
            latitude: shape (m,) [degrees].
        """
        places, errors, known = _with_residuals(seen, residual)
        cross = self.std**2 * np.exp(-_distances((longitude, latitude), places) / self.length)
        lower = np.linalg.cholesky(self._covariance(_distances(places, places), errors))
        white, crossed = (
            solve_triangular(lower, each, lower=True, check_finite=False)
            for each in (known, cross.T)
        )
        variance = self.std**2 - np.einsum("nm,nm->m", crossed, crossed)
        return crossed.T @ white, np.sqrt(np.maximum(variance, 0.0))

    def _covariance(self, apart: Array, errors: Array) -> Array:
        """Return the covariance of residuals at distances [m], shape (n, n) [m2/s2], given that of the stated errors."""
        field = np.exp(-apart / self.length) + _NUGGET * np.eye(len(errors))
        return self.std**2 * field + self.error_factor**2 * errors


def _with_residuals(
    seen: LinearMeasurement, residual: Array
) -> tuple[tuple[Array, Array], Array, Array]:
    """Return the positions of vectors with residuals, their error covariance [m2/s2], and the residuals."""
    known = np.flatnonzero(np.isfinite(residual).all(axis=1))
    longitude, latitude = seen.value_places
    return (longitude[known], latitude[known]), seen.covariance(known), residual[known]


def _distances(places: tuple[Array, Array], others: tuple[Array, Array]) -> Array:
    """Return the distances between positions (longitudes, latitudes), shape (m, n) [m]."""
    middle = Projection(float(others[0][0]), float(others[1][0]))
    (x, y), (to_x, to_y) = (to_local(middle, *each) for each in (places, others))
    return np.hypot(x[:, None] - to_x, y[:, None] - to_y)
