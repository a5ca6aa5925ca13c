"""No-go areas from GeoJSON, and what about them a user should know."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planners import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Grid


def read_areas(path: Path) -> tuple[NoGo, ...]:
    """Return the polygons of a GeoJSON file as no-go areas; a hole counts as part of its area, and heights are left out.

    Raises:
        PlanError: It is not GeoJSON, or holds a geometry that is not a polygon.
    """
    return tuple(
        NoGo(tuple((float(corner[0]), float(corner[1])) for corner in rings[0]), name, below)
        for name, below, rings in _polygons(path)
    )


def area_notes(path: Path, grid: Grid) -> tuple[str, ...]:
    """Return what about the areas of a file a user of them in a region should know: open or crossing outlines, holes, far away.

    Raises:
        PlanError: An area lies in the region only if its corners are latitude and longitude.
    """
    notes = []
    for name, _, rings in _polygons(path):
        corners = np.array([[float(corner[0]), float(corner[1])] for corner in rings[0]])
        if not np.array_equal(corners[0], corners[-1]):
            notes.append(
                f"{name}: its outline is open; it is closed from the last corner to the first"
            )
        if len(rings) > 1:
            notes.append(f"{name}: its {len(rings) - 1} holes count as part of the area")
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


def _polygons(path: Path) -> list[tuple[str, bool, Sequence[Any]]]:
    """Return name, whether only surfacing is forbidden, and rings of each polygon of a file."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        features = document["features"] if document["type"] == "FeatureCollection" else [document]
        polygons = []
        for k, feature in enumerate(features):
            properties, geometry = feature.get("properties") or {}, feature["geometry"]
            parts = {"Polygon": [geometry["coordinates"]], "MultiPolygon": geometry["coordinates"]}[
                geometry["type"]
            ]
            name, surface_only = (
                str(properties.get("name", f"no-go area {k + 1}")),
                properties.get("surface_only") or False,
            )
            if surface_only not in (True, False):
                raise ValueError(
                    f"surface_only of {name} is {surface_only!r}, neither true nor false"
                )
            for part in parts:
                # anything but pairs of numbers is found here
                [(float(corner[0]), float(corner[1])) for corner in part[0]]
                polygons.append((name, bool(surface_only), part))
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        # not its repr: that of bytes which are not text holds the whole file
        what = f"{type(error).__name__}: {error}"
        raise PlanError(
            f"{path}: expected GeoJSON features that are polygons of longitude and latitude: {what}"
        ) from error
    return polygons
