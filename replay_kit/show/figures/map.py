"""Maps for papers: current and standard error at a depth, with the features of a result."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic, to_local, unwrap_longitude
from replay_kit.core.plan import ORIGIN, Plan
from replay_kit.core.region import Feature
from replay_kit.core.words.text import time_text
from replay_kit.results.geojson import ROLES, features_of, features_until, line_of, placed_feature
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import At, CurrentSlices, slices_of, typical_depth
from replay_kit.show.figures.figure import ON_MAP, Axis, Figure, Mark, Panel, missing_panel
from replay_kit.show.figures.section import profile_figure
from replay_kit.show.numbers import nice_number
from replay_kit.show.sentences import energy_sentence, odds_sentence

# Most arrows along the longer side of a map; of fewer side by side each is still no longer than this share of the width.
_ARROWS, _FEW = 24, 10.0
# Contours of the bottom are about this many.
_CONTOURS = 7
# The least width of a map [km]: one position alone has none.
_LEAST = 4.0


class Chosen(NamedTuple):
    """Selection of the data of a figure; None for its default.

    Attributes:
        at: Position of a series, or marked on a map at its depth.
        depth: Depth of a map without a position [m].
        time_ns: Time of a map [ns, UTC]; later data are not shown.
    """

    at: At | None = None
    depth: float | None = None
    time_ns: int | None = None


class Extent(NamedTuple):
    """Extent of a map in the local frame [km]."""

    west: float
    east: float
    south: float
    north: float


def extent_around(places: Array, beyond: float = 0.03) -> Extent:
    """Return the extent around points, shape (n, 2) [km], padded by a fraction of its longer side."""
    known = places[np.isfinite(places).all(axis=1)]
    ends = np.stack([known.min(axis=0), known.max(axis=0)], axis=1)
    span = np.ptp(ends, axis=1, keepdims=True)
    grown = ends + np.maximum(beyond * span.max(), 0.5 * (_LEAST - span)) * [-1.0, 1.0]
    return Extent(*(float(f"{end:.5g}") for end in grown.ravel()))


def map_figure(contents: Contents, chosen: Chosen) -> Figure:
    """Return maps of the current and its standard error, with the track.

    Args:
        contents: Contents of the result.
        chosen: Place, depth and time.

    Raises:
        ConfigError: No current was published before the time.
    """
    slices, track, title = slices_at(contents, chosen), contents.track, "Map"
    if slices is None and track.time_ns.size == 0:
        also = "; the figure plan shows its plan." if contents.last_plan is not None else "."
        why = f"The result holds neither a current nor a position{also}"
        return Figure("map", title, [missing_panel(title, why)])
    if slices is None:
        extent = extent_around(np.column_stack([track.east, track.north]) / 1e3, 0.05)
        panel = _map_panel(contents, "track", extent, chosen, [], 0.8)
        notes = ["The result holds no current: the map shows only positions."]
        return Figure("map", title, [panel], notes=notes, across=1)
    notes = list[str]()
    if contents.estimate is None and chosen.time_ns is None:
        notes.append("The result holds no estimate: the map shows the last published current.")
    asked, shown = chosen.depth if chosen.at is None else chosen.at[2], float(slices.depths[0])
    if asked not in (None, shown):
        notes.append(f"Requested depth: {asked:g} m; nearest published depth: {shown:g} m.")
    extent = Extent(*(float(end) / 1e3 for a in (slices.east, slices.north) for end in a[[0, -1]]))
    shape = (extent.north - extent.south) / (extent.east - extent.west)
    # with room for a map's labels, key and colour bar
    high = float(np.clip(0.72 * shape + 0.18, 0.4, 1.2))
    name = f"{shown:g} m, {time_text(int(slices.time_ns[-1]))[:16]}"
    panels = [_map_panel(contents, name, extent, chosen, speed_marks(contents, slices), high)]
    errors = slices.fields[0, -1, 2:]
    if np.isfinite(errors).any():
        error = np.sqrt(0.5 * (errors[0] ** 2 + errors[1] ** 2))
        marks = _field(contents, slices, error, ("amp", "standard error [m/s]"))
        panels.append(_map_panel(contents, "standard error", extent, chosen, marks, high))
    else:
        notes.append("The current has no standard error.")
    return Figure("map", title, panels, notes=[*notes, *without_current(slices, extent)])


def plan_figure(contents: Contents, chosen: Chosen) -> Figure:
    """Return the last plan as a map and a depth profile.

    Args:
        contents: Contents of the result.
        chosen: Depth of the current.
    """
    plan = contents.last_plan
    if plan is None:
        why = (contents.outcome.plan or {}).get("message", "no goal was given, or none was due")
        text = f"The result holds no plan: {why}; replay-kit plan makes one on this estimate."
        return Figure("plan", "Plan", [missing_panel("Plan", text)], across=1)
    flown, slices = len(plan.track) > 0, slices_at(contents, chosen)
    notes = _in_words(plan) if flown else [f"The last plan has no track: {plan.message}."]
    ends = np.array([(end.longitude, end.latitude) for end in (plan.start, plan.goal)])
    places = [plan.track[:, :2], np.column_stack(to_local(contents.projection, *ends.T))]
    extent, marks = extent_around(np.vstack(places) / 1e3, 0.15), []
    if slices is not None:
        marks = speed_marks(contents, slices, 1e3 * (extent.east - extent.west))
        notes += without_current(slices, extent)
    title = f"last plan: {plan.status}"
    roles = [role for role, table in ROLES.items() if table in ("plans", "surfacings")]
    panels = [_map_panel(contents, title, extent, chosen, marks, 0.85, roles)]
    if flown:
        panels.append(profile_figure(contents, plan).panels[0]._replace(height=0.85))
    return Figure("plan", "Plan", panels, notes=notes)


def _in_words(plan: Plan) -> list[str]:
    """Return notes on a plan: command, assumed dive parameters, energy and odds, as available."""
    begin = time_text(plan.start_time_ns)[:16]
    if not np.isfinite(plan.heading_deg):
        return [f"{begin} UTC: no command: {plan.message}."]
    steer = f"heading {plan.heading_deg:.0f}° true, glide angle {plan.glide_angle_deg:.1f}°, {plan.duration / 3600.0:.1f} h"
    out = [f"{begin} UTC: {steer}, misses the goal by {plan.closest_approach:.0f} m."]
    out += [f"Dives {plan.statistics[ORIGIN]}."] if ORIGIN in plan.statistics else []
    out += [f"Energy {energy_sentence(plan.energy, plan.battery)}."] if plan.energy > 0.0 else []
    return out + ([] if plan.odds is None else [f"{odds_sentence(plan.odds)}."])


def _map_panel(
    contents: Contents,
    title: str,
    extent: Extent,
    chosen: Chosen,
    field: Sequence[Mark],
    height: float,
    roles: Sequence[str] = (),
) -> Panel:
    """Return a map with features of given roles, or of all roles."""
    lines = bottom_lines(contents, extent)
    found = features_until(features_of(contents), chosen.time_ns)
    shown = [one for one in found if not roles or one["properties"]["role"] in roles]
    marks = [*field, *marks_of([*lines, *shown])]
    if chosen.at is not None:
        x = np.array([float(unwrap_longitude(chosen.at[0], contents.projection.longitude))])
        star: Any = {"color": "#ffffff", "symbol": "star", "size": 18.0, "edge": "ink"}
        marks.append(Mark("points", x, np.array([chosen.at[1]]), "requested place", **star))
    ends = 1e3 * np.array(extent)
    corners = _degrees(contents, *np.meshgrid(ends[:2], ends[2:]))
    x_axis, y_axis = (Axis("", ends=(each.min(), each.max())) for each in corners)
    middles = [places_of(one["geometry"]) for one in lines]
    labels = [
        (*at[len(at) // 2].tolist(), one["properties"]["name"])
        for at, one in zip(middles, lines, strict=True)
    ]
    look: Any = {"degrees": True, "labels": labels, "shares_legend": True}
    return Panel(title, x_axis, y_axis, marks, height, **look)


def bottom_lines(contents: Contents, extent: Extent) -> list[Feature]:
    """Return contours of the bottom within an extent; empty without a bathymetry or over a flat one."""
    seabed = contents.seabed
    if seabed is None:
        return []
    west, east, south, north = (1e3 * end for end in extent)
    columns = (seabed.east >= west) & (seabed.east <= east)
    rows = (seabed.north >= south) & (seabed.north <= north)
    depth = np.where(np.outer(rows, columns), seabed.depth, np.nan)
    known = depth[np.isfinite(depth)]
    if not known.size or not np.ptp(known):
        return []
    # loads slowly, and few results have a bottom
    from contourpy import contour_generator

    lines = contour_generator(seabed.east, seabed.north, np.ma.masked_invalid(depth))
    step, found = contour_step(float(np.ptp(known))), []
    for level in step * np.arange(known.min() // step, known.max() // step + 1.0):
        for line in lines.lines(level) if level > 0.0 else ():
            at, about = line_of(np.asarray(line), contents.projection), {"depth_m": float(level)}
            if len(at) > 1:
                found.append(placed_feature("LineString", at, "bottom", f"{level:g} m", about))
    return found


def contour_step(span: float) -> float:
    """Return the contour interval for a range of depths [m], at most seven contours."""
    return nice_number(max(span, 10.0) / _CONTOURS, least=True)


def marks_of(features: Iterable[Feature]) -> list[Mark]:
    """Return features as marks in degrees, with consecutive ones of a role joined."""
    marks = []
    for role, group in groupby(features, key=lambda one: str(one["properties"]["role"])):
        parts, look = [places_of(one["geometry"]) for one in group], ON_MAP[role]
        if "off" in look:
            continue
        if look["kind"] != "points":
            parts = [part for each in parts for part in (each, np.full((1, 2), np.nan))][:-1]
        x, y = np.concatenate(parts).T
        marks.append(Mark(x=x, y=y, **look))
    return marks


def places_of(geometry: dict[str, Any]) -> Array:
    """Return the positions of a geometry, shape (n, 2); the holes of a polygon are reached from its first corner and back."""
    at = geometry["coordinates"]
    if geometry["type"] == "Polygon":
        at = [*at[0], *(corner for hole in at[1:] for corner in (*hole, at[0][0]))]
    return np.reshape(at, (-1, 2)).astype(np.float64)


def slices_at(contents: Contents, chosen: Chosen) -> CurrentSlices | None:
    """Return the last current, or that before a time, at one depth: of the estimate or the nearest published slice.

    Raises:
        ConfigError: No current was published before the time.
    """
    published, time_ns = contents.slices, chosen.time_ns
    depth = chosen.at[2] if chosen.at is not None else chosen.depth
    if depth is None:
        measured = contents.measured.innovations["depth"].to_numpy(np.float64)
        depth = typical_depth(published, measured)
    if contents.estimate is not None and time_ns is None:
        return slices_of(contents.estimate, np.array([depth]))
    if published is None:
        return None
    k, times = int(np.argmin(np.abs(published.depths - depth))), published.time_ns
    end = times.size if time_ns is None else int(np.searchsorted(times, time_ns, "right"))
    if time_ns is not None and end == 0:
        said = f"{time_text(time_ns)}; the first is of {time_text(int(times[0]))}"
        raise ConfigError(f"--time: no current was published before {said}")
    fields = published.fields[k : k + 1, end - 1 : end]
    depths, time = published.depths[k : k + 1], times[end - 1 : end]
    return published._replace(depths=depths, time_ns=time, fields=fields)


def without_current(slices: CurrentSlices, extent: Extent) -> list[str]:
    """Return sentences on the grey and hatched areas of a map."""
    shown, beyond = [], False
    for axis, ends in ((slices.east, extent[:2]), (slices.north, extent[2:])):
        half, (low, high) = 0.5 * (axis[1] - axis[0]), 1e3 * np.array(ends)
        shown.append((axis > low - half) & (axis < high + half))
        beyond |= bool(low < axis[0] - half or high > axis[-1] + half)
    grey, hatched = (cells[np.ix_(shown[1], shown[0])].any() for cells in _blank(slices))
    return [
        *([f"Grey: {dry_text(slices)}."] if grey else []),
        *(["Hatched: outside the forecast."] if hatched or beyond else []),
    ]


def dry_text(slices: CurrentSlices) -> str:
    """Return a description of cells without a current, except those outside the forecast's grid."""
    beyond = "land, below the bottom, or outside the forecast"
    return beyond if slices.outside is None else "land, or below the bottom"


def speed_marks(
    contents: Contents, slices: CurrentSlices, across: float | None = None
) -> list[Mark]:
    """Return speed, land and arrows of one slice.

    Args:
        contents: Contents of the result.
        slices: Slice at one depth.
        across: Width of the map [m]; None for the whole slice.
    """
    u, v = slices.fields[0, -1, :2]
    step = -(-max(u.shape) // _ARROWS)
    half = (slice((step - 1) // 2, None, step),) * 2
    x, y = _degrees(contents, *np.meshgrid(slices.east, slices.north))
    turned = np.stack(rotate_to_geographic(contents.projection, x, y, u, v))[:, *half]
    width = slices.east[-1] - slices.east[0] if across is None else across
    cells = max(width / (step * (slices.east[1] - slices.east[0])), _FEW)
    arrows = Mark("arrows", x[half], y[half], size=cells, z=turned)
    return [*_field(contents, slices, np.hypot(u, v), ("speed", "speed [m/s]")), arrows]


def _field(
    contents: Contents, slices: CurrentSlices, values: Array, look: tuple[str, str]
) -> list[Mark]:
    """Return marks of cell values and land."""
    corners = _degrees(contents, *np.meshgrid(_edges(slices.east), _edges(slices.north)))
    known = values[np.isfinite(values)]
    most = float(known.max()) if known.size and known.max() > 0.0 else 1.0
    land = Mark("mesh", *corners, z=np.where(_blank(slices)[0], 1.0, np.nan))
    if known.size == values.size:
        corners = _degrees(contents, *np.meshgrid(slices.east, slices.north))
    return [land, Mark("mesh", *corners, z=values, scale=(look[0], 0.0, most, look[1]))]


def _blank(slices: CurrentSlices) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of cells without a current: dry or unknown ones, and those outside the forecast's grid."""
    lacking = ~np.isfinite(slices.fields[0, -1, 0])
    outside = np.zeros_like(lacking) if slices.outside is None else slices.outside
    return lacking & ~outside, outside


def _edges(centres: Array) -> Array:
    half = 0.5 * (centres[1] - centres[0])
    return np.append(centres - half, centres[-1] + half)


def _degrees(contents: Contents, east: Array, north: Array) -> tuple[Array, Array]:
    """Return longitude, continuous around the region's centre, and latitude [degrees] of local points [m]."""
    longitude, latitude = to_geographic(contents.projection, east, north)
    return unwrap_longitude(longitude, contents.projection.longitude), latitude
