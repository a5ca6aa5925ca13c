"""Members brought together as one array, which lies on disk where it is larger than memory."""

from dataclasses import replace

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import IN_MEMORY, Array, release
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.forecast.grid import grid_to_local, true_to_local
from replay_kit.forecast.layout import Layout
from replay_kit.forecast.selection import Selected
from replay_kit.forecast.window import Window, window_size

# Members read, and turned, at once [bytes].
_GROUP = 1 << 28


def in_groups(field: Selected, layout: Layout, config: ForecastConfig) -> list[Selected]:
    """Return members of one file in groups that are read one after the other; in one where they fit into memory.

    What is land by its constant value is found in each group by itself, as in each of several files.
    """
    size = (
        0
        if field.member is None or field.extra
        else window_size(field.ds, layout, config, str(field.part.paths[0]))
    )
    if size <= IN_MEMORY:
        return [field]
    step = max(1, _GROUP * len(field.labels) // size)
    parts = [slice(start, start + step) for start in range(0, len(field.labels), step)]
    return [
        replace(field, ds=field.ds.isel({field.member: part}), labels=field.labels[part])
        for part in parts
    ]


def in_local_frame(window: Window, projection: Projection) -> Array:
    """Return a window's velocities along the axes of a local frame."""
    if window.axes == "true":
        return true_to_local(projection, window.longitude, window.latitude, window.velocity)
    east, north = to_local(
        projection, unwrap_longitude(window.longitude, projection.longitude), window.latitude
    )
    return grid_to_local(east, north, window.velocity)


class MemberStore:
    """Members that come one after the other: some are turned at a time, since the turn of many costs little more than that of one."""

    def __init__(self, velocity: Array, window: Window, projection: Projection) -> None:
        """Start an array of members.

        Args:
            velocity: shape (E, 2, Z, J, I) [m/s], to be filled in order.
            window: Grid and axes of members that are still to be turned.
            projection: The local frame.
        """
        self._velocity, self._window, self._projection = velocity, window, projection
        self._filled, self._waiting = 0, list[tuple[int, Array]]()

    def add(self, values: Array, turned: bool) -> None:
        """Add members, shape (n, 2, Z, J, I), along the window's axes, or turned to those of the local frame."""
        if turned:
            self._velocity[self._filled : self._filled + len(values)] = values
        else:
            self._waiting.append((self._filled, values))
            if sum(each.nbytes for _, each in self._waiting) > _GROUP // 2:
                self._turn()
        self._filled += len(values)

    def finished(self) -> Array:
        """Return all members in the local frame."""
        self._turn()
        return self._velocity

    def _turn(self) -> None:
        if self._waiting:
            together = replace(
                self._window, velocity=np.concatenate([values for _, values in self._waiting])
            )
            done, local = 0, in_local_frame(together, self._projection)
            for start, values in self._waiting:
                self._velocity[start : start + len(values)] = local[done : done + len(values)]
                done += len(values)
            self._waiting.clear()
            release(self._velocity)
