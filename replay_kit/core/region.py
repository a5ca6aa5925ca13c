"""Boxes and GeoJSON (RFC 7946) in degrees, also across the antimeridian.

A box is (west, south, east, north), west > east across the antimeridian.
"""

import json
from collections.abc import Mapping, Sequence
from math import ceil, floor
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Grid

Region = tuple[float, float, float, float]
#: Metres a degree of latitude, on a sphere of the Earth's area: boxes are no geodesy.
DEGREE = 111_195.0
# A box is rounded outwards to so many parts of a degree, some 10 m, so that it reads well.
_SHARES = 10_000
# Beyond this latitude a degree of longitude is taken to be no shorter.
_FARTHEST = 89.0


def box_around(places: ArrayLike, margin: float) -> Region:
    """Return the smallest box around positions and a margin.

    Args:
        places: shape (n, 2), n > 0, longitude and latitude [degrees], on either or both sides of the antimeridian.
        margin: Margin [m].
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
    return rounded_box((west, max(south, -90.0), east, min(north, 90.0)))


def bounds_of(grid: Grid) -> Region:
    """Return the smallest box around the points of a grid."""
    return box_around(np.column_stack([grid.longitude.ravel(), grid.latitude.ravel()]), 0.0)


def degree_of_longitude(latitude: float) -> float:
    """Return the length of a degree of longitude at a latitude [m]."""
    return DEGREE * float(np.cos(np.deg2rad(min(abs(latitude), _FARTHEST))))


def rounded_box(region: Region) -> Region:
    """Return a box rounded outwards, its longitudes in -180..180."""
    west, south = (floor(value * _SHARES) / _SHARES for value in region[:2])
    east, north = (ceil(value * _SHARES) / _SHARES for value in region[2:])
    return _wrapped(west), max(south, -90.0), _wrapped(east), min(north, 90.0)


def _wrapped(longitude: float) -> float:
    inside = -180.0 <= longitude <= 180.0
    return longitude if inside else round((longitude + 180.0) % 360.0 - 180.0, 4)


def centre_of(region: Region) -> tuple[float, float]:
    """Return longitude and latitude of the centre of a box [degrees]."""
    return _wrapped(region[0] + 0.5 * width_of(region)), 0.5 * (region[1] + region[3])


def width_of(region: Region) -> float:
    """Return the extent of a box in longitude [degrees]."""
    return (region[2] - region[0]) % 360.0 or 360.0


def depth_inside(region: Region, longitude: ArrayLike, latitude: ArrayLike) -> Array:
    """Return the distance of positions from the nearest side of a box [m]; negative outside it.

    Args:
        region: The box.
        longitude: Any shape [degrees].
        latitude: The same shape.
    """
    middle, latitude = centre_of(region), np.asarray(latitude, dtype=np.float64)
    along = 0.5 * width_of(region) - np.abs(unwrap_longitude(longitude, middle[0]) - middle[0])
    across = np.minimum(latitude - region[1], region[3] - latitude)
    return np.asarray(np.minimum(along * degree_of_longitude(middle[1]), across * DEGREE))


def inside_box(region: Region, longitude: ArrayLike, latitude: ArrayLike) -> Mask:
    """Return whether positions lie in a box; arguments as in ``depth_inside``."""
    return np.asarray(depth_inside(region, longitude, latitude) >= 0.0)


def box_text(region: Region) -> str:
    """Return a box as text."""
    west, south, east, north = region
    return f"{west:g}..{east:g} E, {south:g}..{north:g} N"


Feature = dict[str, Any]
# Decimals of a position: a centimetre.
_DIGITS = 7


def continuous_positions(
    longitude: ArrayLike, latitude: ArrayLike, near: float
) -> list[list[float]]:
    """Return GeoJSON positions with longitudes within 180 degrees of ``near``, so that no line runs around the world."""
    places = np.column_stack([unwrap_longitude(longitude, near), np.asarray(latitude, np.float64)])
    return cast(list[list[float]], places.round(_DIGITS).tolist())


def feature(kind: str, coordinates: Any, properties: Mapping[str, Any]) -> Feature:
    """Return a feature of one geometry."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def cut_at_antimeridian(given: Feature) -> Feature:
    """Return a feature with longitudes in [-180, 180]; lines and polygons are cut at the antimeridian, and lose lists of values.

    Args:
        given: Feature with continuous longitudes: points, a line or a polygon.

    References: RFC 7946, 3.1.9.
    """
    # loads slowly, and most commands write none
    import shapely

    kind, coordinates = given["geometry"]["type"], given["geometry"]["coordinates"]
    whole = shapely.from_geojson(json.dumps(given["geometry"]))
    west, _, east, _ = whole.bounds
    # revolutions by which a part of it is off; what only touches the antimeridian has no part beyond
    first, end = floor((west + 180.0) / 360.0), ceil((east + 180.0) / 360.0)
    turns = range(first, max(end, first + 1))
    if turns == range(1):
        return given
    if "Point" in kind:
        at = np.array(coordinates, dtype=np.float64)
        at[..., 0] = (at[..., 0] + 180.0) % 360.0 - 180.0
        return feature(kind, at.round(_DIGITS).tolist(), given["properties"])
    found = []
    for middle in (360.0 * turn for turn in turns):
        part = whole
        if len(turns) > 1:
            part = shapely.clip_by_rect(whole, middle - 180.0, -90.0, middle + 180.0, 90.0)
        part = shapely.transform(part, lambda at, by=middle: (at - [by, 0.0]).round(_DIGITS))
        for each in shapely.get_parts(part):
            turned = shapely.geometry.polygon.orient(each) if kind == "Polygon" else each
            found.append(json.loads(shapely.to_geojson(turned))["coordinates"])
    if len(found) == 1:
        return feature(kind, found[0], given["properties"])
    # what holds a value for each position of the whole is of none of its parts
    about = {name: value for name, value in given["properties"].items() if type(value) is not list}
    return feature(f"Multi{kind}", found, about)


def collection_file(features: Sequence[Feature]) -> str:
    """Return the text of a GeoJSON file, its features cut at the antimeridian."""
    return collection_text([cut_at_antimeridian(one) for one in features]) + "\n"


def collection_text(features: Sequence[Feature], indent: int | None = None) -> str:
    """Return features as GeoJSON text; ValueError for numbers that are not finite."""
    return json.dumps(
        {"type": "FeatureCollection", "features": features}, indent=indent, allow_nan=False
    )
