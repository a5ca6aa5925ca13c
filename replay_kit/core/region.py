"""Boxes of longitude and latitude: (west, south, east, north) in degrees, west > east across the antimeridian."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude

Region = tuple[float, float, float, float]
#: Metres a degree of latitude, on a sphere of the Earth's area: boxes are no geodesy.
DEGREE = 111_195.0
# A box is rounded outwards to so many digits, some 10 m, so that it reads well.
_DIGITS = 4
# Beyond this latitude a degree of longitude is taken to be no shorter.
_FARTHEST = 89.0


def around(places: ArrayLike, margin: float) -> Region:
    """Return the smallest box that holds places and a margin around them.

    Args:
        places: shape (n, 2), n > 0, longitude and latitude [degrees]; places on both sides of the antimeridian give a box across it.
        margin: [m].
    """
    longitude, latitude = np.asarray(places, dtype=np.float64).T
    directions = np.exp(1j * np.deg2rad(longitude))
    middle = float(np.rad2deg(np.angle(directions.mean())))
    unwrapped = unwrap_longitude(longitude, middle)
    south, north = float(latitude.min()) - margin / DEGREE, float(latitude.max()) + margin / DEGREE
    across = margin / degree_of_longitude(max(abs(south), abs(north)))
    west, east = float(unwrapped.min()) - across, float(unwrapped.max()) + across
    if east - west >= 360.0:
        west, east = -180.0, 180.0
    return rounded((west, max(south, -90.0), east, min(north, 90.0)))


def degree_of_longitude(latitude: float) -> float:
    """Return the length of a degree of longitude at a latitude [m]."""
    return DEGREE * float(np.cos(np.deg2rad(min(abs(latitude), _FARTHEST))))


def rounded(region: Region) -> Region:
    """Return a box rounded outwards, its longitudes in -180..180."""
    west, south, east, north = region
    scale = 10.0**_DIGITS
    outwards = [
        np.floor(west * scale),
        np.floor(south * scale),
        np.ceil(east * scale),
        np.ceil(north * scale),
    ]
    west, south, east, north = (round(float(value) / scale, _DIGITS) for value in outwards)
    return _wrapped(west), max(south, -90.0), _wrapped(east), min(north, 90.0)


def _wrapped(longitude: float) -> float:
    return (
        longitude
        if -180.0 <= longitude <= 180.0
        else round((longitude + 180.0) % 360.0 - 180.0, _DIGITS)
    )


def centre(region: Region) -> tuple[float, float]:
    """Return the longitude and latitude in the middle of a box [degrees]."""
    return _wrapped(region[0] + 0.5 * width(region)), 0.5 * (region[1] + region[3])


def width(region: Region) -> float:
    """Return how far a box reaches from west to east [degrees]."""
    return (region[2] - region[0]) % 360.0 or 360.0


def depth_inside(region: Region, longitude: ArrayLike, latitude: ArrayLike) -> Array:
    """Return how far places lie inside a box, from its nearest side [m]; negative outside it.

    Args:
        region: The box.
        longitude: Any shape [degrees].
        latitude: The same shape.
    """
    middle, latitude = centre(region), np.asarray(latitude, dtype=np.float64)
    along = 0.5 * width(region) - np.abs(unwrap_longitude(longitude, middle[0]) - middle[0])
    across = np.minimum(latitude - region[1], region[3] - latitude)
    return np.asarray(np.minimum(along * degree_of_longitude(middle[1]), across * DEGREE))


def inside(region: Region, longitude: ArrayLike, latitude: ArrayLike) -> NDArray[np.bool_]:
    """Return whether places lie in a box; arguments as in ``depth_inside``."""
    return np.asarray(depth_inside(region, longitude, latitude) >= 0.0)


def text(region: Region) -> str:
    """Return a box in words."""
    west, south, east, north = region
    return f"{west:g}..{east:g} E, {south:g}..{north:g} N"
