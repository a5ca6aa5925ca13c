"""The surfacings that a list of waypoints leaves out, one by one."""

import numpy as np

from replay_kit.core.arrays import Array


def farthest_left_out(kept: tuple[int, ...], times: Array, places: Array) -> float:
    """Return how far the place farthest from steady progress between its neighbours in a list is [m].

    Args:
        kept: Numbers of the places in the list; the first place, number 0, counts as in it.
        times: shape (n,) [s], of all places.
        places: shape (n, 2) [m].
    """
    worst = 0.0
    for k in range(len(times)):
        before, after = max(n for n in (0, *kept) if n <= k), min(n for n in (0, *kept) if n >= k)
        if after > before:
            share = (times[k] - times[before]) / (times[after] - times[before])
            off = places[before] * (1 - share) + places[after] * share - places[k]
            worst = max(worst, float(np.linalg.norm(off)))
    return worst
