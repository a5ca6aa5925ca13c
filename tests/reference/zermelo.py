"""Zermelo's quickest path in a uniform current."""

import numpy as np

from replay_kit.core.arrays import Array


def time_in_uniform_current(way: Array, current: Array, speed: float) -> float:
    """Return the least time [s] along a way (2,) [m] in a current (2,) [m/s] slower than the vehicle."""
    length = float(np.hypot(*way))
    along = float(way @ current) / length
    return length / (along + float(np.sqrt(speed**2 - current @ current + along**2)))
