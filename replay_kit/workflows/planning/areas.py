"""No-go areas and fences from GeoJSON and KML, with notes for the user.

KML is converted to GeoJSON features. References: RFC 7946; OGC 12-007r2, KML 2.3.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import shapely

from planners.hazards.areas import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.files.inputs import open_input
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Grid
from replay_kit.core.words.quantities import parse_time

# Of KML, in which all values are words.
_WORDS: dict[Any, bool] = {"true": True, "1": True, "false": False, "0": False}
# What a file of areas may take in memory [bytes], and each of its marks: a list, a tag, a value.
_MOST_BYTES, _OF_MARKS = 80_000_000, {b"[": 64, b"{": 256, b"<": 128, b",": 40}
# How files begin that are often given instead.
_OTHERS = {
    b"<": "XML",
    b"PK\x03\x04": "a zip file, such as KMZ",
    b"SQLite format 3": "a database, such as a GeoPackage",
}


class _NoAreaError(ValueError):
    """Error: other content in place of areas."""


def read_areas(path: Path) -> tuple[NoGo, ...]:
    """Return the polygons and lines of a file as no-go areas, GeoJSON or KML; with the property ``fence`` true as fences.

    An area excludes its holes; a fence's holes may not be entered. ``begin`` and ``end`` limit the time of an area. Heights are ignored.

    Raises:
        PlanError: The file is not GeoJSON or KML, or a geometry encloses no area.
    """
    try:
        with open_input(path) as file:
            features = enumerate(_features_of(file.read(_MOST_BYTES // 2 + 1)), 1)
        return tuple(one for number, each in features for one in _feature_areas(each, number))
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    except _NoAreaError as error:
        raise PlanError(
            f"{path}: expected GeoJSON or KML with polygons of longitude and latitude, or lines around areas, got {error}; "
            "convert it with a GIS, or correct it"
        ) from error


def area_notes(path: Path, areas: Sequence[NoGo], grid: Grid) -> tuple[str, ...]:
    """Return notes on the areas of a file in a region: open or crossing outlines, times, distant areas.

    Raises:
        PlanError: An area lies in the region only with latitude and longitude exchanged.
    """
    notes = []
    for area in areas:
        name, corners = area.name, np.array(area.polygon)
        if area.polygon[0] != area.polygon[-1]:
            notes.append(
                f"{name}: its outline is open; it is closed from the last corner to the first"
            )
        if len(corners) > 3 and not shapely.is_valid(shapely.Polygon(corners)):
            notes.append(f"{name}: its outline crosses itself; filled by the even-odd rule")
        if area.is_timed:
            notes.append(f"{name}: a mission that overlaps its time avoids it throughout")
        if not _overlaps(corners, grid):
            if _overlaps(corners[:, ::-1], grid):
                raise PlanError(
                    f"{path}: {name} has corners such as {corners[0, 0]:g}, {corners[0, 1]:g}, which lie in the region as latitude and "
                    "longitude; GeoJSON has longitude first: swap them"
                )
            notes.append(f"{name}: lies outside the region")
    return tuple(notes)


def _overlaps(corners: Array, grid: Grid) -> bool:
    """Return whether the bounds of corners, shape (n, 2) [degrees], overlap those of a region."""
    if np.any(np.abs(corners[:, 1]) > 90.0):
        return False
    longitude = unwrap_longitude(corners[:, 0], float(grid.longitude.mean()))
    places = (longitude, grid.longitude), (corners[:, 1], grid.latitude)
    return all(ours.min() <= theirs.max() and ours.max() >= theirs.min() for ours, theirs in places)


def _features_of(content: bytes) -> list[Any]:
    """Return the features of a file, recognised by its first bytes; a single geometry is a feature without properties."""
    head = content.removeprefix(b"\xef\xbb\xbf").lstrip()[:2000]
    claimed = sum(size * content.count(mark) for mark, size in _OF_MARKS.items())
    if 2 * len(content) + claimed > _MOST_BYTES:
        raise _NoAreaError("more than about 400,000 corners")
    if head.startswith(b"<") and b"<kml" in head.lower():
        if not (found := list(_kml_features(content))):
            raise _NoAreaError("KML without polygons or lines")
        return found
    try:
        document = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        what = f"invalid JSON ({str(error)[:100]})" if head else "nothing"
        others = (name for begin, name in _OTHERS.items() if head.startswith(begin))
        raise _NoAreaError(next(others, what)) from error
    kind = _kind(document)
    if kind != "FeatureCollection":
        return [document if kind == "Feature" else {"geometry": document}]
    features = document.get("features")
    if not isinstance(features, list):
        raise _NoAreaError("a FeatureCollection without a list of features")
    for number, kind in enumerate(map(_kind, features), 1):
        if kind != "Feature":
            raise _NoAreaError(f"{kind} as feature {number}")
    return features


def _kml_features(content: bytes) -> Iterator[Mapping[str, Any]]:
    """Yield the placemarks of KML with polygons or lines."""
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise _NoAreaError("KML with a document type, which may expand without end")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError) as error:
        raise _NoAreaError(f"invalid XML in KML ({error})") from error

    def ring(line: ElementTree.Element) -> list[list[str]]:
        text = line.findtext("{*}coordinates") or ""
        return [corner.split(",")[:2] for corner in text.split()]

    for place in root.iter():
        if place.tag.rpartition("}")[2] != "Placemark":
            continue
        polygons = [
            [
                ring(line)
                for side in ("outerBoundaryIs", "innerBoundaryIs")
                for line in polygon.iterfind(f"{{*}}{side}/{{*}}LinearRing")
            ]
            for polygon in place.iterfind(".//{*}Polygon")
        ]
        lines = [ring(line) for line in place.iterfind(".//{*}LineString")]
        about: dict[str, Any] = {"name": place.findtext("{*}name")}
        for data in (*place.iterfind(".//{*}Data"), *place.iterfind(".//{*}SimpleData")):
            text = data.findtext("{*}value") or data.text or ""
            about.setdefault(str(data.get("name")), _WORDS.get(text.lower(), text))
        for kind, coordinates in (("MultiPolygon", polygons), ("MultiLineString", lines)):
            if coordinates:
                geometry = {"type": kind, "coordinates": coordinates}
                yield {"type": "Feature", "properties": about, "geometry": geometry}


def _kind(value: Any) -> str:
    """Return the GeoJSON type of a value; a description if it has none."""
    if not isinstance(value, Mapping):
        return f"{type(value).__name__} in JSON" if value is not None else "null"
    kind = value.get("type")
    return kind[:50] if isinstance(kind, str) else "an object without a type"


def _feature_areas(feature: Mapping[str, Any], number: int) -> Iterator[NoGo]:
    """Yield the areas of a feature."""
    properties = feature.get("properties") or {}
    if not isinstance(properties, Mapping):
        raise _NoAreaError(f"feature {number} whose properties are not an object")
    name = str(properties.get("name") or f"no-go area {number}")
    surface_only, fence = (properties.get(key) or False for key in ("surface_only", "fence"))
    for key, value in (("surface_only", surface_only), ("fence", fence)):
        if value not in (True, False):
            raise _NoAreaError(f"{name} with {key} {value!r:.100}, neither true nor false")
    times = [properties.get(key) for key in ("begin", "end")]
    try:
        begin, end = (None if at in (None, "") else parse_time(str(at)) for at in times)
    except ConfigError as error:
        raise _NoAreaError(f"{name} with the time {error!s:.200}") from error
    if begin is not None and end is not None and end < begin:
        raise _NoAreaError(f"{name} that ends before it begins")
    for rings in _rings(feature.get("geometry"), name):
        corners, *holes = (_corners(ring, name) for ring in rings)
        yield NoGo(corners, name, bool(surface_only), tuple(holes), bool(fence), begin, end)


def _rings(geometry: Any, name: str) -> Iterator[list[Any]]:
    """Yield the rings of each polygon, and each line, of a geometry."""
    kind = _kind(geometry)
    if kind == "GeometryCollection" and isinstance(geometry.get("geometries"), list):
        for part in geometry["geometries"]:
            yield from _rings(part, name)
        return
    if kind not in ("Polygon", "MultiPolygon", "LineString", "MultiLineString"):
        raise _NoAreaError(f"{kind} as {name}")
    parts = geometry.get("coordinates")
    for part in parts if kind.startswith("Multi") and isinstance(parts, list) else [parts]:
        rings = [part] if kind.endswith("LineString") else part
        if not isinstance(rings, list) or not rings:
            raise _NoAreaError(f"{name} without corners")
        yield rings


def _corners(ring: Any, name: str) -> tuple[tuple[float, float], ...]:
    """Return the corners of a ring [degrees], without heights."""
    try:
        corners = tuple((float(corner[0]), float(corner[1])) for corner in ring)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError):
        corners = ((np.nan, np.nan),)
    if not np.isfinite(corners).all():
        raise _NoAreaError(f"{name} with corners that are not pairs of numbers")
    if len(set(corners)) < 3:
        raise _NoAreaError(f"{name} with fewer than 3 corners")
    return corners
