"""Corrections to an estimate's slow field: local correction near a vehicle, surface correction from radars, regional oscillations.

The local correction holds unresolved currents: tides, inertial motion, fronts between forecast points. It does not depend on depth and is
an Ornstein-Uhlenbeck process along the vehicle's track: its mean decays with time, and its variance grows to that of the process. Several
processes are averaged by their probabilities, one of them without a correction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array, Mask


@dataclass(frozen=True, slots=True, eq=False)
class LocalCurrent:
    """Local correction of an estimate from the dives so far, local east and north.

    Attributes:
        probability: shape (h,), probability of each process, sum 1.
        std: shape (h,) [m/s], stationary standard deviation of a component; 0 for the process without a correction.
        scale: shape (h,) [s], decorrelation time.
        mean: shape (h, 2) [m/s], at ``time_ns``.
        cov: shape (h, 2, 2) [m^2/s^2], at ``time_ns``.
        time_ns: Time of the last dive [ns, UTC].
    """

    probability: Array
    std: Array
    scale: Array
    mean: Array
    cov: Array
    time_ns: int

    def at(self, time_ns: int) -> "LocalCurrent":
        """Return the correction for a time [ns, UTC]; a time before the last dive counts as that dive's."""
        time_ns = max(time_ns, self.time_ns)
        kept = np.exp(-(time_ns - self.time_ns) / 1e9 / self.scale)[:, None]
        fresh = ((1.0 - kept**2) * self.std[:, None] ** 2)[..., None] * np.eye(2)
        cov = kept[..., None] ** 2 * self.cov + fresh
        return replace(self, mean=kept * self.mean, cov=cov, time_ns=time_ns)

    def velocity(self, time_ns: int) -> Array:
        """Return the expected velocity at a time [ns, UTC], shape (2,) [m/s]."""
        return np.asarray(self.probability @ self.at(time_ns).mean)

    def standard_error(self, time_ns: int) -> float:
        """Return the standard error of a component at a time [ns, UTC], mean of both [m/s]."""
        now = self.at(time_ns)
        about = now.mean - self.probability @ now.mean
        each = np.trace(now.cov, axis1=1, axis2=2) + np.sum(about**2, axis=1)
        return float(np.sqrt(self.probability @ each / 2.0))

    def sample(self, times_ns: Sequence[int], n: int, seed: int) -> Array:
        """Return n random time series of the velocity, shape (n, T, 2) [m/s].

        Args:
            times_ns: shape (T,), in order [ns, UTC]; times before the last dive count as that dive's.
            n: Number of series.
            seed: Seed of the random numbers.
        """
        rng, times = np.random.default_rng([seed, 1]), np.maximum(times_ns, self.time_ns)
        first = self.at(int(times[0]))
        which = rng.choice(len(self.probability), n, p=self.probability)
        values, vectors = np.linalg.eigh(first.cov)
        roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[which]
        drawn = [first.mean[which] + np.einsum("nij,nj->ni", roots, rng.standard_normal((n, 2)))]
        scale, std = self.scale[which, None], self.std[which, None]
        for seconds in np.diff(times) / 1e9:
            noise = std * np.sqrt(-np.expm1(-2.0 * seconds / scale)) * rng.standard_normal((n, 2))
            drawn.append(np.exp(-seconds / scale) * drawn[-1] + noise)
        return np.stack(drawn, axis=1)


# Radars' hours are averages: their field is that of the time so far from it [ns].
_HOUR_NS = 3_600 * 10**9


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCurrent:
    """Surface correction of an estimate from radars, on the cells of a grid, linear between them.

    Attributes:
        east: shape (I,) [m], cell centres in the local frame.
        north: shape (J,) [m].
        velocity: shape (J, I, 2) [m/s], local axes, at ``time_ns``.
        error: shape (J, I) [m/s], standard error of a component.
        std: Standard deviation of a component without radar data [m/s].
        depth: Greatest depth of the correction [m].
        time_ns: Time of the radar vectors [ns, UTC].
    """

    east: Array
    north: Array
    velocity: Array
    error: Array
    std: float
    depth: float
    time_ns: int

    def at(self, time_ns: int) -> "SurfaceCurrent":
        """Return the correction for a time [ns, UTC]; more than an hour from the vectors it is 0 with standard deviation ``std``."""
        if abs(time_ns - self.time_ns) <= _HOUR_NS:
            return self
        unknown = np.full_like(self.error, np.nan)
        return replace(self, velocity=np.zeros_like(self.velocity), error=unknown)

    def between(self, places: Array, depth: Array) -> Array:
        """Return the velocity, shape (n, 2) [m/s], local axes; 0 below ``depth`` and off the grid.

        Args:
            places: shape (n, 2) [m], local east and north.
            depth: shape (n,) [m].
        """
        here, found = self._holds(places, depth), np.zeros((len(places), 2))
        found[here] = self._interpolated(self.velocity, places[here])
        return found

    def variance(self, of_flow: Array, places: Array, depth: Array) -> Array:
        """Return the variance of estimate plus correction, shape (n, 2) [m^2/s^2]: near radar vectors that of the correction alone.

        Args:
            of_flow: shape (n, 2) [m^2/s^2], variance of the estimate.
            places: shape (n, 2) [m], local east and north.
            depth: shape (n,) [m].
        """
        here, found = self._holds(places, depth), of_flow.copy()
        error = self._interpolated(self.error[..., None], places[here])
        found[here] = np.where(np.isnan(error), of_flow[here] + self.std**2, error**2)
        return found

    def _holds(self, places: Array, depth: Array) -> Mask:
        low, high = (np.array([self.east[end], self.north[end]]) for end in (0, -1))
        # degrees and back move a place by less than that
        inside = ((places >= low - 0.01) & (places <= high + 0.01)).all(axis=1)
        return np.asarray(inside & (depth <= self.depth))

    def _interpolated(self, values: Array, places: Array) -> Array:
        """Return values, shape (J, I, c), interpolated linearly at positions, shape (n, c)."""
        cells, shares = [], []
        for axis, at in zip((self.east, self.north), places.T, strict=True):
            cells.append(np.clip(np.searchsorted(axis, at, "right") - 1, 0, axis.size - 2))
            shares.append(
                ((at - axis[cells[-1]]) / (axis[cells[-1] + 1] - axis[cells[-1]]))[:, None]
            )
        (i, j), (x, y) = cells, shares
        south = (1.0 - x) * values[j, i] + x * values[j, i + 1]
        north = (1.0 - x) * values[j + 1, i] + x * values[j + 1, i + 1]
        return np.asarray((1.0 - y) * south + y * north)


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """Currents v(s) = sum_q exp(-s / tau) [C_q cos(omega_q s) + S_q sin(omega_q s)], s seconds after a time.

    Attributes:
        omega: shape (q,) [rad/s].
        cosine: shape (q, 2, Z) [m/s], C: local east and north at the levels.
        sine: shape (q, 2, Z) [m/s], S.
        scale: tau, e-folding time of the amplitude [s].
        time_ns: Time at which s is zero [ns, UTC].
    """

    omega: Array
    cosine: Array
    sine: Array
    scale: float
    time_ns: int

    def velocity(self, time_ns: int) -> Array:
        """Return the velocity of all oscillations at a time [ns, UTC], shape (2, Z) [m/s]; without decay before ``time_ns``."""
        seconds = (time_ns - self.time_ns) / 1e9
        phase = self.omega * seconds
        turned = np.tensordot(np.cos(phase), self.cosine, 1) + np.tensordot(
            np.sin(phase), self.sine, 1
        )
        return np.asarray(np.exp(-max(seconds, 0.0) / self.scale) * turned)

    @property
    def shortest_period(self) -> float:
        """Shortest period [s]."""
        return 2.0 * np.pi / float(np.max(np.abs(self.omega)))
