"""GeoJSON after RFC 7946: positions that are continuous across the antimeridian, features of one geometry, collections of them."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude

Feature = dict[str, Any]
# Decimals of a position: a centimetre.
_DIGITS = 7


def positions(longitude: ArrayLike, latitude: ArrayLike, near: float) -> list[list[float]]:
    """Return positions, their longitudes within 180 degrees of ``near``, or a map draws a line around the world."""
    continuous = unwrap_longitude(np.asarray(longitude, dtype=np.float64), near)
    found: list[list[float]] = (
        np.column_stack([continuous, np.asarray(latitude, dtype=np.float64)])
        .round(_DIGITS)
        .tolist()
    )
    return found


def feature(kind: str, coordinates: Any, properties: Mapping[str, Any]) -> Feature:
    """Return a feature of one geometry."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def cut_at_antimeridian(one: Feature) -> Feature:
    """Return a feature whose longitudes are within 180 degrees: a line or a polygon across the antimeridian is cut there.

    Args:
        one: Of continuous positions: a point, several, a line, or a polygon without holes that is convex where it crosses.

    References: RFC 7946, 3.1.9.
    """
    kind, coordinates = one["geometry"]["type"], one["geometry"]["coordinates"]
    at = np.atleast_2d(np.array(coordinates[0] if kind == "Polygon" else coordinates, dtype=float))
    # revolutions by which a part of it is off
    turns = np.unique(np.floor((at[:, 0] + 180.0) / 360.0))
    if np.array_equal(turns, [0.0]):
        return one
    if "Point" in kind:
        at[:, 0] = (at[:, 0] + 180.0) % 360.0 - 180.0
        moved = at.round(_DIGITS).tolist()
        return feature(kind, moved if kind == "MultiPoint" else moved[0], one["properties"])
    parts = [_within(at, 360.0 * turn, kind == "LineString") for turn in turns]
    lists = [part.round(_DIGITS).tolist() for part in parts if len(part) > 1]
    if kind == "Polygon":
        lists = [[[*part, part[0]] if part[0] != part[-1] else part] for part in lists]
    many = len(lists) > 1
    return feature(f"Multi{kind}" if many else kind, lists if many else lists[0], one["properties"])


def _within(at: Array, middle: float, is_line: bool) -> Array:
    """Return the part of a line or ring, shape (n, 2) [degrees], within 180 degrees of a longitude, as about longitude 0."""
    for side, sign in ((middle - 180.0, 1.0), (middle + 180.0, -1.0)):
        inside, found = sign * (at[:, 0] - side) >= 0.0, list[Array]()
        for k in range(len(at)):
            if (k or not is_line) and inside[k] != inside[k - 1]:
                share = (side - at[k - 1, 0]) / (at[k, 0] - at[k - 1, 0])
                found.append(np.array([side, at[k - 1, 1] + share * (at[k, 1] - at[k - 1, 1])]))
            if inside[k]:
                found.append(at[k])
        at = np.array(found).reshape(-1, 2)
    return at - [middle, 0.0]


def collection_text(features: Sequence[Feature], indent: int | None = None) -> str:
    """Return features as a text; figures that are not numbers raise ValueError."""
    return json.dumps(
        {"type": "FeatureCollection", "features": features}, indent=indent, allow_nan=False
    )
