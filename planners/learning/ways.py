"""Missions that are planned anew at each surfacing, in samples: straight ahead, or by a detour that would learn something.

At each surfacing the estimate is updated with all profiles so far, the quickest of some arcs to the goal in the current then known is
chosen, and the vehicle follows its beginning to the next surfacing. What going straight learns counts for it in full.
"""

from dataclasses import dataclass, replace

import numpy as np

from planners.learning.closed_loop import Sea
from planners.learning.current import Complex
from planners.learning.rows import Rows, gains, learnt, rows_at
from replay_kit.core.arrays import Array

#: A goal is passed at this distance [m].
PASSED = 1_500.0
# Bows of the arcs as shares of the way, points along each, parts of a leg at which a passage is looked for.
_BOWS, _POINTS, _PARTS = np.array([0.0, 0.15, -0.15, 0.3, -0.3]), 6, 6
# Least speed over ground that an arc counts on [m/s].
_LEAST = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Voyage:
    """Missions to be flown, one a sample.

    Attributes:
        start: [m].
        goal: [m].
        begin: [s].
        speed: Greatest through water [m/s].
        leg_time: [s].
        most: Legs after which it is given up.
        error: Standard deviation of a profile's mean current [m/s].
    """

    start: complex
    goal: complex
    begin: float
    speed: float
    leg_time: float
    most: int
    error: float


@dataclass(frozen=True, slots=True, eq=False)
class _Log:
    """What the profiles so far say: their rows, and what they measured beyond the mean."""

    rows: Rows | None
    values: Array

    def with_profile(self, rows: Rows, values: Array) -> "_Log":
        if self.rows is None:
            return _Log(rows, values)
        parts = tuple(
            (scale, np.concatenate([one, more], axis=-2))
            for (scale, one), (_, more) in zip(self.rows.parts, rows.parts, strict=True)
        )
        now, after = (
            np.concatenate([self.rows.now, rows.now], axis=-2),
            np.concatenate([self.rows.after, rows.after], axis=-1),
        )
        return _Log(
            replace(rows, now=now, parts=parts, after=after),
            np.concatenate([self.values, values], axis=-1),
        )


def fly_voyage(
    sea: Sea, voyage: Voyage, noise: Array, via: complex | None = None, learns: bool = True
) -> Array:
    """Return the times of arrival [s] in each true current, shape (S,); that of being given up where a mission does not arrive.

    Args:
        sea: What it is flown in.
        voyage: The mission.
        noise: shape (S, most, 2) of unit variance, errors of the profiles.
        via: A place that it passes first [m]; None for straight ahead.
        learns: Whether its profiles count.
    """
    place, log = np.full(sea.count, voyage.start), _Log(None, np.zeros((sea.count, 0)))
    arrival = np.full(sea.count, voyage.most * voyage.leg_time)
    under_way, passed = np.ones(sea.count, dtype=bool), np.full(sea.count, via is None)
    reach = 0.7 * voyage.speed * voyage.leg_time
    for leg in range(voyage.most):
        time = voyage.begin + leg * voyage.leg_time
        if via is not None:
            passed |= np.abs(place - via) < reach
        targets = np.where(passed, voyage.goal, voyage.goal if via is None else via)
        held = _steered(sea, voyage, log, (place, targets, time))
        track = _flown(sea, voyage, place, held, time)
        near = np.abs(track - voyage.goal) <= PASSED
        now = under_way & near.any(axis=0)
        first = np.argmax(near, axis=0) + 1
        arrival[now] = (leg + first[now] / _PARTS) * voyage.leg_time
        under_way &= ~now
        if not under_way.any():
            break
        if learns:
            middle, when = track[_PARTS // 2 - 1], np.array([time + 0.5 * voyage.leg_time])
            met = sea.truth.at(middle, when[0]) - sea.mean.at(middle[None], when[0])[0]
            values = np.stack([met.real, met.imag], axis=-1) + voyage.error * noise[:, leg]
            log = log.with_profile(
                rows_at(sea.known, np.stack([middle.real, middle.imag], axis=-1)[:, None], when),
                values,
            )
        place = track[-1]
    return arrival


def _flown(sea: Sea, voyage: Voyage, place: Complex, held: Complex, time: float) -> Complex:
    """Return places along a leg in the true currents, shape (parts, S) [m]."""
    step, track = voyage.leg_time / _PARTS, list[Complex]()
    for part in range(_PARTS):
        half = place + 0.5 * step * (held + sea.truth.at(place, time + part * step))
        place = place + step * (held + sea.truth.at(half, time + (part + 0.5) * step))
        track.append(place)
    return np.stack(track)


def _steered(sea: Sea, voyage: Voyage, log: _Log, where: tuple[Complex, Complex, float]) -> Complex:
    """Return the velocity through water, shape (S,), along the beginning of the quickest arc in the current that is known."""
    place, goal, time = where
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    way = goal - place
    bow = 4.0 * _BOWS[:, None] * share * (1.0 - share)
    slope = 4.0 * _BOWS[:, None] * (1.0 - 2.0 * share)
    points = place[:, None, None] + way[:, None, None] * (share + 1j * bow)
    tangent = way[:, None, None] * (1.0 + 1j * slope)
    u = _known_at(sea, log, points.reshape(len(place), -1), time, voyage.error).reshape(
        points.shape
    )
    along, through = _over_ground(u, tangent, voyage.speed)
    spent = np.sum(np.abs(tangent) / _POINTS / np.maximum(along, _LEAST), axis=-1)
    best = np.argmin(spent, axis=1)
    held = through[np.arange(len(place)), best, 0]
    # near the goal the leg ends there
    needed = way / voyage.leg_time - u[:, 0, 0]
    return np.asarray(np.where(np.abs(needed) < voyage.speed, needed, held))


def _over_ground(u: Complex, tangent: Complex, speed: float) -> tuple[Array, Complex]:
    """Return the speed over ground along tangents, and the velocity through water that gives it."""
    unit = tangent / np.maximum(np.abs(tangent), 1e-9)
    turned = u * np.conj(unit)
    ahead = np.sqrt(np.maximum(speed**2 - turned.imag**2, 0.0))
    held = np.where(
        np.abs(turned.imag) < speed, ahead - 1j * turned.imag, -1j * speed * np.sign(turned.imag)
    )
    return ahead + turned.real, held * unit


def _known_at(sea: Sea, log: _Log, points: Complex, time: float, error: float) -> Complex:
    """Return the current that is known at places, shape (S, p) [m/s]."""
    u: Complex = sea.mean.at(points.reshape(1, -1), time)[0].reshape(points.shape)
    if log.rows is None:
        return u
    unknowns = learnt(sea.known, log.rows, gains(log.rows, log.values, error**2), time)
    weights = unknowns @ sea.known.loading(sea.known.time_ns + round(time * 1e9))[:, 0]
    modes = sea.known.modes(np.column_stack([points.real.ravel(), points.imag.ravel()])).reshape(
        *points.shape, 2, -1
    )
    more = np.einsum("spcr,sr->spc", modes, weights, optimize=True)
    return np.asarray(u + more[..., 0] + 1j * more[..., 1])
