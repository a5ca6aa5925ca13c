"""Positions in order of time, as readers gather them before messages are made of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Positions:
    """Places of a vehicle.

    Attributes:
        time_ns: shape (n,) [ns, UTC], increasing.
        longitude: shape (n,) [degrees east].
        latitude: shape (n,) [degrees north].
    """

    time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array
