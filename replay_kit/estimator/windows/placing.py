"""Where windows lie, around vehicles and ahead of them, and which vehicle each follows."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.region import (
    DEGREE,
    Region,
    centre,
    degree_of_longitude,
    inside,
    rounded,
    width,
)
from replay_kit.estimator.state import State


@dataclass(frozen=True, slots=True, eq=False)
class WindowedState:
    """The estimates in the windows that follow vehicles, and the last ones of those that all left, until they are forgotten.

    Attributes:
        states: Of the estimators of windows that follow a vehicle, in the order in which these began.
        where: The window of each vehicle, from its first measurement on.
        left: Windows that were left and their last states, in order; those forgotten are not among them.
        number: Of windows so far.
        loss: Largest root mean square so far of the information on the next window that was not handed over [m/s].
        strays: Of a vehicle, how many measurements in a row lay outside its window; none where the last one did not.
        unusable: Windows that could not be made, each with the reason.
    """

    states: Mapping[Region, State] = field(default_factory=dict)
    where: Mapping[int, Region] = field(default_factory=dict)
    left: tuple[tuple[Region, State], ...] = ()
    number: int = 0
    loss: float = 0.0
    strays: Mapping[int, int] = field(default_factory=dict)
    unusable: Mapping[Region, str] = field(default_factory=dict)

    def holding(self, place: tuple[float, float], bounds: Region, least: float) -> Region | None:
        """Return the window that holds a place farthest from its sides; None where none holds it so far from them.

        Args:
            place: Longitude and latitude [degrees].
            bounds: The forecast's box.
            least: Distance from the sides [m].
        """
        rooms = {region: room_in(region, bounds, place) for region in self.states}
        found = max(rooms, key=rooms.__getitem__, default=None)
        return found if found is not None and rooms[found] >= least else None

    def entered(self, vehicle: int, region: Region, begun: State) -> "WindowedState":
        """Return the state with a vehicle in a window, one of these, or a new one in its first state; that it was alone in is left."""
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
        """Return the state with how many measurements in a row lay outside a vehicle's window."""
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
    """Return the window that a vehicle needs that nears the side of its own; None where it does not, or where none has more room.

    It is as large as the one before and lies ahead: the way from the middle of the window before to the vehicle goes on. At the side of the
    forecast it is moved into it.

    Args:
        region: The window.
        margin: Distance from the vehicle to a window's sides that an estimate needs [m]; nearer than half of it is near.
        bounds: The forecast's box.
        place: Longitude and latitude of the vehicle [degrees].
    """
    room = room_in(region, bounds, place)
    if room >= 0.5 * margin or not inside(bounds, *place):
        return None
    (x, y), half = centre(region), np.array([width(region), region[3] - region[1]]) / 2.0
    at, ahead = (
        np.array([float(unwrap_longitude(place[0], x)) - x, place[1] - y]) / half,
        np.zeros(2),
    )
    if room >= 0.0:
        behind = _BEHIND * margin / np.array([degree_of_longitude(y), DEGREE])
        ahead = np.maximum(half - behind, 0.0) * at / np.abs(at).max()
    found = moved_into(bounds, place + ahead, half)
    return found if room_in(found, bounds, place) > room + _MORE * margin else None


def room_in(region: Region, bounds: Region, place: tuple[float, float]) -> float:
    """Return how far a place lies from the nearest side of a window that is not the forecast's own [m]; negative outside it."""
    (x, y), half = centre(region), np.array([width(region), region[3] - region[1]]) / 2.0
    at = np.array([float(unwrap_longitude(place[0], x)) - x, place[1] - y])
    rooms = np.array([half + at, half - at]) * [degree_of_longitude(y), DEGREE]
    # of the west, south, east and north side from the forecast's
    inwards = (np.array(region) - bounds).reshape(2, 2) * [[1.0], [-1.0]]
    inwards[:, 0] = (inwards[:, 0] + 180.0) % 360.0 - 180.0 if width(bounds) < 360.0 else np.inf
    return float(rooms[inwards > _SAME].min(initial=np.inf))


def moved_into(bounds: Region, middle: ArrayLike, half: Array) -> Region:
    """Return a window about a place, shape (2,), of half a width and height, moved into a box where it reaches beyond it [degrees]."""
    x, (east, north) = centre(bounds), np.asarray(middle, np.float64)
    room = np.maximum(np.array([width(bounds), bounds[3] - bounds[1]]) / 2.0 - half, 0.0)
    if width(bounds) < 360.0:
        away = float(unwrap_longitude(east, x[0])) - x[0]
        east = x[0] + np.clip(away, -room[0], room[0])
    at = np.array([east, x[1] + np.clip(north - x[1], -room[1], room[1])])
    (west, south), (east, north) = (at - half).tolist(), (at + half).tolist()
    return rounded((west, south, east, north))
