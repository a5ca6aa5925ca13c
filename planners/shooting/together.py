"""The legs of a solution flown densely all at once, as it is known to some metres where each begins."""

import numpy as np

from planners.shooting.layout import FrameMap
from planners.shooting.paths import Starts, derive, fly_paths
from planners.shooting.schedule import Schedule
from planners.shooting.stream import Stream
from replay_kit.core.arrays import Array

# Legs meet to this [m], within so many rounds.
_MEETS, _ROUNDS = 1e-4, 8


def fly_together(
    stream: Stream,
    schedule: Schedule,
    frames: FrameMap,
    starts: tuple[Array, float],
    through: Array | None,
) -> tuple[Array, Array] | None:
    """Return the places at the beginning of each step and the end of the last, shape (L, N + 1, 2) [m], and their times, (L, N + 1) [s].

    None where the legs do not meet: they are then to be flown one after the other.

    Args:
        stream: Of the flow.
        schedule: Of the legs, whose last is not followed by a drift.
        frames: Of as many legs.
        starts: Where each leg begins, heading and glide angle, shape (L, 4); when the first begins [s]. The first begins exactly there.
        through: shape (L, 2, 2), derivatives of the legs' ends by their beginnings; None where they are not known.
    """
    legs, begin, before = starts[0].copy(), starts[1], np.inf
    if through is None:
        paths = fly_paths(stream, schedule, _timed(schedule, frames, legs, begin))
        through = derive(paths, frames.first(legs, schedule.lengths)).places[:, -1, :, :2]
    for _ in range(_ROUNDS):
        flown = _fly(stream, schedule, _timed(schedule, frames, legs, begin))
        missed = flown[0][:-1, -1] - legs[1:, :2]
        farthest = float(np.max(np.abs(missed), initial=0.0))
        if farthest <= _MEETS:
            return flown
        # a path that is not a number is never nearer
        if not farthest <= before:
            return None
        before = 0.5 * farthest
        moved = np.zeros(2)
        for k, off in enumerate(missed):
            moved = through[k] @ moved + off
            legs[k + 1, :2] += moved
    return None


def _timed(schedule: Schedule, frames: FrameMap, legs: Array, begin: float) -> Starts:
    """Return the starts of legs of which each begins when the one before it ends."""
    coefficients = frames.value(legs, schedule.lengths)
    lasts = schedule.lengths * coefficients[:, -1] + np.sum(
        schedule.steps[:, schedule.n_wet :], axis=1
    )
    return Starts(legs, begin + np.concatenate([[0.0], np.cumsum(lasts[:-1])]), coefficients)


def _fly(stream: Stream, schedule: Schedule, starts: Starts) -> tuple[Array, Array]:
    """Return places and times of the legs, each flown from where it starts."""
    n_legs, n_steps = schedule.steps.shape
    begins = starts.legs[:, :2]
    clock = starts.clock(schedule)
    columns, weights = schedule.columns_at(clock)
    motions = [starts.motion(wet) for wet in (True, False)]
    places = np.empty((n_legs, n_steps + 1, 2))
    places[:, 0] = begins

    def rate(at: Array, step: int, stage: int) -> Array:
        rho, matrix = motions[int(step >= schedule.n_wet)]
        found = stream.derivatives(at, columns[:, step, stage], weights[:, step, stage, :1], 2)[
            :, 0
        ]
        moved = np.concatenate([at - begins, found[:, 0, 1, None], -found[:, 1, 0, None]], axis=1)
        return np.asarray(rho + (matrix @ moved[..., None])[..., 0])

    for i in range(n_steps):
        here, step = places[:, i], schedule.steps[:, i, None]
        first = rate(here, i, 0)
        second = rate(here + 0.5 * step * first, i, 1)
        third = rate(here + 0.5 * step * second, i, 1)
        fourth = rate(here + step * third, i, 2)
        places[:, i + 1] = here + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return places, np.concatenate([clock[:, :, 0], clock[:, -1:, 2]], axis=1)
