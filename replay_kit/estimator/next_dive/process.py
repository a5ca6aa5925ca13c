"""Prediction of the DAC of each dive from earlier ones: a Gaussian process in time, averaged over settings by their evidence.

A dive's DAC by the vehicle's flight model, east and north as one complex number, is

    y = mean over the dive's time of c(t) + (alpha + i beta) w + e

with w the velocity through water and e an independent error: y is the displacement over the time less w. The current c is the sum of four
independent parts: a monthly one, a Matern-3/2 process, and damped tides of the principal lunar and the lunisolar diurnal period, with a
common amplitude and principal axis. The mean over a dive, of four evenly spaced instants, damps tides by the dive's duration and so
distinguishes them. The inverted current of the dive gives the flight-model error alone. Without a flight model y is the velocity over
ground, and its slow part the velocity through water.

Every part is the first component of a Markov process, so that the posterior of n dives takes time in proportion to n (Hartikainen and
Sarkka 2010, MLSP). States have unit variance; amplitudes are in the design. Covariances do not depend on measured values and are common to
all background currents. ``tests/reference/mean_currents.py`` has the same as one Gaussian.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.mixture import Mixture, log_densities

_HOUR, _DAY = 3600.0, 86_400.0
_INSTANTS = 4
# decay times of the slow part and of the tides; periods of these [s]
_SLOW, _TIDES = 30.0 * _DAY, ((8.0 * _DAY, 12.4206 * _HOUR), (12.0 * _DAY, 23.9345 * _HOUR))
# m/s; error of a component that no position and no change of the current causes
_FLOOR = 0.003
# m/s; of the inverted current beside that of the flight model
_INVERTED_STD = 0.03
# m; how far fixes and way through the water miss together, over the dive's time
_POSITION_STD = 60.0
#: m; how far two fixes alone miss together, over the dive's time.
FIXES_STD = 20.0
# Probability that a dive is not like those before it: the current has changed by more than it usually does, by its amplitude; or, where
# that is asked for, the mean current is wrong, by so much a component [m/s].
_UNLIKE, _WRONG_STD = 0.05, 0.5
_SETTINGS = 512
# root of x^10 = x + 1, whose powers fill nine dimensions evenly
_ROOT = 1.0757660660868371
# levels of the settings, each as probable as it is often here: decorrelation times [h]; the slow part, both tides, what no other dive
# shares, all over the amplitude; the flight model's error, as a share of the way; how much stronger currents are along an axis
_LEVELS = (
    (3.0, 8.0, 20.0, 50.0, 120.0, 300.0),
    (1.0, 2.0),
    (0.0, 0.0, 0.25, 0.5, 1.0),
    (0.0, 0.0, 0.0, 0.3, 0.6),
    (0.03, 0.1, 0.3),
    (0.0, 0.15, 0.5),
    (0.0, 0.5),
)
# Of a component: first states of the parts, slow with one, decorrelating and tides with two each; then its mean over the last dive.
_PARTS, _STATES = (0, 1, 3, 5), 8
# The flight model's error along and across the way, where it is half as large, comes before both components.
_ALONG, _SIZE = np.array([1.0, 0.5]), 2 + 2 * _STATES


@dataclass(frozen=True, slots=True, eq=False)
class DiveMean:
    """DAC of a dive; velocities are towards true east and north [m/s].

    Attributes:
        time_ns: Middle of the dive [ns, UTC].
        seconds: Duration [s].
        way: shape (2,), mean velocity through the water; zero if unknown.
        velocity: shape (2,), DAC, or mean velocity over ground if ``way`` is unknown.
        inverted: shape (2,), path mean of absolute profiles independent of the flight model; None without any.
        backgrounds: shape (k, 2), background currents; NaN if unknown.
        position_std: Combined error of fixes and motion through water over the dive [m].
        way_std: Standard error of each component of ``way`` [m/s]; 0 if known.
    """

    time_ns: int
    seconds: float
    way: Array
    velocity: Array
    inverted: Array | None = None
    backgrounds: Array = field(default_factory=lambda: np.empty((0, 2)))
    position_std: float = _POSITION_STD
    way_std: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ProcessSettings:
    """Settings of the process, drawn once from their prior.

    Attributes:
        amplitude: shape (h,) [m/s], amplitude.
        scale: shape (h,), decorrelation time of the second part [s].
        parts: shape (h, 4), standard deviations of the parts relative to ``amplitude``.
        white: shape (h,), independent error relative to ``amplitude``.
        flight: shape (h,), relative standard deviation of the flight-model error along the motion; half of it across.
        axes: shape (h, 2, 2), square root of the covariance of a part of unit variance, along and across its axis.
    """

    amplitude: Array
    scale: Array
    parts: Array
    white: Array
    flight: Array
    axes: Array

    @classmethod
    def drawn(cls, count: int = _SETTINGS) -> "ProcessSettings":
        """Return settings spread evenly over their prior, from an additive recurrence (Roberts 2018), equal on all machines."""
        unit = (np.arange(1, count + 1) * _ROOT ** -np.arange(1.0, 10.0)[:, None] + 0.5) % 1.0
        scale, slow, lunar, diurnal, white, flight, ellipticity = (
            np.array(levels)[(each * len(levels)).astype(np.intp)]
            for each, levels in zip(unit[1:8], _LEVELS, strict=True)
        )
        cos, sin = np.cos(np.pi * unit[8]), np.sin(np.pi * unit[8])
        major, minor = np.sqrt(1.0 + ellipticity), np.sqrt(1.0 - ellipticity)
        return cls(
            0.02 * 12.5 ** unit[0],
            _HOUR * scale,
            np.column_stack([slow, np.ones(count), lunar, diurnal]),
            white,
            flight,
            np.array([[cos * major, -sin * minor], [sin * major, cos * minor]]).transpose(2, 0, 1),
        )

    @classmethod
    def paired(cls, count: int) -> "ProcessSettings":
        """Return drawn settings, each with every size of the flight model's error: what differs between them is that error alone."""
        drawn, sizes = cls.drawn(count), _LEVELS[5]
        each = {name: np.repeat(getattr(drawn, name), len(sizes), axis=0) for name in cls.__slots__}
        return cls(**each | {"flight": np.tile(sizes, count)})


@dataclass(frozen=True, slots=True, eq=False)
class ProcessState:
    """Posterior after some dives, or with a leading axis after several sets of dives.

    Attributes:
        mean: shape (..., h, 18, b), mean of the states by setting and background.
        cov: shape (..., h, 18, 18), covariance.
        log_weights: shape (..., h, b), log weights of settings and backgrounds; the weights sum to one.
        time_ns: Last instant of the last dive [ns, UTC]; None before the first.
        dives: Number of dives.
    """

    mean: Array
    cov: Array
    log_weights: Array
    time_ns: int | None = None
    dives: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class MeanCurrentProcess:
    """Gaussian process of the DACs of dives.

    Attributes:
        settings: Settings for the average.
        n_backgrounds: Number of background currents in addition to zero.
        outliers: Whether an unusual dive has a wrong DAC instead of a changed current; only without backgrounds.
    """

    settings: ProcessSettings = field(default_factory=ProcessSettings.drawn)
    n_backgrounds: int = 0
    outliers: bool = False

    def initial(self) -> ProcessState:
        """Return the state before the first dive."""
        size, about = self.settings.amplitude.size, self.n_backgrounds + 1
        log_weights = np.full((size, about), -np.log(size * about))
        cov = np.tile(np.eye(_SIZE), (size, 1, 1))
        return ProcessState(np.zeros((size, _SIZE, about)), cov, log_weights)

    def forecast(self, state: ProcessState, dive: DiveMean) -> Mixture:
        """Return the predictive distribution of a dive's DAC.

        Args:
            state: State after earlier dives.
            dive: Dive with time, duration, motion and backgrounds; its current is not used.
        """
        later = self.later(state, dive)
        expected, _, cases = self._expected(later, dive)
        means = expected.swapaxes(-1, -2)
        return Mixture(
            np.concatenate([np.log(share) + later.log_weights.ravel() for share, _ in cases]),
            np.tile(means.reshape(-1, 2), (2, 1)),
            np.concatenate([np.repeat(cov, means.shape[1], axis=0) for _, cov in cases]),
        )

    def later(self, state: ProcessState, dive: DiveMean) -> ProcessState:
        """Return the state at the end of a dive without measurements."""
        settings, shares = self.settings, (np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5
        instants = [dive.time_ns + int(share * dive.seconds * 1e9) for share in shares]
        before = instants[0] if state.time_ns is None else state.time_ns
        # an instant before the last one known counts as at it
        gaps = np.maximum(np.diff([before, *instants]) * 1e-9, 0.0)
        effect, new = _over_dive(gaps, settings.scale, settings.amplitude[:, None] * settings.parts)
        new[:, -1, -1] += (settings.amplitude * settings.white) ** 2
        move = np.tile(np.eye(_SIZE), (len(new), 1, 1))
        move[:, 2:, 2:] = np.kron(np.eye(2), effect)
        cov = move @ state.cov @ move.swapaxes(-1, -2)
        cov[..., 2:, 2:] += np.kron(np.eye(2), new)
        time_ns = max(instants[-1], before)
        return replace(state, mean=move @ state.mean, cov=cov, time_ns=time_ns)

    def step(self, state: ProcessState, dive: DiveMean) -> ProcessState:
        """Return the state after a dive."""
        after = self._updated(self.later(state, dive), dive)
        if dive.inverted is not None:
            after = self._updated(after, dive, dive.inverted)
        total = np.logaddexp.reduce(after.log_weights, axis=(-2, -1), keepdims=True)
        return replace(after, log_weights=after.log_weights - total, dives=state.dives + 1)

    def flight_bias(self, state: ProcessState) -> tuple[Array, Array]:
        """Return mean and standard deviation of the flight-model error along and across the motion, relative to it; shape (2,) each."""
        weights, share = np.exp(state.log_weights[:, 0]), self.settings.flight[:, None] * _ALONG
        means = share * state.mean[:, :2, 0]
        mean = weights @ means
        variances = share**2 * np.einsum("hii->hi", state.cov)[:, :2]
        return mean, np.sqrt(weights @ (variances + (means - mean) ** 2))

    def flight_evidence(self, state: ProcessState) -> Array:
        """Return the log evidence for a flight-model error against none [nats], shape (...)."""
        has = self.settings.flight > 0.0
        of_both = (
            np.logaddexp.reduce(state.log_weights[..., settings, :], axis=(-2, -1))
            - np.log(np.sum(settings))
            for settings in (has, ~has)
        )
        return np.asarray(np.subtract(*of_both))

    def _expected(
        self, state: ProcessState, dive: DiveMean, inverted: Array | None = None
    ) -> tuple[Array, Array, list[tuple[float, Array]]]:
        """Return the prediction of a dive's DAC at its end; with the inverted current, that of the flight-model error.

        Returns:
            Mean, shape (..., h, 2, b); covariance of the states with it, shape (..., h, 18, 2); probability and covariance, shape (..., h,
            2, 2), of a usual and an unusual DAC.
        """
        settings, (east, north) = self.settings, dive.way
        turn = np.array([[east, -north], [north, east]]) * _ALONG
        design = np.zeros((settings.flight.size, 2, _SIZE))
        design[..., :2] = settings.flight[:, None, None] * turn
        if inverted is None:
            design[..., [1 + _STATES, 1 + 2 * _STATES]] = settings.axes
            known = np.nan_to_num(dive.backgrounds[: self.n_backgrounds])
            about, error_std, change = np.vstack([np.zeros(2), known]).T, _FLOOR, settings.amplitude
        else:
            about, error_std, change = inverted[:, None], _INVERTED_STD, np.zeros(1)
        cross = state.cov @ design.swapaxes(-1, -2)
        # a way that is planned, not known, moves the flight model's error by 1 + 1/4 of its variance
        variance = 1.25 * (settings.flight * dive.way_std) ** 2 + error_std**2
        variance += (dive.position_std / dive.seconds) ** 2
        like = design @ cross + variance[:, None, None] * np.eye(2)
        std = _WRONG_STD if self.outliers else change[:, None, None]
        cases = [(1.0 - _UNLIKE, like), (_UNLIKE, like + std**2 * np.eye(2))]
        return design @ state.mean + about, cross, cases

    def _updated(
        self, state: ProcessState, dive: DiveMean, inverted: Array | None = None
    ) -> ProcessState:
        """Return the state after a dive's measurement, with weights not normalised."""
        expected, cross, cases = self._expected(state, dive, inverted)
        errors = dive.velocity[:, None] - expected
        like, unlike = (
            np.log(share) + log_densities(errors.swapaxes(-1, -2), cov[..., None, :, :])
            for share, cov in cases
        )
        density = np.logaddexp(like, unlike)
        # a wrong mean current teaches nothing, a changed one as much as any; both cases are joined to one Gaussian
        share = np.exp(like - density)[..., None] if self.outliers else np.ones(1)
        gain = cross @ np.linalg.inv(cases[0][1])
        move = gain @ errors
        cov = state.cov - share * (gain @ cross.swapaxes(-1, -2))
        cov += share * (1.0 - share) * (move @ move.swapaxes(-1, -2))
        return replace(
            state,
            mean=state.mean + share * move,
            cov=0.5 * (cov + cov.swapaxes(-1, -2)),
            log_weights=state.log_weights + density,
        )


def _over_dive(gaps: Array, scales: Array, amplitudes: Array) -> tuple[Array, Array]:
    """Return the transition of a component's states over a dive, for states of unit variance.

    Args:
        gaps: shape (n,) [s], time before each instant of the dive.
        scales: shape (h,) [s], decorrelation times of the second part.
        amplitudes: shape (h, 4), amplitudes of the parts.

    Returns:
        Transition of the states and of the component's mean over the instants, shape (h, 8, 8); process noise, same shape.
    """
    counted = np.zeros((scales.size, _STATES, _STATES))
    counted[:, -1, _PARTS] = amplitudes / gaps.size
    effect, new = counted + np.diag([*np.ones(_STATES - 1), 0.0]), np.zeros_like(counted)
    # backwards: what is new before an instant is in all later ones
    for gap in gaps[::-1]:
        move = _transition(gap, scales)
        fresh = np.eye(_STATES) - move @ move.swapaxes(-1, -2)
        new += effect @ fresh @ effect.swapaxes(-1, -2)
        effect = effect @ move + counted
    return effect - counted, new


def _transition(gap: float, scales: Array) -> Array:
    """Return the transition of a component's states over a time [s], shape (h, 8, 8)."""
    move = np.zeros((scales.size, _STATES, _STATES))
    move[:, 0, 0] = np.exp(-gap / _SLOW)
    # velocity and its rate times the scale over the square root of 3, both of unit variance
    r = np.sqrt(3.0) * gap / scales
    move[:, 1:3, 1:3] = (np.exp(-r) * np.array([[1.0 + r, r], [-r, 1.0 - r]])).transpose(2, 0, 1)
    for first, (decay, period) in zip(_PARTS[2:], _TIDES, strict=True):
        cos, sin = np.cos(2.0 * np.pi * gap / period), np.sin(2.0 * np.pi * gap / period)
        tide = np.exp(-gap / decay) * np.array([[cos, sin], [-sin, cos]])
        move[:, first : first + 2, first : first + 2] = tide
    return move
