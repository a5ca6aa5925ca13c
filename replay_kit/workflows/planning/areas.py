"""No-go areas and fences from GeoJSON and KML, and what about them a user should know.

KML is made features of GeoJSON. References: RFC 7946; OGC 12-007r2, KML 2.3.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import shapely

from planners.hazards.areas import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Grid
from replay_kit.core.inputs import open_input
from replay_kit.core.quantities import parse_time

_LEAST_CORNERS = 3


# Of KML, in which all values are words.
_WORDS: dict[Any, Any] = {
    "true": True,
    "True": True,
    "1": True,
    "false": False,
    "False": False,
    "0": False,
}
# What a file of areas may take in memory [bytes], and each of its marks: a list, a tag, a value.
_MOST_BYTES, _OF_MARKS = 80_000_000, {b"[": 64, b"{": 256, b"<": 128, b",": 40}


def read_areas(path: Path) -> tuple[NoGo, ...]:
    """Return the polygons of a file, and what its lines enclose, as no-go areas; with the property ``fence`` true as fences.

    What holds in an area does not hold in its holes; a fence's holes may not be entered. ``begin`` and ``end`` are the times between which
    an area holds. Heights are left out.

    Raises:
        PlanError: It is no GeoJSON or KML, or holds a geometry that encloses nothing.
    """
    return tuple(
        NoGo(
            _pairs(one.corners),
            one.name,
            one.surface_only,
            tuple(map(_pairs, one.holes)),
            one.fence,
            *one.times_ns,
        )
        for one in _outlines(path)
    )


def _pairs(corners: Array) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in corners)


def area_notes(path: Path, grid: Grid) -> tuple[str, ...]:
    """Return what about the areas of a file a user of them in a region should know: lines, open or crossing outlines, times, far away.

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
        if any(time is not None for time in outline.times_ns):
            notes.append(f"{name}: a mission that lasts into its time keeps out of it throughout")
        if len(corners) > 3 and not shapely.is_valid(shapely.Polygon(corners)):
            notes.append(f"{name}: its outline crosses itself; filled by the even-odd rule")
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
        holes: Corners of its holes, each shape (n, 2).
        fence: Whether it must not be left.
        times_ns: Between which it holds [ns, UTC]; None for ever.
        of_line: Whether the file draws it as a line.
    """

    name: str
    surface_only: bool
    corners: Array
    holes: tuple[Array, ...]
    fence: bool
    times_ns: tuple[int | None, int | None]
    of_line: bool


def _outlines(path: Path) -> list[_Outline]:
    """Return the outlines of a file; of GeoJSON a FeatureCollection, a Feature or a geometry alone.

    Raises:
        PlanError: As for ``read_areas``.
    """
    try:
        with open_input(path) as file:
            content = file.read(_MOST_BYTES // 2 + 1)
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    try:
        return [
            outline
            for number, feature in enumerate(_features_of(content), 1)
            for outline in _of_feature(feature, number)
        ]
    except _NoAreaError as error:
        raise PlanError(
            f"{path}: expected GeoJSON or KML with polygons of longitude and latitude, or lines around areas, got {error}; "
            "convert it with a GIS, or correct it"
        ) from error


class _NoAreaError(ValueError):
    """What was found instead of areas."""


def _features_of(content: bytes) -> Sequence[Mapping[str, Any]]:
    """Return the features of a file by its first bytes."""
    head = content[:2000].lower()
    if (
        2 * len(content) + sum(size * content.count(mark) for mark, size in _OF_MARKS.items())
        > _MOST_BYTES
    ):
        raise _NoAreaError("more than some 400,000 corners, which are to be simplified")
    if not (head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and b"<kml" in head):
        return _features(_document(content))
    if not (found := list(_of_kml(content))):
        raise _NoAreaError("KML without polygons or lines")
    return found


def _of_kml(content: bytes) -> Iterator[Mapping[str, Any]]:
    """Yield the placemarks of KML with polygons or lines."""
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise _NoAreaError("KML with a document type, which may expand without end")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError) as error:
        raise _NoAreaError(f"KML that is no XML ({error})") from error

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
        about: dict[str, Any] = {
            str(data.get("name")): _WORDS.get(text := data.findtext("{*}value") or data.text, text)
            for kind in ("Data", "SimpleData")
            for data in place.iterfind(f".//{{*}}{kind}")
        } | {"name": place.findtext("{*}name")}
        for kind, coordinates in (("MultiPolygon", polygons), ("MultiLineString", lines)):
            if coordinates:
                geometry = {"type": kind, "coordinates": coordinates}
                yield {"type": "Feature", "properties": about, "geometry": geometry}


def _document(content: bytes) -> Any:
    """Return the JSON of a file."""
    try:
        return json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        head = content[:1000].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
        known = (
            (head.startswith(b"<"), "XML"),
            (head.startswith(b"pk\x03\x04"), "a zip file, such as KMZ"),
            (head.startswith(b"sqlite format 3"), "a database, such as a GeoPackage"),
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
    name = str(properties.get("name") or f"no-go area {number}")
    surface_only, fence = (_flag(properties, key, name) for key in ("surface_only", "fence"))
    begin, end = (_time(properties.get(key), name) for key in ("begin", "end"))
    if begin is not None and end is not None and end < begin:
        raise _NoAreaError(f"{name} that ends before it begins")
    for of_line, rings in _rings(feature.get("geometry"), name):
        corners, *holes = (_corners(ring, name) for ring in rings)
        yield _Outline(name, surface_only, corners, tuple(holes), fence, (begin, end), of_line)


def _flag(properties: Mapping[str, Any], key: str, name: str) -> bool:
    """Return a property that is true or false."""
    value = properties.get(key) or False
    if value not in (True, False):
        raise _NoAreaError(f"{name} with {key} {value!r:.100}, neither true nor false")
    return bool(value)


def _time(value: Any, name: str) -> int | None:
    """Return a time [ns, UTC]; None for none."""
    if value in (None, ""):
        return None
    try:
        return parse_time(str(value))
    except ConfigError as error:
        raise _NoAreaError(f"{name} with the time {value!r:.100}: {error}") from error


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
