"""The next profiles that make a box's current best known: legs that look several ahead, and lawn-mowers drawn in the same box.

What a set of profiles leaves of the mean variance over the box is known before they are made. The search is a filter without values: at
each surfacing the covariance P of the unknowns grows with time and shrinks by a profile's two rows h,

    P - P h' (h P h' + R)^-1 h P,    and the variance of the box's rows b at the end by the squares of b rho P h' (h P h' + R)^(-1/2).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planners.front.current import Complex
from planners.learning.current import Currents
from planners.learning.loops import Survey
from planners.learning.rows import Rows, covariance, lower_root, rows_at, stacked, together
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth_means import DepthMeans

# Directions of a leg, ways that are followed at once, and how far apart their ends are, in legs.
_DIRECTIONS, _FOLLOWED, _APART = 16, 24, 0.5
#: Share of the speed that legs count on.
COUNTED = 0.9
# Rounds of the local search, turns tried in each, and their first spread [rad].
_TURNS, _TRIES, _TURN = 40, 16, 0.6


# Not slotted: the rows of the box are made once.
@dataclass(frozen=True, eq=False)
class Mapping:
    """What is to be mapped, and how legs lead there.

    Attributes:
        known: Errors of the estimate: of the dives' mean current first, then of the currents that count.
        mean: The current that is known.
        box: shape (P, 2) [m], places whose currents count.
        which: Of the means over depth, those that count at each place.
        start: Where it begins [m].
        times: shape (N + 1,) [s], of the surfacings.
        speed: Greatest horizontal speed through water [m/s].
        variance: Of a profile's mean current [m^2/s^2].
        given: Rows of profiles that others bring; None for none.
    """

    known: DepthMeans
    mean: Currents
    box: Array
    which: tuple[int, ...]
    start: complex
    times: Array
    speed: float
    variance: float
    given: Rows | None = None

    @property
    def profile_times(self) -> Array:
        """Times of the profiles, shape (N,) [s]: the middle of each leg."""
        return 0.5 * (self.times[1:] + self.times[:-1])

    @cached_property
    def sought(self) -> Rows:
        """The rows of the currents that count, at the end."""
        end = np.full(len(self.box), self.times[-1])
        return together([rows_at(self.known, self.box, end, which) for which in self.which])

    @cached_property
    def variances(self) -> Array:
        """Of the currents that count, without any profile [m^2/s^2], shape (m,)."""
        return np.diag(covariance(self.sought, self.sought))

    def errors(self, surveys: Survey) -> Array:
        """Return the root mean square error of a component that profiles leave in the box [m/s], shape (C,)."""
        rows = rows_at(self.known, surveys.points, surveys.times)
        return self.left_by(rows if self.given is None else stacked(rows, self.given))

    def before(self) -> float:
        """Return the root mean square error of a component in the box without the profiles [m/s]."""
        if self.given is None:
            return float(np.sqrt(np.mean(self.variances)))
        return float(self.left_by(self.given))

    def left_by(self, rows: Rows) -> Array:
        """Return the root mean square error of a component in the box after measurements, rows of shape (..., q) [m/s]."""
        left = self.variances - reduction(self.sought, rows, self.variance)
        return np.asarray(np.sqrt(np.mean(left, axis=-1)))


def reduction(sought: Rows, measured: Rows, variance: float) -> Array:
    """Return by how much measurements, shape (..., q), reduce the variance of each sought number, shape (..., m)."""
    inside = np.linalg.solve(lower_root(measured, variance), covariance(measured, sought))
    return np.asarray(np.sum(inside**2, axis=-2))


class Allowed(Protocol):
    """Which legs may be flown."""

    def __call__(self, begins: Complex, ends: Complex) -> NDArray[np.bool_]:
        """Return whether legs between places, shape (n,) [m], may be flown."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """A way that is followed: where it has come to, the covariance there, and the box's rows times it."""

    place: complex
    cov: Array
    gained: float
    middles: tuple[complex, ...] = ()
    ends: tuple[complex, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What all steps of a search share."""

    mapping: Mapping
    box: Array
    allowed: Allowed

    def grown(self, cov: Array, step: int) -> Array:
        """Return the covariance at the profile of a leg, from that at the profile before it."""
        known, times = self.mapping.known, self.mapping.profile_times
        past = times[step] - (times[step - 1] if step else self.mapping.times[0])
        for part in known.relaxing:
            kept = np.exp(-past / part.scale)
            rows = np.ones(len(cov))
            rows[part.which] = kept
            cov = cov * rows[:, None] * rows
            cov[part.which, part.which] += (1.0 - kept**2) * (part.root @ part.root.T)
        return cov

    def remembered(self, step: int) -> Array:
        """Return the box's rows at the end on the unknowns at the profile of a leg, shape (m, n)."""
        known, left = self.mapping.known, np.ones(self.box.shape[1])
        for part in known.relaxing:
            left[part.which] = np.exp(
                -(self.mapping.times[-1] - self.mapping.profile_times[step]) / part.scale
            )
        return self.box * left

    def next_ways(self, ways: Sequence[_Way], step: int) -> list[_Way]:
        """Return the best ways a leg longer, each looked at in all directions, of those that end near each other the best alone."""
        mapping = self.mapping
        starts = np.array([way.place for way in ways])
        middles, ends = legs_from(mapping, starts, step)
        free = self.allowed(np.repeat(starts, _DIRECTIONS), ends.ravel()).reshape(ends.shape)
        points = np.stack([middles.real, middles.imag], axis=-1)
        time_ns = mapping.known.time_ns + round(float(mapping.profile_times[step]) * 1e9)
        modes = mapping.known.modes(points.reshape(-1, 2)).reshape(*middles.shape, 2, -1)
        loaded = modes @ mapping.known.loading(time_ns)[:, 0].T
        box, found = self.remembered(step), list[tuple[float, int, int]]()
        grown = [self.grown(way.cov, step) for way in ways]
        for k, (way, cov) in enumerate(zip(ways, grown, strict=True)):
            crossed = cov @ loaded[k].reshape(-1, len(cov)).T
            inside = (box @ crossed).reshape(len(box), _DIRECTIONS, 2).transpose(1, 0, 2)
            own = np.einsum(
                "dcn,ndk->dck", loaded[k], crossed.reshape(len(cov), _DIRECTIONS, 2)
            ) + mapping.variance * np.eye(2)
            gains = np.einsum("dmc,dmk,dck->d", inside, inside, np.linalg.inv(own), optimize=True)
            found += [
                (way.gained + float(gain), k, d) for d, gain in enumerate(gains) if free[k, d]
            ]
        longer, near = (
            list[_Way](),
            _APART * mapping.speed * float(mapping.times[step + 1] - mapping.times[step]),
        )
        for gained, k, d in sorted(found, reverse=True):
            if len(longer) == _FOLLOWED:
                break
            if any(abs(one.place - ends[k, d]) < near for one in longer):
                continue
            rows = loaded[k, d]
            crossed = grown[k] @ rows.T
            left = grown[k] - crossed @ np.linalg.solve(
                rows @ crossed + mapping.variance * np.eye(2), crossed.T
            )
            way = ways[k]
            longer.append(
                _Way(
                    complex(ends[k, d]),
                    left,
                    gained,
                    (*way.middles, complex(middles[k, d])),
                    (*way.ends, complex(ends[k, d])),
                )
            )
        return longer


def legs_from(mapping: Mapping, places: Complex, step: int) -> tuple[Complex, Complex]:
    """Return middles and ends of legs in all directions, shape (n, directions) [m], in the current that is known."""
    lasts = float(mapping.times[step + 1] - mapping.times[step])
    held = COUNTED * mapping.speed * np.exp(2j * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
    u = mapping.mean.at(places[None], mapping.profile_times[step])[0][:, None]
    return places[:, None] + 0.5 * lasts * (held + u), places[:, None] + lasts * (held + u)


def look_ahead(mapping: Mapping, allowed: Allowed, cov: Array) -> Survey:
    """Return the profiles of the best way found among those that are followed leg by leg to the end.

    Args:
        mapping: What is to be mapped.
        allowed: Which legs may be flown.
        cov: shape (n, n), of the unknowns at the start, after the profiles of others.
    """
    end_ns = mapping.known.time_ns + round(float(mapping.times[-1]) * 1e9)
    loading, modes = mapping.known.loading(end_ns), mapping.known.modes(mapping.box)
    box = np.concatenate(
        [(modes @ loading[:, which].T).reshape(-1, len(loading)) for which in mapping.which]
    )
    search, ways = _Search(mapping, box, allowed), [_Way(mapping.start, cov, 0.0)]
    for step in range(mapping.times.size - 1):
        ways = search.next_ways(ways, step)
        if not ways:
            raise PlanError(
                "no way leads on: land, areas or the edge of the region are all around; choose another start or fewer profiles"
            )
    way = ways[0]
    middles, ends = np.array([way.middles]), np.array([way.ends])
    return Survey(ends, ends, middles, mapping.profile_times, np.ones(1, dtype=bool))


def refined(mapping: Mapping, allowed: Allowed, survey: Survey, seed: int) -> tuple[Survey, float]:
    """Return a better way nearby, and its error [m/s]: single legs are turned, alone or with the next turned back, while that helps.

    Args:
        mapping: What is to be mapped.
        allowed: Which legs may be flown.
        survey: One, that may be flown.
        seed: Of the turns that are tried.
    """
    rng, n_legs = np.random.default_rng(seed), survey.times.size
    nodes = np.concatenate([[mapping.start], survey.ends[0]])
    lasts = np.diff(mapping.times)
    held = np.diff(nodes) / lasts - np.array(
        [complex(mapping.mean.at(nodes[k : k + 1], survey.times[k])[0]) for k in range(n_legs)]
    )
    error = np.inf
    best, spread = survey, _TURN
    for turn in range(_TURNS + 1):
        tried = _turned(held, spread, rng, COUNTED * mapping.speed) if turn else held[None]
        made, free = _flown_with(mapping, allowed, tried)
        if not free.any():
            continue
        errors = np.where(free, mapping.errors(made), np.inf)
        k = int(np.argmin(errors))
        if errors[k] < error:
            error, held, best = float(errors[k]), tried[k], made.picked([k])
        else:
            spread = max(0.8 * spread, 0.05)
    return best, error


def _turned(held: Complex, spread: float, rng: np.random.Generator, speed: float) -> Complex:
    """Return velocities through water, shape (N,), with one leg turned, in half of the tries the next one back, and half at full speed."""
    tried, tries = np.repeat(held[None], _TRIES, axis=0), np.arange(_TRIES)
    legs, angles, full = (
        rng.integers(0, held.size, _TRIES),
        spread * rng.standard_normal(_TRIES),
        rng.random(_TRIES) < 0.5,
    )
    tried[tries, legs] *= np.exp(1j * angles)
    back = (rng.random(_TRIES) < 0.5) & (legs + 1 < held.size)
    tried[tries[back], legs[back] + 1] *= np.exp(-1j * angles[back])
    chosen = tried[tries, legs]
    size = np.where(full, speed, np.minimum(np.abs(chosen), speed))
    tried[tries, legs] = chosen * size / np.maximum(np.abs(chosen), 1e-9)
    return tried * np.minimum(1.0, speed / np.maximum(np.abs(tried), 1e-9))


def _flown_with(mapping: Mapping, allowed: Allowed, held: Complex) -> tuple[Survey, Array]:
    """Return the ways of velocities through water held leg by leg, shape (C, N), and which of them may be flown."""
    places = np.empty((len(held), mapping.times.size), dtype=np.complex128)
    places[:, 0] = mapping.start
    for k, lasts in enumerate(np.diff(mapping.times)):
        current = mapping.mean.at(places[None, :, k], mapping.profile_times[k])[0]
        places[:, k + 1] = places[:, k] + lasts * (held[:, k] + current)
    begins, ends = places[:, :-1], places[:, 1:]
    free = np.all(allowed(begins.ravel(), ends.ravel()).reshape(ends.shape), axis=1)
    return Survey(ends, ends, 0.5 * (begins + ends), mapping.profile_times, free), free
