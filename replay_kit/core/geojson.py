"""GeoJSON after RFC 7946: positions that are continuous across the antimeridian, features of one geometry, collections of them."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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


def collection_text(features: Sequence[Feature], indent: int | None = None) -> str:
    """Return features as a text; figures that are not numbers raise ValueError."""
    return json.dumps(
        {"type": "FeatureCollection", "features": features}, indent=indent, allow_nan=False
    )
