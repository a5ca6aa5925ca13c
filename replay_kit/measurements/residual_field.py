"""What total vectors of radars show beside an estimate, as a field.

An estimate has no divergence and changes over days; a sea surface has divergence, fronts and tides. What is seen beside an estimate is a
field whose components are independent with the covariance s^2 exp(-d / L) between places d apart, and errors of f times those stated.
Times before say which s, L and f (maximum likelihood): stated errors may be those of the method, which hours share. For that a measurement
keeps its vectors, of very many averaged to smaller boxes.
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
    """The field's covariance.

    Attributes:
        std: s [m/s], of a component.
        length: L [m].
        error_factor: f, on the stated errors of vectors.
    """

    std: float
    length: float
    error_factor: float

    @classmethod
    def likeliest(cls, times: Sequence[tuple[LinearMeasurement, Array]]) -> "ResidualField":
        """Return the field under which residuals are likeliest.

        Args:
            times: Total vectors of each time, and what they are beside an estimate, shape (n, 2) [m/s]; NaN where there is none.
        """
        seen = [
            (_apart(places, places), errors, residual)
            for places, errors, residual in (_known(*each) for each in times)
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
        """Return the field at places, shape (m, 2) [m/s], and the standard error of a component of it, shape (m,) [m/s].

        Work grows with the third power of the vectors: 500 take some 0.02 s.

        Args:
            seen: Total vectors of one time.
            residual: What they are beside an estimate, shape (n, 2) [m/s]; NaN where there is none.
            longitude: shape (m,) [degrees].
            latitude: shape (m,) [degrees].
        """
        places, errors, known = _known(seen, residual)
        cross = self.std**2 * np.exp(-_apart((longitude, latitude), places) / self.length)
        lower = np.linalg.cholesky(self._covariance(_apart(places, places), errors))
        white, crossed = (
            solve_triangular(lower, each, lower=True, check_finite=False)
            for each in (known, cross.T)
        )
        variance = self.std**2 - np.einsum("nm,nm->m", crossed, crossed)
        return crossed.T @ white, np.sqrt(np.maximum(variance, 0.0))

    def _covariance(self, apart: Array, errors: Array) -> Array:
        """Return the covariance of residuals so far apart [m], shape (n, n) [m2/s2], by that of the vectors' stated errors."""
        field = np.exp(-apart / self.length) + _NUGGET * np.eye(len(errors))
        return self.std**2 * field + self.error_factor**2 * errors


def _known(seen: LinearMeasurement, residual: Array) -> tuple[tuple[Array, Array], Array, Array]:
    """Return the places of the vectors with a residual, the covariance of their errors [m2/s2], and the residuals."""
    known = np.flatnonzero(np.isfinite(residual).all(axis=1))
    longitude, latitude = seen.value_places
    return (longitude[known], latitude[known]), seen.covariance(known), residual[known]


def _apart(places: tuple[Array, Array], others: tuple[Array, Array]) -> Array:
    """Return the distances between places, longitudes and latitudes, shape (m, n) [m]."""
    middle = Projection(float(others[0][0]), float(others[1][0]))
    (x, y), (to_x, to_y) = (to_local(middle, *each) for each in (places, others))
    return np.hypot(x[:, None] - to_x, y[:, None] - to_y)
