"""Domain of a plan: the wet region of the forecast's grid, between the surface and the greatest depth."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import inside_grid, to_local, wet_above
from replay_kit.core.grid import Grid
from replay_kit.core.plan import Place

#: Depths of dives at most, in those of the deepest level.
BEYOND = 2.0


@dataclass(frozen=True, eq=False)
class Region:
    """Water covered by a grid.

    Attributes:
        grid: Grid.
        limit: Greatest depth of the vehicle [m].
    """

    grid: Grid
    limit: float = inf

    @property
    def known(self) -> float:
        """Greatest depth of a start or goal [m]: the deepest level or the vehicle's limit."""
        return min(float(self.grid.levels[-1]), self.limit)

    @property
    def deepest(self) -> float:
        """Greatest depth of a dive [m]: at most twice the deepest level, with the current extrapolated as constant."""
        return min(BEYOND * float(self.grid.levels[-1]), self.limit)

    def floor(self, depth: float) -> str:
        """Return the description of a greatest depth for messages."""
        if depth == self.limit:
            return f"the vehicle's limit, {depth:g} m"
        twice = "" if depth == self.known else "twice "
        return f"{twice}the deepest level, {self.grid.levels[-1]:g} m"


def widened(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return a mask, shape (J, I), dilated by a number of rows and columns."""
    # as scipy's maximum_filter, which loads slowly
    for axis in (0, 1):
        around = [(by + 1, by) if axis == own else (0, 0) for own in (0, 1)]
        count = np.cumsum(np.pad(mask, around), axis=axis, dtype=np.int32)
        count = count.swapaxes(0, axis)
        mask = (count[2 * by + 1 :] > count[: -2 * by - 1]).swapaxes(0, axis)
    return mask


def locate(region: Region, place: Place, role: str) -> Array:
    """Return a position in the local frame, shape (3,) [m]: east, north, depth.

    Args:
        region: Region that must contain it.
        place: Position.
        role: Role in the message, ``start`` or ``goal``.

    Raises:
        PlanError: The position is outside the region, above the surface, too deep, or on land.
    """
    where = f"{role} at {place.longitude:.5f}, {place.latitude:.5f}, {place.depth:g} m"
    if not np.all(np.isfinite([place.longitude, place.latitude, place.depth])):
        raise PlanError(f"{where}: expected three finite numbers, longitude, latitude and depth")
    east, north = to_local(region.grid.projection, place.longitude, place.latitude)
    point = np.array([float(east), float(north), place.depth])
    # Checked for finiteness as well: the projection answers infinity for places on the far side of the Earth.
    if not np.all(np.isfinite(point)) or not inside_grid(region.grid, point[0], point[1]):
        raise PlanError(
            f"{where} is outside the forecast's region {_bounds(region.grid)}; "
            + (
                _swapped(region.grid, place)
                or "choose a place inside it or a forecast that covers it"
            )
        )
    if not 0.0 <= place.depth <= region.known:
        raise PlanError(
            f"{where} is not between the surface and {region.floor(region.known)}; choose a depth within them"
        )
    if not wet_above(region.grid, point):
        raise PlanError(
            f"{where} is on land in the forecast: the nearest grid point is dry there; choose a place in water {_bounds(region.grid)}"
        )
    return point


def locate_all(region: Region, start: Place, goals: Sequence[Place]) -> dict[str, Array]:
    """Return the start and the goals in the local frame, shape (3,) [m] each, by role.

    Raises:
        PlanError: One of them is not in the region's water, see ``locate``.
    """
    names = [f"goal {k + 1}" for k in range(len(goals))] if len(goals) > 1 else ["goal"]
    places = zip(["start", *names], [start, *goals], strict=True)
    return {name: locate(region, place, name) for name, place in places}


def _swapped(grid: Grid, place: Place) -> str:
    """Return a hint that longitude and latitude are swapped; empty if the swapped position is outside too."""
    east, north = to_local(grid.projection, place.latitude, place.longitude)
    if (
        abs(place.longitude) > 90.0
        or not np.isfinite([east, north]).all()
        or not inside_grid(grid, float(east), float(north))
    ):
        return ""
    return f"did you mean {place.latitude:g},{place.longitude:g},{place.depth:g}? Longitude is the first number"


def _bounds(grid: Grid) -> str:
    west = grid.longitude.min()
    south = grid.latitude.min()
    east = grid.longitude.max()
    north = grid.latitude.max()
    return f"(west, south, east, north: {west:.3f}, {south:.3f}, {east:.3f}, {north:.3f})"
