"""Optional unknowns besides the slow current: oscillations over the region, and systematic errors of an instrument.

**Oscillations** are uniform in the horizontal and linear between knots in depth. An unknown is an amplitude at one reference time; t
seconds later its current is C cos(omega t) + S sin(omega t). An inertial one turns as a vector, clockwise in the north; a tide has an
ellipse, two amplitudes for each component. Their phase is forgotten over a decorrelation time.

**Errors of an instrument** that are not part of the state are absorbed by the current where possible, but a turning vehicle shows the same
error along another direction. They are proportional to the profile's mean velocity relative to the platform: with each bin's own velocity
its noise would look like a scale error. ``heading``: the compass reads too high [rad], which turns the relative velocity clockwise.
``scale``: it is too large by a fraction. ``shear``: an error along the motion through water that grows with the distance from the
instrument (Todd et al. 2017, JTECH 34).

A scale error is special: its effect depends on the observation. With z = (1 + s)(v - p) the density of the logged values has a
factor (1 + s)^-1 for each component of the mean, less the share of the platform velocity's error. That moves the estimate by -P g after
each profile, with g the gradient of the factor's logarithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.flow.local import Oscillation

_NS = 1e9
# rad/s; the Earth's rotation, and the tides of Doodson (1921) as the IHO's list of constituents gives them, degrees an hour
EARTH_ROTATION = 7.292115e-5
_TIDES = {"M2": 28.9841042, "S2": 30.0, "K1": 15.0410686, "O1": 13.9430356}
# Prior of oscillations, round figures of open water that are not fitted: speed of each component [m/s], three days over which the phase is
# forgotten [s], and correlation length in depth [m].
_OSCILLATION_STD, _PHASE_SCALE, _DEPTH_LENGTH = 0.1, 259200.0, 100.0
# Prior standard deviations of errors of the instrument, round figures too: rad, share of the relative velocity, and m/s along
# the way through water for each metre from the instrument (Todd et al. 2017).
_BIAS_STD = {"heading": np.deg2rad(5.0), "scale": 0.05, "shear": 2e-4}
# Knots of an oscillation in each of its depth lengths.
_KNOTS_A_LENGTH = 2
# C and S of a vector that turns clockwise, and of both components of a tide, shape (2, u)
_TURNING = np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]])
_TIDAL = np.eye(4)[::2], np.eye(4)[1::2]
# Factor, digits and unit of an error for people.
_IN_WORDS = {
    "heading": (180.0 / np.pi, 1, "degrees"),
    "scale": (1e2, 1, "%"),
    "shear": (1e3, 2, "mm/s a metre"),
}
# Share of an error's prior standard deviation above which the log has no information on it.
_UNOBSERVED = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Extras:
    """Unknowns: u amplitudes at each of K knots, then b instrument errors.

    Attributes:
        knots: Depths, shape (K,) [m]; empty without oscillations.
        root: Map from unknowns to knots, shape (K, K) [m/s].
        omega: Angular frequencies, shape (u,) [rad/s].
        cosine: Factors C, east and north, shape (2, u).
        sine: Factors S, shape (2, u).
        scale: Decorrelation time of the phase [s].
        names: Names of the instrument errors.
        std: Their prior standard deviations, shape (b,) [rad, 1 or 1/s].
        reference_ns: Time of the amplitudes [ns, UTC].
    """

    knots: Array
    root: Array
    omega: Array
    cosine: Array
    sine: Array
    scale: float
    names: Sequence[str]
    std: Array
    reference_ns: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.omega.size * self.knots.size + self.std.size

    @property
    def tau(self) -> Array:
        """Decorrelation time of each unknown, shape (size,) [s]; inf for constants."""
        return np.repeat([self.scale, np.inf], [self.size - self.std.size, self.std.size])

    def functions(self, depth: Array) -> Array:
        """Return the vertical functions of both components, shape (n, K or K + 2): hats, one, depth below the first bin."""
        errors = np.column_stack([np.ones(depth.size), np.abs(depth - depth[0])])
        return np.hstack([self._hats(depth), errors[:, : 2 * bool(self.names)]])

    def column(self, time_ns: int, relative: Array | None) -> Array:
        """Return the effect of one unit of each unknown on the functions' amplitudes, shape (2, K or K + 2, size).

        Args:
            time_ns: Time of the profile [ns, UTC].
            relative: Mean velocity relative to the platform, local axes, shape (2,) [m/s]; None if not logged.
        """
        n, of_errors = self.knots.size, self.size - self.std.size
        out = np.zeros((2, n + 2 * bool(self.names), self.size))
        (now,), _ = self._turned(np.array([time_ns]))
        out[:, :n, :of_errors] = np.kron(now[:, None], self.root)
        if self.names:
            out[:, n:, of_errors:] = self._errors(relative)
        return out

    def sums(self, weights: Array, depth: Array, times_ns: NDArray[np.int64]) -> Array:
        """Return the effect of one unit of each unknown on weighted sums over points, shape (2, n, size); 0 for instrument errors.

        Args:
            weights: Weights of the points, shape (n, P).
            depth: Depths of the points, shape (P,) [m].
            times_ns: Times of the points, shape (P,) [ns, UTC].
        """
        at_points = self._hats(depth) @ self.root
        rows = np.einsum("np,pcu,pm->cnum", weights, self._turned(times_ns)[0], at_points)
        out = np.zeros((2, len(weights), self.size))
        out[..., : self.size - self.std.size] = rows.reshape(
            2, len(weights), self.size - self.std.size
        )
        return out

    def known(self, x: Array, levels: Array, time_ns: int) -> Oscillation | None:
        """Return the estimated oscillation for later times; None without oscillations.

        Args:
            x: Mean of the unknowns, shape (size,).
            levels: Depths of the levels, shape (Z,) [m].
            time_ns: Time of the mean [ns, UTC].
        """
        if not self.omega.any():
            return None
        amplitude = x[: self.size - self.std.size].reshape(self.omega.size, -1)
        at_levels = amplitude @ (self._hats(levels) @ self.root).T
        # both amplitudes of a pair have one frequency
        cosine, sine = (
            (each[0].T[:, :, None] * at_levels[:, None]).reshape(-1, 2, 2, levels.size).sum(axis=1)
            for each in self._turned(np.array([time_ns]))
        )
        return Oscillation(self.omega[::2], cosine, sine, self.scale, time_ns)

    def remarks(self, mean: Array, std: Array) -> list[str]:
        """Return notes on the estimated instrument errors, and on errors that the log does not constrain.

        Args:
            mean: Mean of their unknowns, shape (b,).
            std: Standard deviation of their unknowns, shape (b,).
        """
        seen = std < _UNOBSERVED
        each = zip(self.names, self.std * mean, self.std * std, strict=True)
        words = [in_words(*one) for one in each]
        found = ", ".join(word for word, is_seen in zip(words, seen, strict=True) if is_seen)
        missing = ", ".join(
            name for name, is_seen in zip(self.names, seen, strict=True) if not is_seen
        )
        notes = [f"systematic errors of the instrument, estimated: {found}"] if found else []
        if missing:
            notes.append(
                f"the log has no information on errors in {missing}: too few profiles state the platform's motion"
            )
        return notes

    def _hats(self, depth: Array) -> Array:
        if not self.knots.size:
            return np.empty((depth.size, 0))
        return depth_weights(DepthFunctions("hat", 1.0), depth, self.knots)

    def _turned(self, times_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the effect of amplitudes at times [ns, UTC], shape (P, 2, u), and a quarter of their period later."""
        angle = np.multiply.outer((times_ns - self.reference_ns) / _NS, self.omega)[:, None]
        cos, sin = np.cos(angle), np.sin(angle)
        return cos * self.cosine + sin * self.sine, cos * self.sine - sin * self.cosine

    def _errors(self, relative: Array | None) -> Array:
        """Return the effect of one prior standard deviation of each error on its two functions, shape (2, 2, b): component by component."""
        east, north = motion = np.zeros(2) if relative is None else relative
        speed = float(np.hypot(*motion))
        # the water moves backwards relative to the platform
        along = -motion / speed if speed > 0.0 else np.zeros(2)
        columns = {
            "heading": [[north, 0.0], [-east, 0.0]],
            "scale": [[east, 0.0], [north, 0.0]],
            "shear": [[0.0, along[0]], [0.0, along[1]]],
        }
        return np.stack([columns[name] for name in self.names], axis=-1) * self.std


def extras_of(config: TimeConfig, latitude: float, deepest: float, reference_ns: int) -> Extras:
    """Return the configured optional unknowns.

    Args:
        config: Names, standard deviations and correlation lengths in depth.
        latitude: Latitude of the region's centre [degrees north], for the inertial frequency.
        deepest: Greatest depth [m].
        reference_ns: See ``Extras``.
    """
    parts = [(np.empty(0), np.empty((2, 0)), np.empty((2, 0)))]
    for name in config.oscillators:
        rate, kind = 2.0 * EARTH_ROTATION * np.sin(np.deg2rad(latitude)), _TURNING
        if name != "inertial":
            rate, kind = np.deg2rad(_TIDES[name]) / 3600.0, _TIDAL
        parts.append((np.full(kind[0].shape[1], rate), *kind))
    omega, cosine, sine = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    n_knots = max(2, int(np.ceil(_KNOTS_A_LENGTH * deepest / _DEPTH_LENGTH)) + 1)
    knots = np.linspace(0.0, deepest, n_knots if config.oscillators else 0)
    correlation = np.exp(-0.5 * ((knots[:, None] - knots) / _DEPTH_LENGTH) ** 2) + 1e-9 * np.eye(
        knots.size
    )
    return Extras(
        knots,
        np.asarray(_OSCILLATION_STD * np.linalg.cholesky(correlation)),
        omega,
        cosine,
        sine,
        _PHASE_SCALE,
        config.biases,
        np.array([_BIAS_STD[name] for name in config.biases], np.float64),
        reference_ns,
    )


def in_words(name: str, estimate: float, std: float) -> str:
    """Return an estimated instrument error as text."""
    factor, digits, unit = _IN_WORDS[name]
    return f"{name} {factor * estimate:+.{digits}f} +- {factor * std:.{digits}f} {unit}"
