"""Small models of dives' means: of velocities over ground, of the flight model's error, and of the current beside the estimate.

Each is Kalman filters averaged by how well each has predicted so far. Mean currents themselves are predicted by ``process.py``.

A dive's mean current, as the vehicle's flight model gives it, is

    d = c + o(t) + s(t) f + (a + i b) w + e,

with east and north as one complex number: a constant c; a part o that decorrelates, the same at all depths; a part s trapped at the
surface, of which a share f is left in the mean over the dive's depths; the flight model's error along and across the way w through the
water, because d is the displacement over the time less w; and an error e, which no other dive shares. The inverted current of the dive
gives (a + i b) w alone.

Amplitudes and times are not known: each combination of them is a filter of its own, weighted by the density of the past (Bayesian model
averaging, Raftery et al. 2005, MWR 133). With some probability the current has changed from one dive to the next by more than it usually
does, or, where that is asked for, the mean current is wrong; the cases are kept until the dive's mean is known, and joined to one Gaussian
after it (Blom and Bar-Shalom 1988, IEEE TAC 33).
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.next_dive.mixtures import (
    FLIGHT_BIAS,
    UNKNOWNS,
    Mixture,
    Settings,
    flight_combinations,
    ground_combinations,
    log_densities,
)

_NS = 1e9
# m; how far fixes and way through the water miss together, over the dive's time
_POSITION_STD = 60.0
#: m/s; of the inverted current beside that of the flight model
INVERTED_STD = 0.03
# Probability of a change between two dives, of a velocity over ground, and the factor on the variances of what changes.
_JUMP, _TURN, _JUMP_FACTOR = 0.05, 0.02, 4.0
# Probability that a dive's mean current is wrong, and by how much then, a component [m/s].
_WRONG, _WRONG_STD = 0.05, 0.5
#: m; how far two fixes alone miss together, over the dive's time.
FIXES_STD = 20.0
_JUMPING = slice(2, 6)
#: m; depth over which the part trapped at the surface falls by e.
SURFACE_DEPTH = 50.0


@dataclass(frozen=True, slots=True, eq=False)
class DiveMean:
    """A dive's measurement of the mean current; velocities are towards true east and north [m/s].

    Attributes:
        time_ns: Of its middle [ns, UTC].
        seconds: Its duration [s].
        way: shape (2,), mean velocity through the water; zero where it is not known.
        surface_share: Mean of exp(-depth / ``SURFACE_DEPTH``) along its path.
        velocity: shape (2,), mean current, or mean velocity over ground where the way is not known.
        inverted: shape (2,), mean along the path of absolute profiles that do not depend on the flight model; None without.
        backgrounds: shape (k, 2), background currents, in the order of the settings.
        position_std: How far fixes and way through the water miss together, over the dive's time [m].
        way_std: Of each component of ``way`` [m/s]; 0 where it is known.
    """

    time_ns: int
    seconds: float
    way: Array
    surface_share: float
    velocity: Array
    inverted: Array | None = None
    backgrounds: Array = field(default_factory=lambda: np.empty((0, 2)))
    position_std: float = _POSITION_STD
    way_std: float = 0.0

    @property
    def design(self) -> Array:
        """Effect of the unknowns on the mean current, shape (2, 8)."""
        east, north = self.way
        ones = np.eye(2)
        return np.hstack([ones, ones, self.surface_share * ones, [[east, -north], [north, east]]])

    @property
    def position_variance(self) -> float:
        """Variance of a component of the mean current that fixes and way cause [m^2/s^2]."""
        return (self.position_std / self.seconds) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class DiveState:
    """What is known after some dives; leading axes are of several states, of dives of the same times.

    Attributes:
        mean: shape (..., h, 8), of the unknowns under each combination of settings.
        cov: shape (..., h, 8, 8).
        log_weights: shape (..., h), of the combinations; the weights sum to one.
        time_ns: Of the last dive [ns, UTC]; None before the first.
        dives: Number of dives.
    """

    mean: Array
    cov: Array
    log_weights: Array
    time_ns: int | None = None
    dives: int = 0


class _Case(NamedTuple):
    """What a dive may be.

    Attributes:
        log_share: Logarithm of its probability.
        cross: shape (2, ..., h, 8), covariance of each component of the mean current with the unknowns.
        spread: shape (..., h, 2, 2), covariance of the mean current.
        more: shape (h, 8), variances of the unknowns beyond those of the state.
    """

    log_share: float
    cross: Array
    spread: Array
    more: Array


@dataclass(frozen=True, slots=True, eq=False)
class _SeenDive:
    """A dive, the state at its time, and what the dive may be."""

    state: DiveState
    dive: DiveMean
    cases: list[_Case]


@dataclass(frozen=True, slots=True, eq=False)
class DiveModel:
    """The model of dives' mean currents.

    Attributes:
        settings: The combinations that are averaged.
        jump: Probability of a change between two dives that is larger than usual.
        wrong: Probability that a dive's mean current is an outlier.
    """

    settings: Settings
    jump: float = _JUMP
    wrong: float = 0.0

    @classmethod
    def over_ground(cls, n_backgrounds: int = 0) -> "DiveModel":
        """Return the model of dives' mean velocities over ground, where the way through the water is not known.

        What a pilot steers stays the same for many dives and has no noise, so that large changes come less often than currents' do.
        """
        return cls(ground_combinations(n_backgrounds), _TURN)

    @classmethod
    def of_flight(cls) -> "DiveModel":
        """Return the model that tells whether the flight model errs; a wrong mean current must not look like such an error."""
        return cls(flight_combinations(), wrong=_WRONG)

    def initial(self) -> DiveState:
        """Return the state before the first dive."""
        size = self.settings.size
        cov = self.settings.variance[:, :, None] * np.eye(UNKNOWNS)
        return DiveState(np.zeros((size, UNKNOWNS)), cov, self.settings.log_prior)

    def predict(self, state: DiveState, time_ns: int) -> DiveState:
        """Return the state at a later time, before the dive of that time; unchanged for an earlier time."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        time_ns = max(time_ns, state.time_ns)
        kept = np.exp(-(time_ns - state.time_ns) / _NS / self.settings.scales)
        cov = state.cov * (kept[:, :, None] * kept[:, None, :])
        cov[..., range(UNKNOWNS), range(UNKNOWNS)] += (1.0 - kept**2) * self.settings.variance
        return replace(state, mean=state.mean * kept, cov=cov, time_ns=time_ns)

    def forecast(self, state: DiveState, dive: DiveMean) -> Mixture:
        """Return what is expected of a dive's mean current.

        Args:
            state: After the dives before.
            dive: Its time, duration, way, depths and backgrounds; its current is not used.
        """
        return self.mixture(self.seen(state, dive))

    def step(self, state: DiveState, dive: DiveMean) -> DiveState:
        """Return the state after a dive."""
        return self.after(self.seen(state, dive))

    def seen(self, state: DiveState, dive: DiveMean) -> _SeenDive:
        """Return a dive as a state sees it: what a forecast of it and the state after it have in common."""
        state = self.predict(state, dive.time_ns)
        return _SeenDive(state, dive, self._cases(state, dive))

    def mixture(self, seen: _SeenDive) -> Mixture:
        """Return what is expected of the mean current of a dive that a state sees."""
        state, dive = seen.state, seen.dive
        expected = state.mean @ dive.design.T + self._background(dive)
        parts = [(state.log_weights + case.log_share, expected, case.spread) for case in seen.cases]
        log_weights, means, covs = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Mixture(log_weights, means, covs)

    def after(self, seen: _SeenDive) -> DiveState:
        """Return the state after the dive that it sees."""
        state, dive = seen.state, seen.dive
        errors = dive.velocity - self._background(dive) - state.mean @ dive.design.T
        state = replace(_after(state, errors, seen.cases), dives=state.dives + 1)
        return state if dive.inverted is None else self._with_inverted(state, dive, dive.inverted)

    def flight_bias(self, state: DiveState) -> tuple[Array, Array]:
        """Return mean and standard deviation of the flight model's error along and across the way, as shares of it; shape (2,) each."""
        weights = np.exp(state.log_weights)
        means, parts = state.mean[:, FLIGHT_BIAS], np.arange(UNKNOWNS)[FLIGHT_BIAS]
        mean = weights @ means
        variance = weights @ (state.cov[:, parts, parts] + (means - mean) ** 2)
        return np.asarray(mean), np.sqrt(variance)

    def flight_evidence(self, state: DiveState) -> Array:
        """Return the log evidence of an error of the flight model over none [nats], shape (...); the settings have both."""
        has = self.settings.has_flight_bias

        def log_odds(log_weights: Array) -> Array:
            with_error, without = (
                np.logaddexp.reduce(log_weights[..., of], axis=-1) for of in (has, ~has)
            )
            return np.asarray(with_error - without)

        return log_odds(state.log_weights) - log_odds(self.settings.log_prior)

    def _background(self, dive: DiveMean) -> Array:
        """Return what the current is measured about under each combination, shape (h, 2); zero where it is not known."""
        return np.vstack([np.zeros(2), np.nan_to_num(dive.backgrounds)])[self.settings.background]

    def _cases(self, state: DiveState, dive: DiveMean) -> list[_Case]:
        """Return what a dive may be: as the dives before, after a change, and, where that is asked for, with a wrong mean current."""
        own = (self.settings.white_std**2 + dive.position_variance)[:, None, None] * np.eye(2)
        right, more = 1.0 - self.wrong, np.zeros((self.settings.size, UNKNOWNS))
        usual = _as_expected(state, dive.design, own, right * (1.0 - self.jump))
        more[:, _JUMPING] = (_JUMP_FACTOR - 1.0) * self.settings.variance[:, _JUMPING]
        further = dive.design[:, None] * more
        spread = usual.spread + np.tensordot(further, dive.design, (-1, 1)).swapaxes(0, 1)
        cross = usual.cross + further.reshape(2, *[1] * (state.mean.ndim - 2), *more.shape)
        changed = _Case(float(np.log(right * self.jump)), cross, spread, more)
        return [usual, changed, *self._wrong(usual)]

    def _wrong(self, usual: _Case) -> list[_Case]:
        """Return the case of a wrong mean current, where that is asked for."""
        if not self.wrong:
            return []
        spread = usual.spread + _WRONG_STD**2 * np.eye(2)
        return [usual._replace(log_share=float(np.log(self.wrong)), spread=spread)]

    def _with_inverted(self, state: DiveState, dive: DiveMean, inverted: Array) -> DiveState:
        """Return the state after the inverted current: what is left of the mean current without it is the flight model's error."""
        design = dive.design.copy()
        design[:, : FLIGHT_BIAS.start] = 0.0
        errors = dive.velocity - inverted - state.mean @ design.T
        own = (INVERTED_STD**2 + dive.position_variance) * np.eye(2)
        usual = _as_expected(state, design, own, 1.0 - self.wrong)
        return _after(state, errors, [usual, *self._wrong(usual)])


def _as_expected(state: DiveState, design: Array, own: Array, share: float) -> _Case:
    """Return the case in which the unknowns are as a state knows them; ``own``, shape (..., 2, 2), is what they do not cause."""
    cross = np.tensordot(design, state.cov, (1, -1))
    spread = np.moveaxis(np.tensordot(cross, design, (-1, 1)), 0, -1) + own
    return _Case(float(np.log(share)), cross, spread, np.zeros(state.mean.shape[-2:]))


def _after(state: DiveState, errors: Array, cases: list[_Case]) -> DiveState:
    """Return the state after errors of a prediction, shape (..., h, 2), which some cases expect to be of different size.

    The cases are joined to one Gaussian, combination by combination: what each takes from the covariance, and what its mean adds, are
    products of columns, which are added up in one product.
    """
    log_likelihood = np.stack(
        [case.log_share + log_densities(errors, case.spread) for case in cases]
    )
    total = np.logaddexp.reduce(log_likelihood, axis=0)
    shares = np.exp(log_likelihood - total)[..., None]
    gains, moves = [], []
    for case in cases:
        # component by component: inner loops over two numbers would take several times as long
        (of_east, both), (_, of_north) = np.moveaxis(case.spread, (-2, -1), (0, 1))[..., None]
        (east, north), over = case.cross, 1.0 / (of_east * of_north - both**2)
        gain = over * (of_north * east - both * north), over * (of_east * north - both * east)
        gains.append(gain)
        moves.append(gain[0] * errors[..., :1] + gain[1] * errors[..., 1:])
    move = np.sum([share * part for share, part in zip(shares, moves, strict=True)], axis=0)
    left, right, more = [], [], 0.0 * move
    for share, gain, each, case in zip(shares, gains, moves, cases, strict=True):
        about = each - move
        left += [-share * gain[0], -share * gain[1], share * about]
        right += [*case.cross, about]
        more += share * case.more
    cov = state.cov + np.swapaxes(np.stack(left, -2), -1, -2) @ np.stack(right, -2)
    cov[..., range(UNKNOWNS), range(UNKNOWNS)] += more
    # the rounding error of the two halves would grow from dive to dive
    cov = 0.5 * (cov + np.swapaxes(cov, -1, -2))
    log_weights = state.log_weights + total
    log_weights -= np.logaddexp.reduce(log_weights, axis=-1, keepdims=True)
    return replace(state, mean=state.mean + move, cov=cov, log_weights=log_weights)
