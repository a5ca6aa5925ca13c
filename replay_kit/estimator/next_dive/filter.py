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
    """What is known after some dives, or k times that: of dives of the same times.

    Attributes:
        mean: shape (8, k, h), of the unknowns under each combination of settings.
        cov: shape (8, 8, k, h).
        log_weights: shape (k, h), of the combinations; the weights sum to one.
        time_ns: Of the last dive [ns, UTC]; None before the first.
        dives: Number of dives.
    """

    mean: Array
    cov: Array
    log_weights: Array
    time_ns: int | None = None
    dives: int = 0

    @property
    def variance(self) -> Array:
        """Variances of the unknowns, shape (8, k, h): a view."""
        return np.asarray(np.einsum("ii...->i...", self.cov))


class _Case(NamedTuple):
    """What a dive may be.

    Attributes:
        log_share: Logarithm of its probability.
        spread: shape (2, 2, k, h), covariance of the mean current.
        changed: Whether the current has changed by more than it usually does.
    """

    log_share: float
    spread: Array
    changed: bool = False


class _Seen(NamedTuple):
    """A dive, the state at its time, and what the dive may be.

    Attributes:
        state: At the dive's time.
        dive: The dive.
        rows: shape (r, 8, k, h), covariance of the mean current with the unknowns; of four rows the last two are what a change adds.
        more: shape (8, h), what a change adds to the variances of the unknowns.
        cases: What the dive may be.
    """

    state: DiveState
    dive: DiveMean
    rows: Array
    more: Array
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
        cov = np.eye(UNKNOWNS)[:, :, None, None] * self.settings.variance.T[:, None]
        return DiveState(np.zeros((UNKNOWNS, 1, size)), cov, self.settings.log_prior[None])

    def predict(self, state: DiveState, time_ns: int) -> DiveState:
        """Return the state at a later time, before the dive of that time; unchanged for an earlier time."""
        if state.time_ns is None:
            return replace(state, time_ns=time_ns)
        time_ns = max(time_ns, state.time_ns)
        kept = np.exp(-(time_ns - state.time_ns) / _NS / self.settings.scales).T[:, None]
        later = replace(
            state, mean=state.mean * kept, cov=state.cov * (kept[:, None] * kept), time_ns=time_ns
        )
        later.variance[...] += (1.0 - kept**2) * self.settings.variance.T[:, None]
        return later

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

    def seen(self, state: DiveState, dive: DiveMean) -> _Seen:
        """Return a dive as a state sees it: what a forecast of it and the state after it have in common.

        It may be as the dives before, after a change, and, where that is asked for, with a wrong mean current.
        """
        state, variance, right = (
            self.predict(state, dive.time_ns),
            self.settings.variance,
            1.0 - self.wrong,
        )
        more = np.zeros((UNKNOWNS, self.settings.size))
        more[_JUMPING] = (_JUMP_FACTOR - 1.0) * variance.T[_JUMPING]
        further = dive.design[:, :, None] * more
        own = self.settings.white_std**2 + dive.position_variance
        rows, usual = _as_expected(state, dive.design, own, right * (1.0 - self.jump))
        spread = usual.spread + np.einsum("aih,bi->abh", further, dive.design)[:, :, None]
        changed = _Case(float(np.log(right * self.jump)), spread, True)
        further = np.broadcast_to(further[:, :, None], rows.shape)
        cases = [usual, changed, *self._wrong(usual)]
        return _Seen(state, dive, np.concatenate([rows, further]), more, cases)

    def mixture(self, seen: _Seen) -> Mixture:
        """Return what is expected of the mean current of a dive that a state sees."""
        state, dive = seen.state, seen.dive
        expected = dive.design @ state.mean[:, 0] + self._background(dive)
        parts = [
            (state.log_weights[0] + case.log_share, expected, case.spread[:, :, 0])
            for case in seen.cases
        ]
        return Mixture(*(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)))

    def after(self, seen: _Seen) -> DiveState:
        """Return the state after the dive that it sees."""
        dive = seen.dive
        errors = (dive.velocity[:, None] - self._background(dive))[:, None]
        errors = errors - np.tensordot(dive.design, seen.state.mean, 1)
        state = replace(_after(seen, errors), dives=seen.state.dives + 1)
        return state if dive.inverted is None else self._with_inverted(state, dive, dive.inverted)

    def flight_bias(self, state: DiveState) -> tuple[Array, Array]:
        """Return mean and standard deviation of the flight model's error along and across the way, as shares of it; shape (2,) each."""
        weights, means = np.exp(state.log_weights[0]), state.mean[FLIGHT_BIAS, 0]
        mean = means @ weights
        variance = (state.variance[FLIGHT_BIAS, 0] + (means - mean[:, None]) ** 2) @ weights
        return np.asarray(mean), np.sqrt(variance)

    def flight_evidence(self, state: DiveState) -> Array:
        """Return the log evidence of an error of the flight model over none [nats], shape (k,); the settings have both."""
        has = self.settings.has_flight_bias

        def log_odds(log_weights: Array) -> Array:
            with_error, without = (
                np.logaddexp.reduce(log_weights[..., of], axis=-1) for of in (has, ~has)
            )
            return np.asarray(with_error - without)

        return log_odds(state.log_weights) - log_odds(self.settings.log_prior)

    def _background(self, dive: DiveMean) -> Array:
        """Return what the current is measured about under each combination, shape (2, h); zero where it is not known."""
        about = np.vstack([np.zeros(2), np.nan_to_num(dive.backgrounds)])
        return about[self.settings.background].T

    def _wrong(self, usual: _Case) -> list[_Case]:
        """Return the case of a wrong mean current, where that is asked for."""
        if not self.wrong:
            return []
        return [_Case(float(np.log(self.wrong)), with_own(usual.spread, _WRONG_STD**2))]

    def _with_inverted(self, state: DiveState, dive: DiveMean, inverted: Array) -> DiveState:
        """Return the state after the inverted current: what is left of the mean current without it is the flight model's error."""
        design = dive.design.copy()
        design[:, : FLIGHT_BIAS.start] = 0.0
        errors = (dive.velocity - inverted)[:, None, None] - np.tensordot(design, state.mean, 1)
        own = INVERTED_STD**2 + dive.position_variance
        rows, usual = _as_expected(state, design, own, 1.0 - self.wrong)
        none = np.zeros((UNKNOWNS, self.settings.size))
        return _after(_Seen(state, dive, rows, none, [usual, *self._wrong(usual)]), errors)


def with_own(spread: Array, own: Array | float) -> Array:
    """Return covariances, shape (2, 2, ...), with what each component has of its own added to the variances."""
    out = spread.copy()
    out[[0, 1], [0, 1]] += own
    return out


def inverse_of(spread: Array) -> Array:
    """Return the inverses of covariances, shape (2, 2, ...)."""
    (of_east, both), (_, of_north) = spread
    adjugate = np.array([[of_north, -both], [-both, of_east]])
    return np.asarray(adjugate / (of_east * of_north - both**2))


def grown(cov: Array, left: Array, right: Array) -> Array:
    """Return covariances, shape (n, n, ...), plus the products of rows, shape (r, n, ...) each, which are symmetric together."""
    out = np.empty_like(cov)
    # a half that mirrors the other: the rounding error of two would grow from dive to dive
    for i in range(len(cov)):
        out[i, i:] = cov[i, i:] + np.einsum("a...,aj...->j...", left[:, i], right[:, i:])
        out[i:, i] = out[i, i:]
    return out


def _as_expected(
    state: DiveState, design: Array, own: Array | float, share: float
) -> tuple[Array, _Case]:
    """Return the rows, and the case in which the unknowns are as a state knows them; ``own`` is the variance that they do not cause."""
    rows = np.tensordot(design, state.cov, 1)
    spread = np.einsum("aikh,bi->abkh", rows, design)
    return rows, _Case(float(np.log(share)), with_own(spread, own))


def _after(seen: _Seen, errors: Array) -> DiveState:
    """Return the state after errors of a prediction, shape (2, k, h), which some cases expect to be of different size.

    The cases are joined to one Gaussian, combination by combination. Each moves the mean along the rows, and what it takes from the
    covariance is a form of them: of all cases it is one form, F, and the covariance grows by rows' F rows.
    """
    state, rows, cases = seen.state, seen.rows, seen.cases
    log_likelihood = np.stack(
        [each.log_share + log_densities(errors, each.spread) for each in cases]
    )
    total = np.logaddexp.reduce(log_likelihood, axis=0)
    shares, pairs = np.exp(log_likelihood - total), len(rows) // 2
    moves = np.zeros((len(cases), pairs, 2, *total.shape))
    form, more = np.zeros((pairs, 2, pairs, 2, *total.shape)), np.zeros(total.shape)
    for share, case, along in zip(shares, cases, moves, strict=True):
        inverse = inverse_of(case.spread)
        # a change adds to both pairs of rows
        own = 1 + case.changed
        along[:own] = np.sum(inverse * errors, axis=1)
        form[:own, :, :own] -= share * inverse[:, None]
        more += case.changed * share
    move = np.sum(shares[:, None, None] * moves, axis=0)
    for share, about in zip(shares, moves - move, strict=True):
        form += (share * about)[:, :, None, None] * about
    step = np.einsum("abkh,bikh->aikh", form.reshape(len(rows), len(rows), *total.shape), rows)
    mean = state.mean + np.einsum("akh,aikh->ikh", move.reshape(len(rows), *total.shape), rows)
    log_weights = state.log_weights + total
    log_weights -= np.logaddexp.reduce(log_weights, axis=-1, keepdims=True)
    after = replace(state, mean=mean, cov=grown(state.cov, rows, step), log_weights=log_weights)
    after.variance[...] += more * seen.more[:, None]
    return after
