"""A survey and the stretch after it, flown in samples of the estimate as they would be at sea.

In each sample a current is drawn and called true. The vehicle keeps to its survey dive by dive, correcting its course at each surfacing by
the current it has just met; each dive brings a mean current with an error; the estimate is updated with them; the stretch is planned on
what is then known, and flown in the true current by dead reckoning. What is returned is how far it ends from its goal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planners.front.current import Complex
from planners.learning.current import Currents, currents_of
from planners.learning.loops import Survey
from planners.learning.rows import Rows, gains, learnt, rows_at, stacked
from planners.learning.transit import fly_transit, plan_transit
from replay_kit.core.arrays import Array
from replay_kit.core.evidence import bootstrap_interval
from replay_kit.core.flow.depth_means import DepthMeans
from replay_kit.core.flow.evolution import sample_through

# Time between the entries of currents that change [s].
_SLICE = 6.0 * 3600.0
_RESAMPLES = 400


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """A stretch without fixes, and how it is flown.

    Attributes:
        start: Where survey and stretch begin [m].
        goals: shape (L,) [m], in order.
        begin: Of the survey [s], since the estimate's time.
        survey: Its duration [s].
        blind: That of the stretch [s].
        speed: Greatest horizontal speed through water [m/s].
        error: Standard deviation of a profile's mean current, each component [m/s].
    """

    start: complex
    goals: Complex
    begin: float
    survey: float
    blind: float
    speed: float
    error: float

    @property
    def leaves(self) -> float:
        """When the stretch begins after the survey [s]."""
        return self.begin + self.survey


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """Stretches in samples.

    Attributes:
        misses: shape (S,) [m], distance of each end from the goal.
        offsets: shape (S,) [m], the end less where it was predicted.
        short: shape (S,) [m], by how much the plan itself ends short of the goal, as the vehicle is too slow for the current it knows of.
    """

    misses: Array
    offsets: Complex
    short: Array

    @property
    def miss_90(self) -> float:
        """The distance that 90 % of the stretches do not exceed [m]."""
        return float(np.quantile(self.misses, 0.9))

    def interval(self) -> tuple[float, float]:
        """Return an interval that holds the 90 % miss with a probability of 90 %, by bootstrap [m]."""
        return bootstrap_interval(
            lambda drawn: np.quantile(self.misses[drawn], 0.9, axis=1), self.misses.size, _RESAMPLES
        )


@dataclass(frozen=True, slots=True, eq=False)
class Sea:
    """What survey and stretch are flown in, and what is known of it.

    Attributes:
        known: Errors of the estimate.
        times: shape (T,) [s] since the estimate's time, of the entries of the currents.
        mean: The estimate itself, one current.
        truth: S currents.
    """

    known: DepthMeans
    times: Array
    mean: Currents
    truth: Currents

    @property
    def count(self) -> int:
        """Number of true currents."""
        return len(self.truth.coefficients)


def slices(known: DepthMeans, begin: float, end: float) -> Array:
    """Return the times [s] at which currents are given from a beginning to an end; one where the current does not change."""
    if not known.changes:
        return np.zeros(1)
    return np.linspace(begin, end, max(int(np.ceil((end - begin) / _SLICE)), 1) + 1)


def mean_currents(known: DepthMeans, times: Array) -> Currents:
    """Return the mean current of an estimate as it changes."""
    return currents_of(
        known.flow, [known.latent(_ns(known, time))[:, :1].T for time in times], times
    )


def drawn_sea(known: DepthMeans, times: Array, count: int, seed: int) -> Sea:
    """Return a sea of samples of an estimate.

    Args:
        known: Errors of the estimate.
        times: Of ``slices``.
        count: Number of samples.
        seed: Of the draws.
    """
    drawn = sample_through(known.flow, [_ns(known, time) for time in times], count, seed)
    latent = [
        np.stack([through[k].latent @ known.weights[0] for through in drawn])
        for k in range(times.size)
    ]
    return Sea(known, times, mean_currents(known, times), currents_of(known.flow, latent, times))


def fly_survey(sea: Sea, stretch: Stretch, survey: Survey) -> tuple[Complex, Complex, Complex]:
    """Return where one survey's profiles lie in each true current, shape (S, n) [m], their mean currents, and where it ends, shape (S,).

    Args:
        sea: What it is flown in.
        stretch: Where it begins, and the vehicle's speed.
        survey: One.
    """
    n_dives, place = survey.times.size, np.full(sea.count, stretch.start)
    dive, places, met = stretch.survey / n_dives, list[Complex](), list[Complex]()
    off = np.zeros(sea.count, dtype=np.complex128)
    for end, middle in zip(survey.ends[0], survey.times, strict=True):
        expected = sea.mean.at(place[None], middle)[0] + off
        held = (end - place) / dive - expected
        held *= np.minimum(1.0, stretch.speed / np.maximum(np.abs(held), 1e-12))
        # the midpoint's current moves the vehicle, and is what the dive measures
        there = place + 0.5 * dive * (held + sea.truth.at(place, middle))
        current = sea.truth.at(there, middle)
        place = place + dive * (held + current)
        off = current - sea.mean.at(there[None], middle)[0]
        places.append(there)
        met.append(current)
    return np.stack(places, axis=1), np.stack(met, axis=1), place


def fly_after(
    sea: Sea,
    stretch: Stretch,
    survey: Survey | None,
    noise: Array,
    given: Sequence[tuple[Array, Array]] = (),
) -> Flown:
    """Return stretches flown after a survey, or at once.

    Args:
        sea: What they are flown in.
        stretch: Their goal.
        survey: One; None for no survey, and the stretch at the survey's beginning.
        noise: shape (S, n, 2) of unit variance, errors of the profiles.
        given: Profiles that others bring: places, shape (m, 2) [m], and times, shape (m,) [s].
    """
    place, leaves, known = np.full(sea.count, stretch.start), stretch.begin, sea.mean
    measured, innovation = from_others(sea, stretch.error, given)
    if survey is not None:
        places, met, place = fly_survey(sea, stretch, survey)
        found = met - sea.mean.at(
            places[None].reshape(1, -1), np.tile(survey.times, sea.count)[None]
        )[0].reshape(met.shape)
        values = (
            np.stack([found.real, found.imag], axis=-1) + stretch.error * noise[:, : met.shape[1]]
        )
        rows = rows_at(sea.known, np.stack([places.real, places.imag], axis=-1), survey.times)
        measured = rows if measured is None else stacked(rows, measured)
        innovation = np.concatenate([values.reshape(sea.count, -1), innovation], axis=1)
        leaves = stretch.leaves
    if measured is not None:
        known = updated(
            sea, measured, innovation, stretch.error**2, (leaves, leaves + stretch.blind)
        )
    return _flown(sea, stretch, known, place, leaves)


def _flown(sea: Sea, stretch: Stretch, known: Currents, place: Complex, leaves: float) -> Flown:
    if len(known.coefficients) < sea.count:
        known = Currents(
            known.origin,
            known.spacing,
            known.times,
            np.repeat(known.coefficients, sea.count, axis=0),
        )
    planned = plan_transit(known, place, leaves, stretch.goals, stretch.blind, stretch.speed)
    ends = fly_transit(sea.truth, place, leaves, planned)
    last = planned.ends[:, -1]
    return Flown(np.abs(ends - stretch.goals[-1]), ends - last, np.abs(last - stretch.goals[-1]))


def from_others(
    sea: Sea, error: float, given: Sequence[tuple[Array, Array]]
) -> tuple[Rows | None, Array]:
    """Return the rows of others' profiles, and what they measure in each sample beyond the mean, shape (S, q).

    Args:
        sea: What they are made in.
        error: Standard deviation of a profile's mean current, each component [m/s].
        given: Their places, shape (m, 2) [m], and times, shape (m,) [s]; none for no profiles.
    """
    if not given:
        return None, np.zeros((sea.count, 0))
    points, times = (np.concatenate(parts) for parts in zip(*given, strict=True))
    places = np.broadcast_to(points[:, 0] + 1j * points[:, 1], (sea.count, len(points)))
    found = sea.truth.at(places, times) - sea.mean.at(places[:1], times)
    rng = np.random.default_rng(len(points))
    values = np.stack([found.real, found.imag], axis=-1) + error * rng.standard_normal(
        (*found.shape, 2)
    )
    return rows_at(sea.known, points, times), values.reshape(sea.count, -1)


def updated(
    sea: Sea, measured: Rows, innovation: Array, variance: float, span: tuple[float, float]
) -> Currents:
    """Return the mean currents after measurements during a span of time, S of them.

    Args:
        sea: Their estimate.
        measured: Rows of shape (S, q), or (q,) where all share them.
        innovation: shape (S, q), measured minus mean [m/s].
        variance: Of a row's error [m^2/s^2].
        span: From when to when they are needed [s].
    """
    weighed, times = gains(measured, innovation, variance), slices(sea.known, *span)
    latent = []
    for time in times:
        unknowns, now_ns = (
            learnt(sea.known, measured, weighed, float(time)),
            _ns(sea.known, float(time)),
        )
        weights = unknowns @ sea.known.loading(now_ns)[:, 0]
        latent.append(sea.known.latent(now_ns)[:, 0] + weights @ sea.known.flow.modes.T)
    return currents_of(sea.known.flow, latent, times)


def _ns(known: DepthMeans, after: float) -> int:
    return known.time_ns + round(after * 1e9)
