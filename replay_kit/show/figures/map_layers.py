"""What lies on a map of the current: the track and its fixes, surfacings, the last plan and what it keeps clear of."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.results.views.track import outlines_of, thinned
from replay_kit.show.colors import NO_GO, ON_FIELD, PRINT
from replay_kit.show.figures.plan import plan_table
from replay_kit.show.figures.values import Layer, Mark

#: Positions of the track shown; more are thinned.
POSITIONS = 3000
#: More fixes than these hide the track: they are drawn when their entry of the legend is chosen.
_FIXES = 150
#: Contours of the bottom are about this many.
_CONTOURS = 7
_GAP = np.full((1, 2), np.nan)
# The field below has the same colours on every page and in print.
_TRACK, _PLAN, _SURFACING = PRINT["two"], PRINT["one"], PRINT["four"]


def contrast(contents: Contents) -> str:
    """Return the colour of marks that must be seen on the field, or on the page where there is no field."""
    return "ink" if contents.slices is None else ON_FIELD


def track_layer(contents: Contents) -> Layer:
    """Return the track with its begin and end."""
    track = contents.track
    if track.time_ns.size == 0:
        return Layer()
    kept = thinned(track.time_ns.size, POSITIONS)
    table = {
        "time": track.time_ns[kept].astype("datetime64[ns]"),
        "longitude": track.longitude[kept],
        "latitude": track.latitude[kept],
        "depth_m": track.depth[kept],
        "east_km": track.east[kept] / 1e3,
        "north_km": track.north[kept] / 1e3,
        "hours": (track.time_ns - track.time_ns[0])[kept] / 3.6e12,
        "dead_reckoned": track.dead_reckoned[kept],
    }
    look: Any = {"color": _TRACK, "halo": True, "hover": "skip"}
    marks = [Mark("line", "track.east_km", "track.north_km", "track", **look)]
    for name, end, symbol in (("begin", slice(1), "circle"), ("end", slice(-1, None), "square")):
        place = table["east_km"][end], table["north_km"][end]
        look = {"size": 8.0, "edge": "#ffffff", "hover": f"{name}<extra></extra>"}
        marks.append(Mark("points", *place, name, _TRACK, symbol, **look))
    return Layer(marks, {"track": table})


def position_layer(track: Layer) -> Layer:
    """Return the positions of a track coloured by time, and the fixes among them, for a page that shows their times."""
    if not track.marks:
        return track
    table, x, y = track.tables["track"], "track.east_km", "track.north_km"
    hover = "%{text}<br>depth %{customdata} m<extra>track</extra>"
    about: Any = {"hover": hover, "text": "track.time", "detail": "track.depth_m", "size": 5.0}
    marks = [Mark("points", x, y, "positions", shade=("track.hours", "thermal", ""), **about)]
    fixes = ~table["dead_reckoned"]
    # of a vessel every position is a fix, and circles around all hide the track
    if 0 < fixes.sum() < 0.5 * fixes.size:
        place = table["east_km"][fixes], table["north_km"][fixes]
        about = {"hover": "fix %{text}<extra></extra>", "text": table["time"][fixes], "size": 9.0}
        shown = bool(fixes.sum() <= _FIXES)
        marks.append(Mark("points", *place, "fixes", ON_FIELD, "circle-open", shown=shown, **about))
    return Layer(marks)


def surfacing_layer(contents: Contents) -> Layer:
    """Return predicted and actual surfacings with the ellipses."""
    table, projection = contents.result.surfacings, contents.projection
    if not len(table):
        return Layer()
    columns: dict[str, Any] = {"time": table.index.to_numpy()}
    marks = []
    for kind, symbol, color in (
        ("predicted", "diamond", _SURFACING),
        ("actual", "x", contrast(contents)),
    ):
        places = [
            table[f"{kind}_{name}"].to_numpy(np.float64) for name in ("longitude", "latitude")
        ]
        places += [values / 1e3 for values in to_local(projection, *places)]
        names = [f"{kind}_{name}" for name in ("longitude", "latitude", "east_km", "north_km")]
        columns |= dict(zip(names, places, strict=True))
        about: Any = {
            "hover": f"{kind} %{{text}}<br>%{{customdata:.0f}} m apart<extra></extra>",
            "text": "surfacings.time",
            "detail": "surfacings.distance_m",
        }
        x, y = (f"surfacings.{name}" for name in names[2:])
        marks.append(Mark("points", x, y, f"surfacing, {kind}", color, symbol, **about))
    columns["distance_m"] = table["distance"].to_numpy(np.float64)
    columns["delay_s"] = table["delay"].to_numpy(np.float64)
    if outlines := outlines_of(table, projection):
        marks.append(_rings(outlines, "90 % ellipse", _SURFACING))
    return Layer(marks, {"surfacings": columns})


def plan_layer(contents: Contents) -> Layer:
    """Return the last plan with its start and goal; of plans before it only the end is of interest, in the section on plans."""
    plan = contents.last_plan
    if plan is None:
        return Layer()
    hover = "plan %{text}<br>depth %{customdata} m<extra></extra>"
    about: Any = {"hover": hover, "text": "plan.time", "detail": "plan.depth_m", "halo": True}
    path = Mark("line", "plan.east_km", "plan.north_km", "last plan", _PLAN, width=2.5, **about)
    ends = []
    for name, at, symbol in (("start", plan.start, "circle"), ("goal", plan.goal, "star")):
        about = {"edge": ON_FIELD, "hover": f"{name}<extra></extra>"}
        about["size"] = 16.0 if symbol == "star" else 9.0
        ends.append(Mark("points", at[:1] / 1e3, at[1:] / 1e3, name, _SURFACING, symbol, **about))
    return Layer([path, *ends], {"plan": plan_table(plan)}) if len(plan.track) else Layer(ends)


def hazard_layer(contents: Contents) -> Layer:
    """Return the areas that the last plan keeps out of, and the ellipses of its surfacings."""
    plan = contents.last_plan
    if plan is None:
        return Layer()
    marks, tables, rings, names = [], {}, [], []
    for area in plan.areas:
        rings.append(np.array([*area.corners, area.corners[0]]))
        names.append(f"{area.name} (surface only)" if area.surface_only else area.name)
    if rings:
        longitude, latitude = np.concatenate(rings).T
        sizes = [len(ring) for ring in rings]
        area_column = np.repeat(names, sizes)
        tables["no_go_areas"] = {"area": area_column, "longitude": longitude, "latitude": latitude}
        text = np.insert(area_column.astype(object), np.cumsum(sizes), "").astype(str)
        local = [np.column_stack(to_local(contents.projection, *ring.T)) for ring in rings]
        marks.append(_rings(local, "no-go area", NO_GO, "ring", text))
    if plan.ellipses:
        marks.append(_rings(plan.ellipses, "90 % of planned surfacings", _PLAN))
    return Layer(marks, tables)


def coastline(slices: CurrentSlices) -> tuple[Array, Array]:
    """Return the edges between wet and dry cells of the shallowest slice as a line with gaps: east and north [km].

    Cells that are known to lie off the forecast's grid are neither.
    """
    wet = np.isfinite(slices.fields[0, -1, 0])
    dry = ~wet if slices.outside is None else ~wet & ~slices.outside
    half = 0.5 * np.array([slices.east[1] - slices.east[0], slices.north[1] - slices.north[0]])
    edges = [np.empty((0, 2))]
    # between neighbours in east, whose edge runs north, and the other way around
    for step, along in (((0, 1), (0.0, 1.0)), ((1, 0), (1.0, 0.0))):
        here, there = (slice(None, -k or None) for k in step), (slice(k, None) for k in step)
        one, other = tuple(here), tuple(there)
        for j, i in zip(*np.nonzero(wet[one] & dry[other] | dry[one] & wet[other]), strict=True):
            first = np.array([slices.east[i], slices.north[j]])
            second = np.array([slices.east[i + step[1]], slices.north[j + step[0]]])
            ends = 0.5 * (first + second) + half * np.outer([-1.0, 1.0], along)
            edges += [ends / 1e3, _GAP]
    east, north = np.concatenate(edges).T
    return east, north


def coast_layer(slices: CurrentSlices) -> Layer:
    """Return the coast, which may be the edge of the forecast where that is not known; nothing without one."""
    name = "coast" if slices.outside is not None else "coast, or edge of the forecast"
    east, north = coastline(slices)
    mark = Mark("line", east, north, name, ON_FIELD, width=1.5, hover="skip")
    return Layer([mark]) if east.size else Layer()


def dry_text(slices: CurrentSlices) -> str:
    """Return what cells without a current are, other than those that are known to lie off the forecast's grid."""
    return (
        "land, or below the bottom"
        if slices.outside is not None
        else "land, below the bottom, or outside the forecast"
    )


def contour_step(span: float) -> float:
    """Return the step between contours over a span of depths [m]: 1, 2 or 5 times a power of ten, at most seven contours."""
    span = max(span, 10.0)
    power = 10.0 ** np.floor(np.log10(span / _CONTOURS))
    return float(
        power
        * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power * _CONTOURS >= span)
    )


def _rings(
    rings: Iterable[Array], name: str, color: str, kind: Any = "line", text: Any = None
) -> Mark:
    """Return closed lines [m], each shape (n, 2), as one mark with gaps."""
    x, y = np.concatenate([points for ring in rings for points in (ring / 1e3, _GAP)]).T
    hover = "skip" if text is None else ""
    return Mark(kind, x, y, name, color, width=1.2, hover=hover, text=text)
