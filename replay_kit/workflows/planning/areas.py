"""No-go areas from GeoJSON, and what about them a user should know."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planners import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Grid

_LEAST_CORNERS = 3


def read_areas(path: Path) -> tuple[NoGo, ...]:
    """Return the polygons of a GeoJSON file, and what its lines enclose, as no-go areas.

    A hole counts as part of its area, and heights are left out.

    Raises:
        PlanError: It is not GeoJSON, or holds a geometry that encloses nothing.
    """
    return tuple(
        NoGo(tuple(map(tuple, one.corners.tolist())), one.name, one.surface_only)
        for one in _outlines(path)
    )


def area_notes(path: Path, grid: Grid) -> tuple[str, ...]:
    """Return what about the areas of a file a user of them in a region should know: lines, open or crossing outlines, holes, far away.

    Raises:
        PlanError: An area lies in the region only if its corners are latitude and longitude.
    """
    notes = []
    for outline in _outlines(path):
        name, corners = outline.name, outline.corners
        if outline.of_line:
            notes.append(f"{name}: it is drawn as a line; what the line encloses is forbidden")
        if not np.array_equal(corners[0], corners[-1]):
            notes.append(
                f"{name}: its outline is open; it is closed from the last corner to the first"
            )
        if outline.holes:
            notes.append(f"{name}: its {outline.holes} holes count as part of the area")
        if len(corners) > 3 and not shapely.is_valid(shapely.Polygon(corners)):
            notes.append(
                f"{name}: its outline crosses itself; what it winds around an odd number of times is forbidden"
            )
        if not _overlaps(corners, grid):
            if _overlaps(corners[:, ::-1], grid):
                raise PlanError(
                    f"{path}: {name} has corners such as {corners[0, 0]:g}, {corners[0, 1]:g}, which lie in the region as latitude and "
                    "longitude; GeoJSON has longitude first: swap them"
                )
            notes.append(f"{name}: it lies outside of the region")
    return tuple(notes)


def _overlaps(corners: Array, grid: Grid) -> bool:
    """Return whether the bounds of an area's corners, shape (n, 2) [degrees], overlap those of a region."""
    if np.any(np.abs(corners[:, 1]) > 90.0):
        return False
    longitude = unwrap_longitude(corners[:, 0], float(grid.longitude.mean()))
    low, high = (np.array([pick(grid.longitude), pick(grid.latitude)]) for pick in (np.min, np.max))
    bounds = np.column_stack([longitude, corners[:, 1]])
    return bool(np.all((bounds.min(axis=0) <= high) & (bounds.max(axis=0) >= low)))


@dataclass(frozen=True, slots=True, eq=False)
class _Outline:
    """What a file draws as an area.

    Attributes:
        name: Its name in messages.
        surface_only: Whether only surfacing is forbidden in it.
        corners: shape (n, 2), longitude and latitude [degrees].
        holes: Their number.
        of_line: Whether the file draws it as a line.
    """

    name: str
    surface_only: bool
    corners: Array
    holes: int
    of_line: bool


def _outlines(path: Path) -> list[_Outline]:
    """Return the outlines of a GeoJSON file: a FeatureCollection, a Feature or a geometry alone.

    Raises:
        PlanError: It is not GeoJSON, or holds a geometry that encloses nothing.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    try:
        return [
            outline
            for number, feature in enumerate(_features(_document(content)), 1)
            for outline in _of_feature(feature, number)
        ]
    except _NoAreaError as error:
        raise PlanError(
            f"{path}: expected GeoJSON with polygons of longitude and latitude, or lines around areas, got {error}; convert it with a GIS, "
            "or correct it"
        ) from error


class _NoAreaError(ValueError):
    """What was found instead of areas."""


def _document(content: bytes) -> Any:
    """Return the JSON of a file."""
    try:
        return json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        head = content[:1000].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
        known = (
            (b"<kml" in head, "KML"),
            (head.startswith(b"<"), "XML"),
            (head.startswith(b"pk\x03\x04"), "a zip file, such as KMZ"),
        )
        found = next(
            (name for holds, name in known if holds),
            "nothing" if not head else f"what is no JSON ({str(error)[:100]})",
        )
        raise _NoAreaError(found) from error


def _features(document: Any) -> list[Mapping[str, Any]]:
    """Return the features of a document; a geometry alone is one without properties."""
    kind = _kind(document)
    if kind == "FeatureCollection":
        features = document.get("features")
        if not isinstance(features, list):
            raise _NoAreaError("a FeatureCollection without a list of features")
        for number, feature in enumerate(features, 1):
            if _kind(feature) != "Feature":
                raise _NoAreaError(f"{_kind(feature)} as feature {number}")
        return features
    return [document if kind == "Feature" else {"geometry": document}]


def _kind(value: Any) -> str:
    """Return the GeoJSON type of a value; in words where it states none."""
    if not isinstance(value, Mapping):
        return f"{type(value).__name__} in JSON" if value is not None else "null"
    kind = value.get("type")
    return kind[:50] if isinstance(kind, str) else "an object without a type"


def _of_feature(feature: Mapping[str, Any], number: int) -> Iterator[_Outline]:
    """Yield the outlines of a feature."""
    properties = feature.get("properties") or {}
    if not isinstance(properties, Mapping):
        raise _NoAreaError(f"feature {number} with properties that are no object")
    name, surface_only = (
        str(properties.get("name", f"no-go area {number}")),
        properties.get("surface_only") or False,
    )
    if surface_only not in (True, False):
        raise _NoAreaError(
            f"{name} with surface_only {surface_only!r:.100}, neither true nor false"
        )
    for of_line, rings in _rings(feature.get("geometry"), name):
        yield _Outline(name, bool(surface_only), _corners(rings[0], name), len(rings) - 1, of_line)


def _rings(geometry: Any, name: str) -> Iterator[tuple[bool, list[Any]]]:
    """Yield whether it is a line, and the rings, of each polygon and each line of a geometry."""
    kind = _kind(geometry)
    if kind == "GeometryCollection" and isinstance(geometry.get("geometries"), list):
        for part in geometry["geometries"]:
            yield from _rings(part, name)
        return
    if kind not in ("Polygon", "MultiPolygon", "LineString", "MultiLineString"):
        raise _NoAreaError(f"{kind} as {name}")
    coordinates, of_line = geometry.get("coordinates"), kind.endswith("LineString")
    for part in (
        coordinates if kind.startswith("Multi") and isinstance(coordinates, list) else [coordinates]
    ):
        rings = [part] if of_line else part
        if not isinstance(rings, list) or not rings:
            raise _NoAreaError(f"{name} without corners")
        yield of_line, rings


def _corners(ring: Any, name: str) -> Array:
    """Return the corners of a ring, shape (n, 2) [degrees], heights left out."""
    try:
        corners = np.array([(float(corner[0]), float(corner[1])) for corner in ring]).reshape(-1, 2)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError):
        corners = np.full((1, 2), np.nan)
    if not np.isfinite(corners).all():
        raise _NoAreaError(f"{name} with corners that are not pairs of numbers")
    if len(np.unique(corners, axis=0)) < _LEAST_CORNERS:
        raise _NoAreaError(f"{name} with fewer than {_LEAST_CORNERS} corners")
    return corners
