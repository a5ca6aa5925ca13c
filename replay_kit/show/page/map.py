"""Data of a page's map: features of a result in the local frame, field, graticule and coastline."""

from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
import shapely

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.region import Feature
from replay_kit.core.words.colors import scale
from replay_kit.core.words.text import time_text
from replay_kit.results.geojson import POSITIONS, features_of
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import CurrentSlices
from replay_kit.show.figures.draw import rounded_column
from replay_kit.show.figures.figure import ON_MAP
from replay_kit.show.figures.map import Extent, bottom_lines, dry_text, extent_around, places_of
from replay_kit.show.page.page import Map, pack_array

#: Of one step of the packed current [m/s].
_STEP = 5e-4
#: Share of the cells that the colours tell apart.
_MOST = 0.98
# Most points along the longer side of a map that a screen tells apart.
_POINTS = 1500
# Nodes along a side of the table of degrees: between them the script interpolates, within some metres over some hundred kilometres.
_NODES = 33


def map_of(contents: Contents) -> Map | None:
    """Return the map of a result with all its vehicles; None without any position."""
    slices, track = contents.slices, contents.track
    if slices is None and track.time_ns.size == 0 and contents.last_plan is None:
        return None
    packed, drawn = _field(contents, slices) if slices is not None else ({}, {})
    marks = marks_of(features_of(contents), contents.projection)
    views = _views(marks, slices, "" not in contents.each)
    lines = bottom_lines(contents, views["region"])
    drawn |= {
        "frame": frame_of(contents.projection, views["region"]),
        "views": views,
        "marks": [*marks_of(lines, contents.projection), *marks],
    }
    title = "The current, the track and the plan"
    choices = dict[str, Sequence[str]]()
    if slices is not None:
        depths = [f"{depth:g} m" for depth in slices.depths]
        choices = {
            "Show": ("speed", "standard error"),
            "Depth": [f"mean to {contents.dive_depth:.0f} m", *depths],
            "Time": [time_text(int(time))[:16] for time in slices.time_ns],
        }
    texts = _caption(contents, slices), _alternative(contents)
    return Map("current-map", title, *texts, choices, packed, drawn)


def marks_of(features: Sequence[Feature], projection: Projection) -> list[dict[str, Any]]:
    """Return features for the page's script: positions [km], look, texts beside the pointer, and times [ms since 1970]."""
    marks = []
    for item in features:
        about = item["properties"]
        role, at = about["role"], places_of(item["geometry"])
        east, north = (np.round(axis / 1e3, 3).tolist() for axis in to_local(projection, *at.T))
        made = [about["time"]] * len(at) if "time" in about else about.get("coordTimes", [])
        said = [] if role in _SILENT else _said(about, len(at))
        each = np.array([time.rstrip("Z") for time in made], "datetime64[ms]").astype(np.int64)
        mark = {"symbol": "", "width": 2.0, "size": 6.0, **ON_MAP[role]}
        place = {"role": role, "label": _label(about), "x": east, "y": north}
        marks.append(mark | place | {"text": said or None, "when": each.tolist() or None})
    return marks


# Features that the pointer says nothing of.
_SILENT = ("bottom", "apart", "ellipse", "between", "past")


def _label(about: Mapping[str, Any]) -> str:
    """Return the text beside a feature; empty for most."""
    role, name = about["role"], str(about["name"])
    if role == "ellipse":
        return "90 % end here" if about["last"] else ""
    if role == "vehicle":
        return str(about.get("vehicle", name))
    return name if role in ("bottom", "goal") else ""


def _said(about: Mapping[str, Any], count: int) -> list[str]:
    """Return the text beside the pointer at each position of a feature."""
    name, depths = escape(about["name"]), about.get("depth_m")
    if "coordTimes" in about:
        each = [f"{name} {time[:16].replace('T', ' ')}" for time in about["coordTimes"]]
        if not isinstance(depths, list):
            return each
        deep = ("unknown" if depth is None else f"{depth:.0f} m" for depth in depths)
        return [f"{one}<br>depth {depth}" for one, depth in zip(each, deep, strict=True)]
    # of a plan the time is that at which it was made
    time = about["time"] if about["role"] in ("begin", "vehicle", "predicted", "actual") else ""
    said = f"{name} {time[:16].replace('T', ' ')}".strip()
    return ["<br>".join(filter(None, [said, escape(about.get("description", ""))]))] * count


def _views(
    marks: Sequence[Mapping[str, Any]], slices: CurrentSlices | None, several: bool
) -> dict[str, Extent]:
    """Return the extents to choose from: vehicle with plan and goal, track, and everything."""

    def places(*roles: str) -> Array:
        found = [np.column_stack([one["x"], one["y"]]) for one in marks if one["role"] in roles]
        return np.vstack([np.empty((0, 2)), *found])

    track, plan = places("track", "vehicle"), places("plan", "start", "goal")
    whole = np.vstack([track, plan])
    views = {} if several or not plan.size else {"plan": np.vstack([plan, places("vehicle")])}
    if track.size:
        views["track"] = whole if several else track
    found = {name: extent_around(at, 0.14) for name, at in views.items()}
    if slices is not None:
        ends = np.column_stack([slices.east[[0, -1]], slices.north[[0, -1]]]) / 1e3
        whole = np.vstack([whole, ends])
    return found | {"region": extent_around(whole)}


def _field(contents: Contents, slices: CurrentSlices) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the packed arrays and axes of the coloured field: mean over a dive, then each depth."""
    mean = contents.dive_mean
    assert mean is not None
    packed = {"current": pack_array(np.concatenate([mean[None], slices.fields]), _STEP, 1)}
    if slices.outside is not None and slices.outside.any():
        packed["outside"] = pack_array(np.where(slices.outside, 1.0, np.nan), 1.0)
    drawn = {
        "east": rounded_column(slices.east / 1e3, 7),
        "north": rounded_column(slices.north / 1e3, 7),
        "times": (slices.time_ns // 1_000_000).tolist(),
        "scales": {
            "speed": _scale(slices.fields[:, :, :2], "speed", "speed-dark"),
            "error": _scale(np.sqrt(0.5) * slices.fields[:, :, 2:], "amp", "amp"),
        },
        "dry": dry_text(slices),
    }
    return packed, drawn


def _scale(pairs: Array, light: str, dark: str) -> dict[str, Any]:
    """Return a colour scale by schemes, with its limit, common to all depths and times.

    Args:
        pairs: Components, shape (D, T, 2, J, I) [m/s], whose root of the sum of squares is drawn.
        light: Name of the scale on a light page.
        dark: Name of the scale on a dark page.
    """
    sizes = np.hypot(pairs[:, :, 0], pairs[:, :, 1])
    known = sizes[np.isfinite(sizes)]
    most = float(f"{np.quantile(known, _MOST):.2g}") if known.size else 0.0
    schemes = {"light": light, "dark": dark}
    colors = {key: [color for _, color in scale(name)] for key, name in schemes.items()}
    return {"most": most or 1.0, **colors}


def frame_of(projection: Projection, extent: Extent) -> dict[str, Any]:
    """Return longitude and latitude at nodes of a map, for interpolation by the script, and land nearby [km].

    Args:
        projection: Local frame.
        extent: Extent of all features; the frame exceeds it by half.
    """
    half = 0.5 * max(extent.east - extent.west, extent.north - extent.south)
    east = np.linspace(extent.west - half, extent.east + half, _NODES)
    north = np.linspace(extent.south - half, extent.north + half, _NODES)
    places = np.meshgrid(1e3 * east, 1e3 * north)
    longitude, latitude = to_geographic(projection, *places)
    longitude = unwrap_longitude(longitude, projection.longitude)
    ends = [np.array([each.min(), each.max()]) for each in (longitude, latitude)]
    # around a pole every longitude is near
    rings = coast_near(projection, *ends) if np.ptp(ends[0]) < 300.0 else []
    return {
        "ends": [float(east[0]), float(east[-1]), float(north[0]), float(north[-1])],
        "nodes": _NODES,
        "longitude": rounded_column(longitude, 7),
        "latitude": rounded_column(latitude, 7),
        "land": [np.round(ring / 1e3, 2).tolist() for ring in rings],
    }


def coast_near(projection: Projection, longitude: Array, latitude: Array) -> list[Array]:
    """Return the rings of land clipped to a box, each shape (n, 2) [m], local frame.

    Args:
        projection: Local frame.
        longitude: Limits of the box [degrees], continuous beyond 180.
        latitude: Limits of the box [degrees].
    """
    (west, east), (south, north) = longitude, latitude
    least, land, found = float(max(east - west, north - south)) / _POINTS, _land(), list[Array]()
    tree = shapely.STRtree(land)
    for turn in (-360.0, 0.0, 360.0):
        box = west - turn, south, east - turn, north
        near = land[np.sort(tree.query(shapely.box(*box)))]
        cut = shapely.clip_by_rect(near, *box)
        parts = shapely.get_parts(shapely.simplify(cut, 0.5 * least))
        # what of a ring beside the box is cut to a line has no area
        rings = (part.exterior.coords.xy for part in parts if part.area > least**2)
        found += (np.column_stack(to_local(projection, *ring)) for ring in rings)
    return found


def _land() -> Any:
    """Return the rings of land as polygons, longitude and latitude [degrees]."""
    path = files("replay_kit.show.page").joinpath("coast.npz")
    with path.open("rb") as file, np.load(file) as kept:
        # each ring is its first point and the steps from it
        counts, unit, origin = kept["counts"] + 1, kept["scale"], kept["origin"]
        steps = np.column_stack([kept["east"], kept["north"]]).astype(np.int64)
        first = np.cumsum(counts) - counts
        at = np.insert(steps, first - np.arange(first.size), 0, axis=0).cumsum(axis=0)
        at += np.repeat(kept["starts"] - at[first], counts, axis=0)
    number = np.repeat(np.arange(counts.size), counts)
    return shapely.polygons(shapely.linearrings(origin + unit * at, indices=number))


def _caption(contents: Contents, slices: CurrentSlices | None) -> str:
    texts = []
    if slices is not None:
        texts.append(
            "Colours: speed, or standard error of a velocity component, faded where the error exceeds the current. Lines: "
            "where water drifts. The mean over depth is over that of the vehicle's dives; its error is at most the one shown. "
            f"Grey: {dry_text(slices)}."
        )
        if slices.outside is not None and slices.outside.any():
            texts.append("Hatched: outside the forecast.")
        if slices.left_out:
            every = slices.left_out + slices.time_ns.size
            texts.append(
                f"{slices.left_out} of {every} published times are omitted, evenly spread."
            )
    count = contents.track.time_ns.size
    if count > POSITIONS:
        texts.append(f"Of {count:,} positions {POSITIONS:,} are drawn, evenly spread.")
    if contents.seabed is not None:
        inputs = contents.metadata.get("replay_kit.inputs", {})
        name, *_ = inputs.get("bathymetry", "the bathymetry").partition(" sha256:")
        texts.append(f"Labelled lines: depth of the bottom, from {escape(name)}.")
    texts.append(
        "Ellipses hold 90 % of the predicted surfacings; a line joins each predicted surfacing to the actual one. Land is from Natural "
        "Earth, for orientation: plans avoid what the forecast and the bathymetry hold, not this coast."
    )
    return " ".join(texts)


def _alternative(contents: Contents) -> str:
    track = contents.track
    start = "Map of the estimated current" if contents.slices is not None else "Map"
    keys = "Arrow keys move it, plus and minus change its scale."
    if track.time_ns.size == 0:
        return f"{start}, without a track of the vehicle. {keys}"
    first, last = (f"{track.longitude[k]:.3f}, {track.latitude[k]:.3f}" for k in (0, -1))
    return f"{start} with the vehicle's track from {first} to {last} degrees east and north, {track.distance[-1] / 1e3:.0f} km long. {keys}"
