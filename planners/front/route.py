"""A route: places and times."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A way from a start to a goal, or as near to it as can be reached.

    Attributes:
        points: shape (n, 2) [m], local east and north.
        times: shape (n,) [s], when each is reached, since the beginning.
        arrives: Whether it ends at its goal; otherwise at the point nearest to it that can be reached.
    """

    points: Array
    times: Array
    arrives: bool

    def at(self, times: Array) -> Array:
        """Return the points, shape (m, 2) [m], of times [s]."""
        return np.column_stack([np.interp(times, self.times, self.points[:, i]) for i in (0, 1)])
