"""Positions of windows around and ahead of vehicles, and the window of each vehicle."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.region import (
    DEGREE,
    Region,
    centre_of,
    degree_of_longitude,
    inside_box,
    rounded_box,
    width_of,
)
from replay_kit.estimator.state import State


@dataclass(frozen=True, slots=True, eq=False)
class WindowedState:
    """Estimates in the windows of vehicles, and the last ones of windows left by all.

    Attributes:
        states: States of windows with a vehicle, in order of their start.
        where: Window of each vehicle, from its first measurement on.
        left: Windows left and their last states, in order, as long as they are kept.
        number: Number of windows so far.
        loss: Largest RMS so far of information not handed over [m/s].
        strays: Consecutive measurements of a vehicle outside its window; no entry for 0.
        unusable: Windows that failed, with the reason.
    """

    states: Mapping[Region, State] = field(default_factory=dict)
    where: Mapping[int, Region] = field(default_factory=dict)
    left: tuple[tuple[Region, State], ...] = ()
    number: int = 0
    loss: float = 0.0
    strays: Mapping[int, int] = field(default_factory=dict)
    unusable: Mapping[Region, str] = field(default_factory=dict)

    def holding(self, place: tuple[float, float], bounds: Region, least: float) -> Region | None:
        """Return the window with a position farthest from its sides; None if that is nearer than ``least``.

        Args:
            place: Longitude and latitude [degrees].
            bounds: Box of the forecast.
            least: Least distance from the sides [m].
        """
        rooms = {region: room_in(region, bounds, place) for region in self.states}
        found = max(rooms, key=rooms.__getitem__, default=None)
        return found if found is not None and rooms[found] >= least else None

    def entered(self, vehicle: int, region: Region, begun: State) -> "WindowedState":
        """Return the state with a vehicle in an existing or new window; a window that it was alone in is left."""
        where = {**self.where, vehicle: region}
        states = {**self.states, region: self.states.get(region, begun)}
        followed = {one: state for one, state in states.items() if one in where.values()}
        left = [(one, state) for one, state in states.items() if one not in followed]
        return replace(
            self.with_strays(vehicle, 0),
            states=followed,
            where=where,
            left=(*self.left, *left),
            number=self.number + (region not in self.states),
        )

    def with_strays(self, vehicle: int, number: int) -> "WindowedState":
        """Return the state with a number of consecutive measurements outside a vehicle's window."""
        if number == self.strays.get(vehicle, 0):
            return self
        strays = {key: count for key, count in {**self.strays, vehicle: number}.items() if count}
        return replace(self, strays=strays)


# Margins between the vehicle and the side of a new window behind it.
_BEHIND = 1.5
# Sides nearer to each other are the same [degrees]: boxes are rounded outwards.
_SAME = 2e-3
# Margins by which a new window must have more room around the vehicle to be worth it.
_MORE = 0.25


def next_window(
    region: Region, margin: float, bounds: Region, place: tuple[float, float]
) -> Region | None:
    """Return the next window of a vehicle near the side of its own; None if it is not, or if none has more room.

    It is as large as the previous one and lies ahead, along the line from its centre to the vehicle. At the edge of the forecast it is
    moved inside.

    Args:
        region: Current window.
        margin: Required distance of the vehicle from a window's sides [m]; less than half of it is near.
        bounds: Box of the forecast.
        place: Longitude and latitude of the vehicle [degrees].
    """
    room = room_in(region, bounds, place)
    if room >= 0.5 * margin or not inside_box(bounds, *place):
        return None
    (x, y), half = centre_of(region), np.array([width_of(region), region[3] - region[1]]) / 2.0
    at = np.array([float(unwrap_longitude(place[0], x)) - x, place[1] - y]) / half
    ahead = np.zeros(2)
    if room >= 0.0:
        behind = _BEHIND * margin / np.array([degree_of_longitude(y), DEGREE])
        ahead = np.maximum(half - behind, 0.0) * at / np.abs(at).max()
    found = moved_into(bounds, place + ahead, half)
    return found if room_in(found, bounds, place) > room + _MORE * margin else None


def room_in(region: Region, bounds: Region, place: tuple[float, float]) -> float:
    """Return the distance of a position from the nearest side of a window inside the forecast [m]; negative outside it."""
    (x, y), half = centre_of(region), np.array([width_of(region), region[3] - region[1]]) / 2.0
    at = np.array([float(unwrap_longitude(place[0], x)) - x, place[1] - y])
    rooms = np.array([half + at, half - at]) * [degree_of_longitude(y), DEGREE]
    # of the west, south, east and north side from the forecast's
    inwards = (np.array(region) - bounds).reshape(2, 2) * [[1.0], [-1.0]]
    inwards[:, 0] = (inwards[:, 0] + 180.0) % 360.0 - 180.0 if width_of(bounds) < 360.0 else np.inf
    return float(rooms[inwards > _SAME].min(initial=np.inf))


def moved_into(bounds: Region, middle: ArrayLike, half: Array) -> Region:
    """Return a window about a position, shape (2,), of half a width and height, moved into a box [degrees]."""
    x, (east, north) = centre_of(bounds), np.asarray(middle, np.float64)
    room = np.maximum(np.array([width_of(bounds), bounds[3] - bounds[1]]) / 2.0 - half, 0.0)
    if width_of(bounds) < 360.0:
        away = float(unwrap_longitude(east, x[0])) - x[0]
        east = x[0] + np.clip(away, -room[0], room[0])
    at = np.array([east, x[1] + np.clip(north - x[1], -room[1], room[1])])
    (west, south), (east, north) = (at - half).tolist(), (at + half).tolist()
    return rounded_box((west, south, east, north))
