"""The mean current of each dive from those before it: a Gaussian process in time, averaged over its settings by the evidence of the past.

A dive's mean current, as the vehicle's flight model gives it, east and north as one complex number, is

    y = mean over the dive's time of c(t) + (alpha + i beta) w + e

with w the way through the water and e an error that no other dive shares. The current c is the sum of four independent parts: one that
changes over a month, one that decorrelates (Matern, 3/2), and damped tides of the principal lunar and the lunisolar diurnal period; all
have one amplitude and one axis along which they are stronger. The mean over a dive, of four instants evenly spread, is what tells tides
from the rest: it damps them by the dive's duration.

Every part is the first component of a Markov process, so that the posterior of n dives takes time in proportion to n (Hartikainen and
Sarkka 2010, MLSP). States are of unit variance; a setting's amplitudes are in its design. Covariances depend on no measured value, and so
are shared by the backgrounds that the current may be measured about. ``tests/reference/mean_currents.py`` has the same as one Gaussian.
"""

from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.filter import INVERTED_STD, DiveMean
from replay_kit.estimator.next_dive.mixtures import Mixture, log_densities

_HOUR, _DAY = 3600.0, 86_400.0
_INSTANTS = 4
# decay times of the slow part and of the tides; periods of these [s]
_SLOW, _TIDES = 30.0 * _DAY, ((8.0 * _DAY, 12.4206 * _HOUR), (12.0 * _DAY, 23.9345 * _HOUR))
# m/s; error of a component that no position and no change of the current causes
_FLOOR = 0.003
# probability that the current has changed from one dive to the next by more than it usually does: by its amplitude
_JUMP = 0.05
_SETTINGS = 512
# latent states of a component: slow 1, decorrelating 2, tides 2 each; then the flight model's error along and across the way
_STATES, _SIZE = 7, 16
_PARTS = (slice(0, 1), slice(1, 3), slice(3, 5), slice(5, 7))


@dataclass(frozen=True, slots=True, eq=False)
class ProcessSettings:
    """Settings of the process, drawn once from what is known before any dive.

    Attributes:
        amplitude: shape (h,) [m/s].
        scale: shape (h,), decorrelation time of the second part [s].
        parts: shape (h, 4), standard deviations of the parts over ``amplitude``.
        white: shape (h,), of what no other dive shares, over ``amplitude``.
        flight: shape (h,), standard deviation of the flight model's error along the way, as a share of it; across it is half.
        axes: shape (h, 2, 2), square root of the covariance of a part of unit variance: along and across its axis.
    """

    amplitude: Array
    scale: Array
    parts: Array
    white: Array
    flight: Array
    axes: Array

    @classmethod
    def drawn(cls, count: int = _SETTINGS) -> "ProcessSettings":
        """Return settings spread evenly over their prior: points of an additive recurrence (Roberts 2018), the same on every machine."""
        # the powers of the root of x^10 = x + 1 fill nine dimensions evenly
        root = 1.0
        for _ in range(60):
            root = (1.0 + root) ** 0.1
        unit = ((np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, 10.0)) + 0.5) % 1.0
        levels = (
            _level(unit[:, 1], (3.0, 8.0, 20.0, 50.0, 120.0, 300.0)) * _HOUR,
            _level(unit[:, 2], (1.0, 2.0)),
            _level(unit[:, 3], (0.0, 0.0, 0.25, 0.5, 1.0)),
            _level(unit[:, 4], (0.0, 0.0, 0.0, 0.3, 0.6)),
            _level(unit[:, 5], (0.03, 0.1, 0.3)),
            _level(unit[:, 6], (0.0, 0.15, 0.5)),
            _level(unit[:, 7], (0.0, 0.5)),
        )
        scale, slow, lunar, diurnal, white, flight, ellipticity = levels
        angle = np.pi * unit[:, 8]
        turn = np.moveaxis(
            np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), 2, 0
        )
        std = np.sqrt(1.0 + ellipticity[:, None] * np.array([1.0, -1.0]))
        return cls(
            0.02 * 12.5 ** unit[:, 0],
            scale,
            np.column_stack([slow, np.ones(count), lunar, diurnal]),
            white,
            flight,
            turn * std[:, None, :],
        )


def _level(unit: Array, levels: tuple[float, ...]) -> Array:
    return np.array(levels)[np.minimum((unit * len(levels)).astype(np.intp), len(levels) - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class ProcessState:
    """What is known after some dives.

    Attributes:
        mean: shape (h, b, 16), of the latent states, under each setting and about each background.
        cov: shape (h, 16, 16).
        log_weights: shape (h, b), of the settings and backgrounds; the weights sum to one.
        time_ns: Last instant of the last dive [ns, UTC]; None before the first.
        dives: Number of dives.
    """

    mean: Array
    cov: Array
    log_weights: Array
    time_ns: int | None = None
    dives: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SeenDive:
    """A dive as a state sees it before its current is used: states at its end, and its mean current.

    Attributes:
        before: The state.
        dive: The dive.
        mean: shape (h, b, 16).
        cov: shape (h, 16, 16).
        expected: shape (h, b, 2) [m/s], without the background.
        cross: shape (h, 16, 2), covariance of the states with the mean current.
        spread: shape (h, 2, 2), covariance of the mean current.
    """

    before: ProcessState
    dive: DiveMean
    mean: Array
    cov: Array
    expected: Array
    cross: Array
    spread: Array


@dataclass(frozen=True, slots=True, eq=False)
class MeanCurrentProcess:
    """The process of dives' mean currents.

    Attributes:
        settings: Those that are averaged.
        n_backgrounds: Number of currents beside zero that a dive's current may be measured about.
    """

    settings: ProcessSettings
    n_backgrounds: int = 0

    @classmethod
    def default(cls, n_backgrounds: int = 0) -> "MeanCurrentProcess":
        """Return the process with so many backgrounds beside none."""
        return cls(ProcessSettings.drawn(), n_backgrounds)

    def initial(self) -> ProcessState:
        """Return the state before the first dive."""
        size, about = self.settings.amplitude.size, self.n_backgrounds + 1
        cov = np.tile(np.eye(_SIZE), (size, 1, 1))
        log_weights = np.full((size, about), -np.log(size * about))
        return ProcessState(np.zeros((size, about, _SIZE)), cov, log_weights)

    def forecast(self, state: ProcessState, dive: DiveMean) -> Mixture:
        """Return what is expected of a dive's mean current.

        Args:
            state: After the dives before.
            dive: Its time, duration, way and backgrounds; its current is not used.
        """
        return self.mixture(self.seen(state, dive))

    def step(self, state: ProcessState, dive: DiveMean) -> ProcessState:
        """Return the state after a dive."""
        return self.after(self.seen(state, dive))

    def mixture(self, seen: SeenDive) -> Mixture:
        """Return what is expected of the mean current of a dive that a state sees."""
        about = self._backgrounds(seen.dive)
        means = (seen.expected + about).reshape(-1, 2)
        spread = np.repeat(seen.spread, about.shape[0], axis=0)
        changed = np.repeat(self._changed(seen.spread), about.shape[0], axis=0)
        weights = seen.before.log_weights.ravel()
        return Mixture(
            np.concatenate([weights + np.log(1.0 - _JUMP), weights + np.log(_JUMP)]),
            np.concatenate([means, means]),
            np.concatenate([spread, changed]),
        )

    def after(self, seen: SeenDive) -> ProcessState:
        """Return the state after the dive that it sees."""
        state, dive = seen.before, seen.dive
        errors = dive.velocity - self._backgrounds(dive) - seen.expected
        after = _updated(seen.mean, seen.cov, seen.cross, seen.spread, errors)
        density = np.logaddexp(
            np.log(1.0 - _JUMP) + _densities(errors, seen.spread),
            np.log(_JUMP) + _densities(errors, self._changed(seen.spread)),
        )
        if dive.inverted is not None:
            # what is left of the mean current without the inverted one is the flight model's error
            design = self._flight_design(dive)
            cross = after[1] @ design.transpose(0, 2, 1)
            spread = design @ cross + (INVERTED_STD**2 + dive.position_variance) * np.eye(2)
            errors = (dive.velocity - dive.inverted) - after[0] @ design.transpose(0, 2, 1)
            after = _updated(*after, cross, spread, errors)
            density = density + _densities(errors, spread)
        log_weights = state.log_weights + density
        instants = _instants(dive)
        return replace(
            state,
            mean=after[0],
            cov=after[1],
            log_weights=log_weights - np.logaddexp.reduce(log_weights, axis=None),
            time_ns=max(instants[-1], state.time_ns or instants[-1]),
            dives=state.dives + 1,
        )

    def _backgrounds(self, dive: DiveMean) -> Array:
        """Return what the current is measured about, shape (b, 2); zero where it is not known."""
        about = np.zeros((self.n_backgrounds + 1, 2))
        known = np.nan_to_num(dive.backgrounds[: self.n_backgrounds])
        about[1 : len(known) + 1] = known
        return about

    def _changed(self, spread: Array) -> Array:
        return np.asarray(spread + self.settings.amplitude[:, None, None] ** 2 * np.eye(2))

    def _flight_design(self, dive: DiveMean) -> Array:
        """Return the effect of the latent states on the mean current through the flight model alone, shape (h, 2, 16)."""
        design = np.zeros((self.settings.amplitude.size, 2, _SIZE))
        east, north = dive.way
        turn = np.array([[east, -0.5 * north], [north, 0.5 * east]])
        design[:, :, 2 * _STATES :] = self.settings.flight[:, None, None] * turn
        return design

    def seen(self, state: ProcessState, dive: DiveMean) -> SeenDive:
        """Return a dive as a state sees it: what a forecast of it and the state after it have in common."""
        settings = self.settings
        instants = _instants(dive)
        before = instants[0] if state.time_ns is None else state.time_ns
        # an instant before the last one known counts as at it
        gaps = np.maximum(np.diff([before, *instants]) * 1e-9, 0.0)
        scales, of_scale = np.unique(settings.scale, return_inverse=True)
        moved, kept, noise = (each[of_scale] for each in _over_dive(gaps, scales))
        # latent states of both components, then the flight model's error, which stays
        move = _both(moved, np.eye(2))
        mean, cov = state.mean @ move.transpose(0, 2, 1), move @ state.cov @ move.transpose(0, 2, 1)
        cov += _both(noise[:, :_STATES, :_STATES], np.zeros((2, 2)))
        amplitude = settings.amplitude[:, None] * settings.parts
        design = self._flight_design(dive)
        of_parts = np.einsum("hp,hpk->hk", amplitude, kept)
        design[:, :, : 2 * _STATES] = np.einsum("hij,hk->hijk", settings.axes, of_parts).reshape(
            -1, 2, 2 * _STATES
        )
        mean_noise = np.einsum("hp,hkp->hk", amplitude, noise[:, :_STATES, _STATES:])
        variance = (
            np.einsum("hp,hpq,hq->h", amplitude, noise[:, _STATES:, _STATES:], amplitude)
            + (settings.amplitude * settings.white) ** 2
        )
        seen = state.cov @ design.transpose(0, 2, 1)
        cross = move @ seen
        cross[:, : 2 * _STATES] += np.einsum("hij,hk->hjki", settings.axes, mean_noise).reshape(
            -1, 2 * _STATES, 2
        )
        along = settings.axes @ settings.axes.transpose(0, 2, 1)
        # a way that is planned, not known, moves the flight model's error by 1 + 1/4 of its variance
        own = dive.position_variance + _FLOOR**2 + 1.25 * (settings.flight * dive.way_std) ** 2
        spread = design @ seen + variance[:, None, None] * along + own[:, None, None] * np.eye(2)
        expected = state.mean @ design.transpose(0, 2, 1)
        return SeenDive(state, dive, mean, cov, expected, cross, spread)


def _instants(dive: DiveMean) -> list[int]:
    """Return the instants that stand for a dive [ns, UTC]."""
    share = (np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5
    return [dive.time_ns + int(each * dive.seconds * 1e9) for each in share]


def _both(block: Array, rest: Array) -> Array:
    """Return the same block for each of two components, and the flight model's, shape (h, 16, 16)."""
    out = np.zeros((len(block), _SIZE, _SIZE))
    out[:, :_STATES, :_STATES] = out[:, _STATES : 2 * _STATES, _STATES : 2 * _STATES] = block
    out[:, 2 * _STATES :, 2 * _STATES :] = rest
    return out


def _over_dive(gaps: Array, scales: Array) -> tuple[Array, Array, Array]:
    """Return how a component's latent states pass a dive, for states of unit variance.

    Args:
        gaps: shape (n,) [s], before each instant of the dive.
        scales: shape (s,) [s], decorrelation times of the second part.

    Returns:
        Transitions, shape (s, 7, 7); effects on the parts' means over the instants, shape (s, 4, 7); covariances of what is new in states
        and means, shape (s, 11, 11).
    """
    size = _STATES + len(_PARTS)
    move, new = np.tile(np.eye(size), (scales.size, 1, 1)), np.zeros((scales.size, size, size))
    through, firsts = move[:, :, :_STATES].copy(), [states.start for states in _PARTS]
    # what is new in a part's first state is new in its mean
    grow = np.eye(size)[:, :_STATES]
    grow[range(_STATES, size), firsts] = 1.0 / len(gaps)
    for gap in gaps:
        step, noise = _transition(gap, scales)
        move[:, :_STATES, :_STATES] = step
        move[:, _STATES:, :_STATES] = step[:, firsts] / len(gaps)
        through = move @ through
        new = move @ new @ move.transpose(0, 2, 1) + grow @ noise @ grow.T
    return through[:, :_STATES], through[:, _STATES:], new


def _transition(gap: float, scales: Array) -> tuple[Array, Array]:
    """Return how a component's latent states pass a time, shape (s, 7, 7), and the covariance of what is new in them."""
    move = np.zeros((scales.size, _STATES, _STATES))
    move[:, 0, 0] = np.exp(-gap / _SLOW)
    # velocity and its rate times the scale over the square root of 3, both of unit variance
    r = np.sqrt(3.0) * gap / scales
    move[:, 1:3, 1:3] = np.moveaxis(np.exp(-r) * np.array([[1.0 + r, r], [-r, 1.0 - r]]), -1, 0)
    for states, (decay, period) in zip(_PARTS[2:], _TIDES, strict=True):
        angle = 2.0 * np.pi * gap / period
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        move[:, states, states] = np.exp(-gap / decay) * turn
    return move, np.eye(_STATES) - move @ move.transpose(0, 2, 1)


def _updated(
    mean: Array, cov: Array, cross: Array, spread: Array, errors: Array
) -> tuple[Array, Array]:
    """Return mean and covariance of the states after errors of a prediction, shape (h, b, 2)."""
    gain = cross @ np.linalg.inv(spread)
    after = cov - gain @ cross.transpose(0, 2, 1)
    # the rounding error of the two halves would grow from dive to dive
    return mean + errors @ gain.transpose(0, 2, 1), 0.5 * (after + after.transpose(0, 2, 1))


def _densities(errors: Array, spread: Array) -> Array:
    """Return the logarithm of the density of errors, shape (h, b, 2), under Gaussians of some covariances, shape (h, 2, 2)."""
    return log_densities(errors, spread[:, None])
