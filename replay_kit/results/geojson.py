"""Features of a result as GeoJSON, for the page's map, printed maps, GeoJSON and KML.

Each feature has a ``role`` for its style, a ``name``, ``time`` or, for several positions, ``coordTimes``, and a ``description``. Longitudes
are continuous across the antimeridian, as in ``/plan/geojson``.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection, Seabed
from replay_kit.core.region import Feature, feature, positions
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import LastPlan, outlines_of, thinned

#: Positions of a track; more are thinned.
POSITIONS = 3000
# Of a plan; and more fixes than these hide the track.
_PLANNED, _FIXES = 1000, 150
#: The roles of features from the lowest on a map to the highest, with the table of an export whose rows they are of.
ROLES: Mapping[str, str] = {
    **{"bottom": "", "no_go": "plans", "between": "plans", "ellipse": "plans"},
    **{"past": "surfacings", "track": "track"},
    **{"apart": "surfacings", "fix": "track", "begin": "track", "predicted": "surfacings"},
    **{"actual": "surfacings", "plan": "plans", "planned": "plans", "start": "plans"},
    **{"vehicle": "track", "goal": "plans", "place": "series"},
}


def features_of(contents: Contents) -> list[Feature]:
    """Return the features of a result, with names of several vehicles, in drawing order."""
    found = []
    for vehicle, one in contents.each.items():
        each = [*_of_plan_area(one), *_of_track(one), *_of_surfacings(one), *_of_plan(one)]
        for about in (each_one["properties"] for each_one in each) if vehicle else ():
            about |= {"name": f"{vehicle} {about['name']}", "vehicle": vehicle}
        found += each
    order = [*ROLES]
    return sorted(found, key=lambda one: order.index(one["properties"]["role"]))


def until(features: Sequence[Feature], time_ns: int | None) -> list[Feature]:
    """Return the features up to a time [ns, UTC]; all for None."""
    if time_ns is None:
        return [*features]
    (end,), kept = _times(np.array([time_ns])), []
    for one in features:
        about, shape = one["properties"], one["geometry"]
        # a plan is made at its time, also where it leads on
        if "time" in about or "coordTimes" not in about:
            kept += [one] if about.get("time", "") <= end else []
        elif count := sum(time <= end for time in about["coordTimes"]):
            shape = {**shape, "coordinates": shape["coordinates"][:count]}
            times = {"coordTimes": about["coordTimes"][:count]}
            kept.append({**one, "geometry": shape, "properties": {**about, **times}})
    return kept


def contours_of(
    seabed: Seabed, projection: Projection, ends: Sequence[float], step: float
) -> list[Feature]:
    """Return depth contours of the seabed within a box.

    Args:
        seabed: Seabed.
        projection: Its local frame.
        ends: West, east, south and north sides of the box [m].
        step: Contour interval [m].
    """
    # loads slowly, and few results have a bottom
    from contourpy import contour_generator

    west, east, south, north = ends
    columns, rows = (
        (axis >= low) & (axis <= high)
        for axis, low, high in ((seabed.east, west, east), (seabed.north, south, north))
    )
    depth = np.where(np.outer(rows, columns), seabed.depth, np.nan)
    if not np.isfinite(depth).any():
        return []
    lines = contour_generator(seabed.east, seabed.north, np.ma.masked_invalid(depth))
    found = []
    for level in step * np.arange(np.nanmin(depth) // step, np.nanmax(depth) // step + 1.0):
        for line in lines.lines(level) if level > 0.0 else ():
            at = _ring(np.asarray(line), projection)
            if len(at) > 1:
                name = f"{level:g} m"
                found.append(_feature("LineString", at, "bottom", name, {"depth_m": float(level)}))
    return found


def place_features(series: pd.DataFrame, projection: Projection) -> list[Feature]:
    """Return the last current at each position of a table of series."""
    found = []
    for number, rows in series.groupby("place") if len(series) else ():
        last = rows.iloc[-1]
        names = ("u", "v", "u_standard_error", "v_standard_error")
        about = {"time": _time(last["time"]), "depth_m": float(last["depth"])}
        about |= {f"{key}_m_s": _number(last[key]) for key in names}
        at = positions([last["longitude"]], [last["latitude"]], projection.longitude)[0]
        found.append(_feature("Point", at, "place", f"place {number}", about))
    return found


def _of_track(contents: Contents) -> Iterator[Feature]:
    track, near = contents.track, contents.projection.longitude
    if track.time_ns.size == 0:
        return
    rows = thinned(track.time_ns.size, POSITIONS)
    at = positions(track.longitude[rows], track.latitude[rows], near)
    times = _times(track.time_ns[rows])
    if len(at) > 1:
        depths = [_number(depth) for depth in np.round(track.depth[rows], 1)]
        about = {"begin": times[0], "end": times[-1], "coordTimes": times, "depth_m": depths}
        yield _feature("LineString", at, "track", "track", about)
    fixes = np.flatnonzero(~track.dead_reckoned[rows])
    # of a vessel every position is a fix, and circles around all hide the track
    if 0 < fixes.size <= min(_FIXES, 0.5 * rows.size):
        about = {"coordTimes": [times[k] for k in fixes]}
        yield _feature("MultiPoint", [at[k] for k in fixes], "fix", "fixes", about)
    yield _feature("Point", at[0], "begin", "begin", {"time": times[0]})
    yield _feature("Point", at[-1], "vehicle", "vehicle", {"time": times[-1]})


def _of_surfacings(contents: Contents) -> Iterator[Feature]:
    table, projection = contents.result.surfacings, contents.projection
    for row in table.reset_index().itertuples():
        places = [
            positions(
                [getattr(row, f"{kind}_longitude")],
                [getattr(row, f"{kind}_latitude")],
                projection.longitude,
            )[0]
            for kind in ("predicted", "actual")
        ]
        about = {"time": _time(row.time), "distance_m": _number(row.distance)}
        about["description"] = f"{row.distance:.0f} m apart"
        # a line joins each predicted surfacing to the actual one
        yield _feature("LineString", places, "apart", "surfacing, apart", about)
        for kind, at in zip(("predicted", "actual"), places, strict=True):
            yield _feature("Point", at, kind, f"surfacing, {kind}", about)
    known = table[np.isfinite(table["ellipse_major"].to_numpy(float))] if len(table) else table
    for time, outline in zip(known.index, outlines_of(table, projection), strict=True):
        ring, about = _ring(outline, projection), {"time": _time(time)}
        yield _feature("Polygon", [ring], "past", "90 % ellipse of a surfacing", about)


def _of_plan_area(contents: Contents) -> Iterator[Feature]:
    """Yield the areas and surfacing ellipses of the last plan."""
    plan, projection = contents.last_plan, contents.projection
    if plan is None:
        return
    for area in plan.areas:
        longitude, latitude = np.array([*area.corners, area.corners[0]]).T
        ring = positions(longitude, latitude, projection.longitude)
        name = f"no-go area {area.name}"
        about: dict[str, Any] = {"surface_only": area.surface_only}
        about |= {"description": "surface only"} if area.surface_only else {}
        yield _feature("Polygon", [ring], "no_go", name, about)
    for number, outline in enumerate(plan.ellipses, start=1):
        name = f"90 % ellipse of planned surfacing {number}"
        about = {"time": _made(plan), "last": number == len(plan.ellipses)}
        role = "ellipse" if number in (1, len(plan.ellipses)) else "between"
        yield _feature("Polygon", [_ring(outline, projection)], role, name, about)


def _of_plan(contents: Contents) -> Iterator[Feature]:
    """Yield the last plan with start and goal, and the ends of earlier plans."""
    plan, projection = contents.last_plan, contents.projection
    if plan is None:
        return
    made = {"time": _made(plan)}
    if len(plan.track) > 1:
        track = plan.track.iloc[thinned(len(plan.track), _PLANNED)]
        line = positions(track["longitude"], track["latitude"], projection.longitude)
        times = _times(track.index)
        about: dict[str, Any] = {"begin": times[0], "end": times[-1], "coordTimes": times}
        about |= made | _figures(plan)
        depths = [_number(depth) for depth in np.round(track["depth"], 1)]
        yield _feature("LineString", line, "plan", "last plan", about | {"depth_m": depths})
    for leg in plan.legs[:-1]:
        at = positions([leg["longitude"]], [leg["latitude"]], projection.longitude)[0]
        surfaces = _time(plan.row.name + pd.Timedelta(seconds=round(leg["surfacing_s"])))[:16]
        steer = f"{leg['heading_deg']:03.0f}° true, to {leg['depth_m']:.0f} m"
        about = {**made, "description": f"{surfaces.replace('T', ' ')}, {steer}"}
        yield _feature("Point", at, "planned", f"planned surfacing {leg['leg']}", about)
    for role, place in (("start", plan.start), ("goal", plan.goal)):
        at = positions(*to_geographic(projection, *place[:, None]), projection.longitude)[0]
        depth = float(plan.row[f"{role}_depth"])
        name = f"goal, {depth:.0f} m" if role == "goal" and np.isfinite(depth) else role
        yield _feature("Point", at, role, name, {**made, "depth_m": _number(depth)})


def _figures(plan: LastPlan) -> dict[str, Any]:
    """Return the available figures of a plan."""
    odds = plan.odds or {}
    known = {
        "energy_j": plan.energy,
        "battery_j": plan.battery,
        "samples": odds.get("n_samples"),
        "reached_share": odds.get("reached"),
    }
    held = {name: value for name, value in known.items() if value is not None}
    return {"status": str(plan.row["status"]), **held}


def _feature(
    kind: str, coordinates: Any, role: str, name: str, about: Mapping[str, Any]
) -> Feature:
    return feature(kind, coordinates, {"role": role, "name": name, **about})


def _ring(outline: Array, projection: Projection) -> list[list[float]]:
    """Return an outline [m], shape (n, 2), in degrees."""
    return positions(*to_geographic(projection, *outline.T), projection.longitude)


def _made(plan: LastPlan) -> str:
    return _time(plan.row.name)


def _times(times: Any) -> list[str]:
    """Return times [ns, UTC] as ISO 8601 to the second."""
    seconds = np.asarray(times).astype("datetime64[ns]").astype("datetime64[s]")
    return [f"{text}Z" for text in np.datetime_as_string(seconds).tolist()]


def _time(value: Any) -> str:
    return _times([np.datetime64(value, "ns")])[0]


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
