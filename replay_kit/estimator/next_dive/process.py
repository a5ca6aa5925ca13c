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
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.filter import (
    INVERTED_STD,
    DiveMean,
    grown,
    inverse_of,
    with_own,
)
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
        mean: shape (b, 16, h), of the latent states, about each background and under each setting.
        cov: shape (16, 16, h).
        log_weights: shape (b, h), of the backgrounds and settings; the weights sum to one.
        time_ns: Last instant of the last dive [ns, UTC]; None before the first.
        dives: Number of dives.
    """

    mean: Array
    cov: Array
    log_weights: Array
    time_ns: int | None = None
    dives: int = 0


class SeenDive(NamedTuple):
    """A dive as a state sees it before its current is used: states at its end, and its mean current.

    Attributes:
        before: The state.
        dive: The dive.
        mean: shape (b, 16, h).
        cov: shape (16, 16, h).
        expected: shape (2, b, h) [m/s], without the background.
        cross: shape (2, 16, h), covariance of the mean current with the states.
        spread: shape (2, 2, h), covariance of the mean current.
    """

    before: ProcessState
    dive: DiveMean
    mean: Array
    cov: Array
    expected: Array
    cross: Array
    spread: Array


# Not slotted: what the settings are in every dive is computed once.
@dataclass(frozen=True, eq=False)
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

    @cached_property
    def _shared(self) -> tuple[Array, Array, Array, NDArray[np.intp]]:
        """Amplitudes of the parts, shape (4, h); ``axes``, shape (2, 2, h); each scale once, and which of them each setting has."""
        amplitude, axes = self.settings.amplitude * self.settings.parts.T, self.settings.axes
        scales, of_scale = np.unique(self.settings.scale, return_inverse=True)
        return amplitude, np.ascontiguousarray(np.moveaxis(axes, 0, -1)), scales, of_scale

    def initial(self) -> ProcessState:
        """Return the state before the first dive."""
        size, about = self.settings.amplitude.size, self.n_backgrounds + 1
        cov = np.repeat(np.eye(_SIZE)[..., None], size, axis=-1)
        log_weights = np.full((about, size), -np.log(size * about))
        return ProcessState(np.zeros((about, _SIZE, size)), cov, log_weights)

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
        means = (seen.expected + self._backgrounds(seen.dive)).reshape(2, -1)
        weights, each = seen.before.log_weights.ravel(), self.n_backgrounds + 1
        covs = np.tile(seen.spread, each), np.tile(self._changed(seen.spread), each)
        return Mixture(
            np.concatenate([weights + np.log(1.0 - _JUMP), weights + np.log(_JUMP)]),
            np.tile(means, 2),
            np.concatenate(covs, axis=-1),
        )

    def after(self, seen: SeenDive) -> ProcessState:
        """Return the state after the dive that it sees."""
        state, dive = seen.before, seen.dive
        errors = dive.velocity[:, None, None] - self._backgrounds(dive) - seen.expected
        after = _updated((seen.mean, seen.cov), seen.cross, seen.spread, errors)
        density = np.logaddexp(
            np.log(1.0 - _JUMP) + log_densities(errors, seen.spread[:, :, None]),
            np.log(_JUMP) + log_densities(errors, self._changed(seen.spread)[:, :, None]),
        )
        if dive.inverted is not None:
            # what is left of the mean current without the inverted one is the flight model's error
            design = self._flight_design(dive)
            cross, expected = _products(design, *after)
            spread = np.einsum("ikh,jkh->ijh", design, cross)
            spread = with_own(spread, INVERTED_STD**2 + dive.position_variance)
            errors = (dive.velocity - dive.inverted)[:, None, None] - expected
            after = _updated(after, cross, spread, errors)
            density = density + log_densities(errors, spread[:, :, None])
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
        """Return what the current is measured about, shape (2, b, 1); zero where it is not known."""
        about = np.zeros((self.n_backgrounds + 1, 2))
        known = np.nan_to_num(dive.backgrounds[: self.n_backgrounds])
        about[1 : len(known) + 1] = known
        return about.T[..., None]

    def _changed(self, spread: Array) -> Array:
        return with_own(spread, self.settings.amplitude**2)

    def _flight_design(self, dive: DiveMean) -> Array:
        """Return the effect of the latent states on the mean current through the flight model alone, shape (2, 16, h)."""
        design = np.zeros((2, _SIZE, self.settings.amplitude.size))
        east, north = dive.way
        turn = np.array([[east, -0.5 * north], [north, 0.5 * east]])
        design[:, 2 * _STATES :] = turn[..., None] * self.settings.flight
        return design

    def seen(self, state: ProcessState, dive: DiveMean) -> SeenDive:
        """Return a dive as a state sees it: what a forecast of it and the state after it have in common."""
        settings, (amplitude, axes, scales, of_scale) = self.settings, self._shared
        instants = _instants(dive)
        before = instants[0] if state.time_ns is None else state.time_ns
        # an instant before the last one known counts as at it
        gaps = np.maximum(np.diff([before, *instants]) * 1e-9, 0.0)
        move, kept, noise = (
            np.moveaxis(each, 0, -1).take(of_scale, axis=-1) for each in _over_dive(gaps, scales)
        )
        cov = _moved(move, _moved(move, state.cov).swapaxes(0, 1))
        for own in (slice(_STATES), slice(_STATES, 2 * _STATES)):
            cov[own, own] += noise[:_STATES, :_STATES]
        design = self._flight_design(dive)
        of_parts = np.einsum("ph,pkh->kh", amplitude, kept)
        design[:, : 2 * _STATES] = (axes[:, :, None] * of_parts).reshape(2, 2 * _STATES, -1)
        cross, expected = _products(design, state.mean, state.cov)
        spread = np.einsum("ikh,jkh->ijh", design, cross)
        cross = _moved(move, cross.swapaxes(0, 1)).swapaxes(0, 1)
        mean_noise = np.einsum("ph,kph->kh", amplitude, noise[:_STATES, _STATES:])
        cross[:, : 2 * _STATES] += (axes[:, :, None] * mean_noise).reshape(2, 2 * _STATES, -1)
        variance = (
            np.einsum("ph,pqh,qh->h", amplitude, noise[_STATES:, _STATES:], amplitude)
            + (settings.amplitude * settings.white) ** 2
        )
        # a way that is planned, not known, moves the flight model's error by 1 + 1/4 of its variance
        own_variance = (
            dive.position_variance + _FLOOR**2 + 1.25 * (settings.flight * dive.way_std) ** 2
        )
        spread = with_own(spread + variance * np.einsum("ikh,jkh->ijh", axes, axes), own_variance)
        mean = _moved(move, state.mean.swapaxes(0, 1)).swapaxes(0, 1)
        return SeenDive(state, dive, mean, cov, expected, cross, spread)


def _instants(dive: DiveMean) -> list[int]:
    """Return the instants that stand for a dive [ns, UTC]."""
    share = (np.arange(_INSTANTS) + 0.5) / _INSTANTS - 0.5
    return [dive.time_ns + int(each * dive.seconds * 1e9) for each in share]


def _moved(move: Array, states: Array) -> Array:
    """Return latent states, shape (16, n, h), after transitions of a component, shape (7, 7, h), part by part; the flight model's stay."""
    out = np.empty(states.shape)
    out[2 * _STATES :] = states[2 * _STATES :]
    before, after = (
        each[: 2 * _STATES].reshape(2, _STATES, *each.shape[1:]) for each in (states, out)
    )
    for part in _PARTS:
        np.einsum("ijh,cjnh->cinh", move[part, part], before[:, part], out=after[:, part])
    return out


def _products(design: Array, mean: Array, cov: Array) -> tuple[Array, Array]:
    """Return design times covariance, shape (2, 16, h), and times mean, shape (2, b, h)."""
    return np.einsum("ikh,klh->ilh", design, cov), np.einsum("ikh,bkh->ibh", design, mean)


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
    steps, noises = _transitions(gaps, scales)
    move, new = np.tile(np.eye(size), (gaps.size, scales.size, 1, 1)), np.zeros((size, size))
    through, firsts = np.eye(size)[:, :_STATES], [states.start for states in _PARTS]
    # what is new in a part's first state is new in its mean
    grow = np.eye(size)[:, :_STATES]
    grow[range(_STATES, size), firsts] = 1.0 / gaps.size
    move[:, :, :_STATES, :_STATES] = steps
    move[:, :, _STATES:, :_STATES] = steps[:, :, firsts] / gaps.size
    for each, noise in zip(move, grow @ noises @ grow.T, strict=True):
        through = each @ through
        new = each @ new @ each.transpose(0, 2, 1) + noise
    return through[:, :_STATES], through[:, _STATES:], new


def _transitions(gaps: Array, scales: Array) -> tuple[Array, Array]:
    """Return how a component's latent states pass each time, shape (n, s, 7, 7), and the covariance of what is new in them."""
    move = np.zeros((gaps.size, scales.size, _STATES, _STATES))
    move[:, :, 0, 0] = np.exp(-gaps / _SLOW)[:, None]
    # velocity and its rate times the scale over the square root of 3, both of unit variance
    r = np.sqrt(3.0) * gaps[:, None] / scales
    move[:, :, 1:3, 1:3] = np.moveaxis(
        np.exp(-r) * np.array([[1.0 + r, r], [-r, 1.0 - r]]), (0, 1), (-2, -1)
    )
    for states, (decay, period) in zip(_PARTS[2:], _TIDES, strict=True):
        angle = 2.0 * np.pi * gaps / period
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        move[:, :, states, states] = np.moveaxis(np.exp(-gaps / decay) * turn, -1, 0)[:, None]
    return move, np.eye(_STATES) - move @ np.swapaxes(move, -1, -2)


def _updated(
    known: tuple[Array, Array], cross: Array, spread: Array, errors: Array
) -> tuple[Array, Array]:
    """Return mean and covariance of the states, from those ``known`` before, after errors of a prediction, shape (2, b, h)."""
    gain = np.einsum("abh,bkh->akh", inverse_of(spread), cross)
    return known[0] + np.einsum("ibh,ikh->bkh", errors, gain), grown(known[1], -gain, cross)
