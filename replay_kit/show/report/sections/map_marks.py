"""What lies on the map: the track and its fixes, predicted and actual surfacings, the last plan."""

from typing import Any

import numpy as np

from replay_kit.core.geodesy import to_local
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.surfacings import outlines_of
from replay_kit.results.views.track import thinned
from replay_kit.show.colors import scale
from replay_kit.show.page.section import column, times

#: Positions of the track shown; more are thinned.
POSITIONS = 3000
#: More fixes than these hide the track: they are drawn when their entry of the legend is chosen.
_FIXES = 150
#: Of marks on the field, whose colours are the same on a light and a dark page.
DARK = "rgb(15,25,35)"


def mark_color(contents: Contents) -> Any:
    """Return the colour of marks that must be seen on the field, or on the page where there is no field."""
    return {"$color": "ink"} if contents.slices is None else DARK


def track_marks(contents: Contents) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the track coloured by time, and the fixes among its positions."""
    track = contents.track
    if track.time_ns.size == 0:
        return {}, []
    kept = thinned(track.time_ns.size, POSITIONS)
    hours = (track.time_ns - track.time_ns[0])[kept] / 3.6e12
    table = {
        "time": times(track.time_ns[kept]),
        "longitude": column(track.longitude[kept], 9),
        "latitude": column(track.latitude[kept], 9),
        "depth_m": column(track.depth[kept]),
        "east_km": column(track.east[kept] / 1e3, 6),
        "north_km": column(track.north[kept] / 1e3, 6),
        "hours": column(hours),
        "dead_reckoned": track.dead_reckoned[kept].astype(int).tolist(),
    }
    path = {
        "type": "scatter",
        "mode": "lines+markers",
        "name": "track",
        "x": "$track.east_km",
        "y": "$track.north_km",
        "text": "$track.time",
        "customdata": "$track.depth_m",
        "line": {"color": "rgba(255,255,255,0.85)", "width": 3},
        "marker": {
            "size": 5,
            "color": "$track.hours",
            "colorscale": scale("thermal"),
            "showscale": False,
        },
        "hovertemplate": "%{text}<br>depth %{customdata} m<extra>track</extra>",
    }
    fixes = np.flatnonzero(~track.dead_reckoned[kept])
    at = {
        "x": [table["east_km"][k] for k in fixes],
        "y": [table["north_km"][k] for k in fixes],
        "text": [table["time"][k] for k in fixes],
    }
    fix = {
        "type": "scatter",
        "mode": "markers",
        "name": "fixes",
        **at,
        "visible": True if fixes.size <= _FIXES else "legendonly",
        "marker": {
            "symbol": "circle-open",
            "size": 9,
            "color": mark_color(contents),
            "line": {"width": 1.4},
        },
        "hovertemplate": "fix %{text}<extra></extra>",
    }
    # of a vessel every position is a fix, and circles around all hide the track
    return {"track": table}, [path, *([fix] if 0 < fixes.size < 0.5 * kept.size else [])]


def surfacing_marks(contents: Contents) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return predicted and actual surfacings with the ellipses."""
    table, projection = contents.result.surfacings, contents.projection
    if not len(table):
        return {}, []
    columns: dict[str, Any] = {"time": [str(time)[:19] for time in table.index]}
    for kind in ("predicted", "actual"):
        longitude, latitude = (
            table[f"{kind}_{name}"].to_numpy(np.float64) for name in ("longitude", "latitude")
        )
        east, north = to_local(projection, longitude, latitude)
        columns |= {
            f"{kind}_longitude": column(longitude, 9),
            f"{kind}_latitude": column(latitude, 9),
            f"{kind}_east_km": column(east / 1e3, 6),
            f"{kind}_north_km": column(north / 1e3, 6),
        }
    columns |= {"distance_m": column(table["distance"]), "delay_s": column(table["delay"])}
    outlines = [
        point
        for outline in outlines_of(table, projection)
        for point in [*(outline / 1e3).tolist(), [None, None]]
    ]
    common = {
        "type": "scatter",
        "mode": "markers",
        "text": "$surfacings.time",
        "customdata": "$surfacings.distance_m",
    }
    traces: list[dict[str, Any]] = [
        {
            **common,
            "name": f"surfacing, {kind}",
            "x": f"$surfacings.{kind}_east_km",
            "y": f"$surfacings.{kind}_north_km",
            "marker": {
                "symbol": symbol,
                "size": 9,
                "color": color,
                "line": {"width": 1, "color": "white"},
            },
            "hovertemplate": f"{kind} %{{text}}<br>%{{customdata:.0f}} m apart<extra></extra>",
        }
        for kind, symbol, color in (
            ("predicted", "diamond", {"$color": "four"}),
            ("actual", "x", mark_color(contents)),
        )
    ]
    if outlines:
        x, y = ([point[k] for point in outlines] for k in (0, 1))
        line = {"color": {"$color": "four"}, "width": 1.2}
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "90 % ellipse",
                "x": x,
                "y": y,
                "line": line,
                "hoverinfo": "skip",
            }
        )
    return {"surfacings": columns}, traces


def plan_marks(contents: Contents) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the last plan's track and its goal; of plans before it only the end is of interest, in the section on plans."""
    plan = contents.last_plan
    if plan is None:
        return {}, []
    kept = thinned(len(plan.track), POSITIONS)
    last, east, north = plan.track.iloc[kept], plan.east[kept], plan.north[kept]
    goal = to_local(contents.projection, plan.row["goal_longitude"], plan.row["goal_latitude"])
    table = {
        "time": [str(time)[:19] for time in last.index],
        "longitude": column(last["longitude"], 9),
        "latitude": column(last["latitude"], 9),
        "depth_m": column(last["depth"]),
        "east_km": column(east / 1e3, 6),
        "north_km": column(north / 1e3, 6),
    }
    path = {
        "type": "scatter",
        "mode": "lines",
        "name": "last plan",
        "x": "$plan.east_km",
        "y": "$plan.north_km",
        "text": "$plan.time",
        "customdata": "$plan.depth_m",
        "line": {"color": {"$color": "two"}, "width": 2.5, "dash": "dash"},
        "hovertemplate": "plan %{text}<br>depth %{customdata} m<extra></extra>",
    }
    star = {
        "type": "scatter",
        "mode": "markers",
        "name": "goal",
        "x": column(np.array([goal[0]]) / 1e3, 6),
        "y": column(np.array([goal[1]]) / 1e3, 6),
        "marker": {
            "symbol": "star",
            "size": 15,
            "color": {"$color": "two"},
            "line": {"width": 1, "color": {"$color": "ink"}},
        },
        "hovertemplate": "goal<extra></extra>",
    }
    return ({"plan": table} if len(last) else {}), [*([path] if len(last) else []), star]
