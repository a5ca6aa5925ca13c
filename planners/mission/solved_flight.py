"""The legs of a solution flown densely: all at once, as it is known to some metres where each begins."""

from functools import lru_cache

import numpy as np

from planners.mission.flight import Currents, Flight, Legs, fly_legs
from planners.mission.program import MissionSolution
from planners.shooting.flight import fly_together
from planners.shooting.frames import FrameMap
from planners.shooting.schedule import DRIFT_STEPS, schedule_of
from planners.shooting.stream import stream_of
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Projection


def fly_solution(
    currents: Currents,
    vehicle: Glider,
    start: Array,
    legs: Legs,
    start_time: float,
    solution: MissionSolution,
) -> Flight:
    """Return the flight of the legs of a solution, as ``fly_legs`` does to a thousandth of a millimetre.

    Args:
        currents: One flow.
        vehicle: The glider.
        start: shape (2,) [m].
        legs: Its commands.
        start_time: On the clock of the currents' times [s].
        solution: Where its legs begin and end.
    """
    flow, adrift, guess = currents.flow, bool(np.any(legs.drifts)), solution.guess
    schedule = schedule_of(
        legs.depths, legs.drifts, adrift, flow.levels, flow.depth_functions, currents.times
    )
    begins = np.column_stack([np.vstack([start, guess.places[:-1]]), legs.headings, legs.angles])
    frames = _frames(flow.grid.projection, vehicle, len(begins))
    flown = fly_together(
        stream_of(flow, currents.latent[0]),
        schedule,
        frames,
        (begins, start_time),
        solution.through,
    )
    if flown is None:
        return fly_legs(currents, vehicle, start, legs, start_time)
    places, times = flown
    # each leg but the first begins where and when the one before it ends; one without a drift has no steps adrift
    kept = np.full(places.shape[:2], True)
    kept[1:, 0] = False
    kept[legs.drifts <= 0.0, schedule.n_wet + 1 :] = False
    depths = np.concatenate(
        [np.array(legs.depths), np.zeros((len(begins), DRIFT_STEPS * int(adrift)))], axis=1
    )
    number = np.broadcast_to(np.arange(len(begins))[:, None], kept.shape)
    return Flight(
        times[kept] - start_time,
        depths[kept],
        places[kept][None],
        number[kept],
        np.cumsum(kept.sum(axis=1)) - 1,
    )


@lru_cache(maxsize=64)
def _frames(projection: Projection, vehicle: Glider, count: int) -> FrameMap:
    return FrameMap(projection, vehicle, count)
