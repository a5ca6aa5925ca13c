"""What lies on a map of the current: the track and its fixes, surfacings, the last plan and what it keeps clear of."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.colors import SYMBOLS
from replay_kit.core.geodesy import to_local
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.results.views.track import LastPlan, outlines_of, thinned
from replay_kit.show.figures.plan import plan_table
from replay_kit.show.figures.values import Layer, Mark, until
from replay_kit.show.numbers import nice

#: Positions of the track shown; more are thinned.
POSITIONS = 3000
#: More fixes than these hide the track: they are drawn when their entry of the legend is chosen.
_FIXES = 150
#: Contours of the bottom are about this many.
_CONTOURS = 7
_GAP = np.full((1, 2), np.nan)
# Around what must be seen on the field.
_EDGE = "paper"


def drawn_layers(
    contents: Contents, positions: bool = False, end_ns: int | None = None
) -> list[tuple[str, Layer]]:
    """Return what lies on the map of a result, with the vehicle that it is of, empty for the only one: all of a kind together.

    Args:
        contents: Of the result.
        positions: Whether with the single positions, for a page that shows their times.
        end_ns: What is later is left out [ns, UTC]; None leaves nothing out.
    """
    each = contents.each.items()
    tracks = {name: track_layer(one, end_ns, name) for name, one in each}
    dots = {name: position_layer(track) for name, track in tracks.items()} if positions else {}
    return [
        *((name, until(hazard_layer(one), end_ns)) for name, one in each),
        *tracks.items(),
        *dots.items(),
        *((name, until(surfacing_layer(one), end_ns)) for name, one in each),
        *((name, until(plan_layer(one), end_ns)) for name, one in each),
    ]


def track_layer(contents: Contents, time_ns: int | None = None, vehicle: str = "") -> Layer:
    """Return the track with its begin and end.

    Args:
        contents: Of the result.
        time_ns: The end [ns, UTC]; None for that of the log.
        vehicle: Its name, which stands at the end, where it is one of several.
    """
    track = contents.track
    end_ns = np.iinfo(np.int64).max if time_ns is None else time_ns
    known = int(np.searchsorted(track.time_ns, end_ns, "right"))
    if known == 0:
        return Layer()
    kept = thinned(known, POSITIONS)
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
    color, _ = SYMBOLS["track"]
    time, begin, end = table["time"], slice(1), slice(-1, None)
    marks = [
        Mark(
            "line",
            "track.east_km",
            "track.north_km",
            "track",
            color,
            halo=True,
            hover="skip",
            when="track.time",
        )
    ]
    for name, at, size, label in (
        ("begin", begin, 6.0, ""),
        ("vehicle", end, 11.0, vehicle or "vehicle"),
    ):
        x, y = table["east_km"][at], table["north_km"][at]
        about: Any = {
            "hover": f"{name} %{{text}}<extra></extra>",
            "text": time[at],
            "when": time[at],
        }
        look: Any = {"size": size, "edge": _EDGE, "label": label}
        marks.append(Mark("points", x, y, name, *SYMBOLS["vehicle"], **(look | about)))
    return Layer(marks, {"track": table})


def position_layer(track: Layer) -> Layer:
    """Return the positions of a track and the fixes among them, for a page that shows their times."""
    if not track.marks:
        return track
    table, x, y = track.tables["track"], "track.east_km", "track.north_km"
    hover = "%{text}<br>depth %{customdata} m<extra>track</extra>"
    about: Any = {"hover": hover, "text": "track.time", "detail": "track.depth_m", "size": 3.0}
    marks = [Mark("points", x, y, "positions", *SYMBOLS["track"], **about, when="track.time")]
    fixes = ~table["dead_reckoned"]
    # of a vessel every position is a fix, and circles around all hide the track
    if 0 < fixes.sum() < 0.5 * fixes.size:
        place, time = (table["east_km"][fixes], table["north_km"][fixes]), table["time"][fixes]
        about = {"hover": "fix %{text}<extra></extra>", "text": time, "size": 6.0, "when": time}
        shown = bool(fixes.sum() <= _FIXES)
        marks.append(Mark("points", *place, "fixes", *SYMBOLS["fix"], shown=shown, **about))
    return Layer(marks, {"track": table})


def surfacing_layer(contents: Contents) -> Layer:
    """Return predicted and actual surfacings with the ellipses."""
    table, projection = contents.result.surfacings, contents.projection
    if not len(table):
        return Layer()
    columns: dict[str, Any] = {"time": table.index.to_numpy()}
    marks = []
    for kind in ("predicted", "actual"):
        color, symbol = SYMBOLS[kind]
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
            "when": "surfacings.time",
        }
        x, y = (f"surfacings.{name}" for name in names[2:])
        marks.append(Mark("points", x, y, f"surfacing, {kind}", color, symbol, **about))
    # each predicted surfacing, the actual one, a gap
    ends = [
        np.column_stack([columns[f"{kind}_{axis}_km"] for kind in ("predicted", "actual")])
        for axis in ("east", "north")
    ]
    lines = [np.insert(each, 2, np.nan, axis=1).ravel() for each in ends]
    about = {"width": 1.2, "dash": "dot", "hover": "skip", "when": np.repeat(columns["time"], 3)}
    marks.insert(0, Mark("line", lines[0], lines[1], "", SYMBOLS["actual"][0], **about))
    columns["distance_m"] = table["distance"].to_numpy(np.float64)
    columns["delay_s"] = table["delay"].to_numpy(np.float64)
    if outlines := outlines_of(table, projection):
        known = np.isfinite(table["ellipse_major"].to_numpy(np.float64))
        look = SYMBOLS["predicted"][0], columns["time"][known]
        marks.append(_rings(outlines, "90 % of past surfacings", *look))
    return Layer(marks, {"surfacings": columns})


def plan_layer(contents: Contents) -> Layer:
    """Return the last plan with its start and goal; of plans before it only the end is of interest, in the section on plans."""
    plan = contents.last_plan
    if plan is None:
        return Layer()
    hover = "plan %{text}<br>depth %{customdata} m<extra></extra>"
    about: Any = {"hover": hover, "text": "plan.time", "detail": "plan.depth_m", "halo": True}
    color, _ = SYMBOLS["plan"]
    made = _made(plan)
    marks = []
    if len(plan.track):
        every = np.repeat(made, len(plan_table(plan)["time"]))
        path = "plan.east_km", "plan.north_km"
        marks.append(Mark("line", *path, "last plan", color, width=2.5, when=every, **about))
    if plan.legs:
        places = [[leg["longitude"], leg["latitude"]] for leg in plan.legs[:-1]]
        x, y = (
            each / 1e3 for each in to_local(contents.projection, *np.reshape(places, (-1, 2)).T)
        )
        texts = np.array([leg_text(leg, plan.row.name) for leg in plan.legs[:-1]])
        said: Any = {"hover": "%{text}<extra></extra>", "text": texts, "edge": _EDGE, "size": 7.0}
        when = np.repeat(made, len(places))
        marks.append(
            Mark("points", x, y, "planned surfacings", *SYMBOLS["plan"], when=when, **said)
        )
    begin = plan.start[:1] / 1e3, plan.start[1:] / 1e3
    said = {"hover": "start of the plan<extra></extra>", "size": 8.0, "edge": _EDGE}
    marks.append(Mark("points", *begin, "start", *SYMBOLS["vehicle"], when=made, **said))
    depth = plan.row["goal_depth"]
    label = f"goal, {depth:.0f} m" if np.isfinite(depth) else "goal"
    place = plan.goal[:1] / 1e3, plan.goal[1:] / 1e3
    said = {"hover": f"{label}<extra></extra>", "size": 18.0, "width": 2.5, "label": label}
    marks.append(Mark("points", *place, "goal", *SYMBOLS["goal"], when=made, **said))
    return Layer(marks, {"plan": plan_table(plan)} if len(plan.track) else {})


def leg_text(leg: Any, begin: Any) -> str:
    """Return a leg of a mission in words: when it surfaces, and what is steered until then."""
    time = str((begin + np.timedelta64(round(leg["surfacing_s"]), "s")).to_numpy())[:16]
    steer = f"{leg['heading_deg']:03.0f}° true, to {leg['depth_m']:.0f} m"
    return f"surfacing {leg['leg']}, {time.replace('T', ' ')}<br>{steer}"


def _made(plan: LastPlan) -> Any:
    """Return when the plan begins, shape (1,)."""
    return np.array([plan.row.name.to_datetime64()])


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
        marks.append(_rings(local, "no-go area", SYMBOLS["no_go"][0], None, text))
    if plan.ellipses:
        name, color, made = (
            "90 % of planned surfacings",
            SYMBOLS["plan"][0],
            _made(plan),
        )
        *earlier, last = plan.ellipses
        if earlier:
            marks.append(_rings(earlier, name, color, np.repeat(made, len(earlier))))
        end = _rings([last], name, color, made)
        marks.append(replace(end, width=1.6, label="90 % end here"))
    return Layer(marks, tables)


def dry_text(slices: CurrentSlices) -> str:
    """Return what cells without a current are, other than those that are known to lie off the forecast's grid."""
    return (
        "land, or below the bottom"
        if slices.outside is not None
        else "land, below the bottom, or outside the forecast"
    )


def contour_step(span: float) -> float:
    """Return the step between contours over a span of depths [m], at most seven contours."""
    return nice(max(span, 10.0) / _CONTOURS, least=True)


def _rings(
    rings: Sequence[Array], name: str, color: str, times: Any = None, text: Any = None
) -> Mark:
    """Return closed lines [m], each shape (n, 2), with the time of each, as one mark with gaps."""
    x, y = np.concatenate([points for ring in rings for points in (ring / 1e3, _GAP)]).T
    when = None if times is None else np.repeat(times, [len(ring) + 1 for ring in rings])
    hover = "skip" if text is None else "%{text}<extra></extra>"
    look: Any = {"width": 1.2, "hover": hover, "text": text, "when": when}
    return Mark("ring", x, y, name, color, **look)
