"""Features of a result as GeoJSON, for the page's map, printed maps, GeoJSON and KML.

Each feature has a ``role`` for its style, a ``name``, ``time`` or, for several positions, ``coordTimes``, and a ``description``. Longitudes
are continuous across the antimeridian, as in ``/plan/geojson``.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from replay_kit.core.grid import Projection
from replay_kit.core.region import Feature, positions
from replay_kit.results.plans import (
    known,
    line_of,
    placed,
    plan_features,
    point,
    thinned,
    time_text,
    times_of,
)
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import outlines_of

#: Positions of a track; more are thinned.
POSITIONS = 3000
# More fixes than these hide the track.
_FIXES = 150
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
        plan = one.last_plan
        planned = plan_features(plan, one.projection) if plan is not None else ()
        each = [*planned, *_of_track(one), *_of_surfacings(one)]
        for about in (each_one["properties"] for each_one in each) if vehicle else ():
            about |= {"name": f"{vehicle} {about['name']}", "vehicle": vehicle}
        found += each
    order = [*ROLES]
    return sorted(found, key=lambda one: order.index(one["properties"]["role"]))


def until(features: Sequence[Feature], time_ns: int | None) -> list[Feature]:
    """Return the features up to a time [ns, UTC]; all for None."""
    if time_ns is None:
        return [*features]
    (end,), kept = times_of(np.array([time_ns])), []
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


def place_features(series: pd.DataFrame, projection: Projection) -> list[Feature]:
    """Return the last current at each position of a table of series."""
    found = []
    for number, rows in series.groupby("place") if len(series) else ():
        last = rows.iloc[-1]
        names = ("u", "v", "u_standard_error", "v_standard_error")
        about = {"time": time_text(last["time"]), "depth_m": float(last["depth"])}
        about |= {f"{key}_m_s": known(last[key]) for key in names}
        at = point(last["longitude"], last["latitude"], projection)
        found.append(placed("Point", at, "place", f"place {number}", about))
    return found


def _of_track(contents: Contents) -> Iterator[Feature]:
    track, near = contents.track, contents.projection.longitude
    if track.time_ns.size == 0:
        return
    rows = thinned(track.time_ns.size, POSITIONS)
    at = positions(track.longitude[rows], track.latitude[rows], near)
    times = times_of(track.time_ns[rows])
    if len(at) > 1:
        depths = [known(depth) for depth in np.round(track.depth[rows], 1)]
        about = {"begin": times[0], "end": times[-1], "coordTimes": times, "depth_m": depths}
        yield placed("LineString", at, "track", "track", about)
    fixes = np.flatnonzero(~track.dead_reckoned[rows])
    # of a vessel every position is a fix, and circles around all hide the track
    if 0 < fixes.size <= min(_FIXES, 0.5 * rows.size):
        about = {"coordTimes": [times[k] for k in fixes]}
        yield placed("MultiPoint", [at[k] for k in fixes], "fix", "fixes", about)
    yield placed("Point", at[0], "begin", "begin", {"time": times[0]})
    yield placed("Point", at[-1], "vehicle", "vehicle", {"time": times[-1]})


def _of_surfacings(contents: Contents) -> Iterator[Feature]:
    table, projection = contents.result.surfacings, contents.projection
    for row in table.reset_index().itertuples():
        places = [
            point(getattr(row, f"{kind}_longitude"), getattr(row, f"{kind}_latitude"), projection)
            for kind in ("predicted", "actual")
        ]
        about = {"time": time_text(row.time), "distance_m": known(row.distance)}
        about["description"] = f"{row.distance:.0f} m apart"
        # a line joins each predicted surfacing to the actual one
        yield placed("LineString", places, "apart", "surfacing, apart", about)
        for kind, at in zip(("predicted", "actual"), places, strict=True):
            yield placed("Point", at, kind, f"surfacing, {kind}", about)
    stated = table[np.isfinite(table["ellipse_major"].to_numpy(float))] if len(table) else table
    for time, outline in zip(stated.index, outlines_of(table, projection), strict=True):
        ring, about = line_of(outline, projection), {"time": time_text(time)}
        yield placed("Polygon", [ring], "past", "90 % ellipse of a surfacing", about)
