"""CSV and GeoJSON texts, whatever their rows and features are."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

from replay_kit.core.geodesy import unwrap_longitude

Feature = dict[str, Any]


def csv_text(rows: Sequence[Mapping[str, Any]], empty: str) -> str:
    """Return rows of the same names as CSV with a header line; without rows the header is ``empty``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [empty], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def position(longitude: float, latitude: float, near: float) -> list[float]:
    """Return a GeoJSON position, its longitude within 180 degrees of ``near``, or a map draws a line around the world."""
    return [round(float(unwrap_longitude(longitude, near)), 7), round(float(latitude), 7)]


def feature(kind: str, coordinates: Any, properties: Mapping[str, Any]) -> Feature:
    """Return a GeoJSON feature of one geometry."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def collection_text(features: Sequence[Feature]) -> str:
    """Return features as a GeoJSON text; figures that are not numbers raise ValueError."""
    return json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False)
