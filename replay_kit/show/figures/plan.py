"""Figures of plans: depth profile of the last one, and errors of predicted surfacings."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Plan
from replay_kit.results.plans import thinned
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import along
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel

_POINTS = 1000
#: A bottom farther below the plan than this share of its depth is not drawn: dives would be flat.
_BELOW = 2.5


def plan_table(plan: Plan, projection: Projection) -> dict[str, Any]:
    """Return the track of a plan as columns, thinned for display."""
    kept = thinned(len(plan.track), _POINTS)
    east, north, depth = plan.track[kept].T
    longitude, latitude = to_geographic(projection, east, north)
    times = plan.start_time_ns + np.rint(1e9 * plan.track_time[kept]).astype(np.int64)
    return {
        "time": times.astype("datetime64[ns]"),
        "hours": plan.track_time[kept] / 3600.0,
        "longitude": longitude,
        "latitude": latitude,
        "depth_m": depth,
        "distance_km": along(*plan.track[:, :2].T)[kept] / 1e3,
        "east_km": east / 1e3,
        "north_km": north / 1e3,
    }


def profile_figure(contents: Contents, plan: Plan) -> Figure:
    """Return the depth profile of the last plan over the bottom."""
    table, kept = plan_table(plan, contents.projection), thinned(len(plan.track), _POINTS)
    far, depth, hours = (table[name] for name in ("distance_km", "depth_m", "hours"))
    ground = None if plan.bottom is None else plan.bottom[kept]
    floor, x, marks, below = profile_floor(depth, ground), "plan.distance_km", [], ""
    if ground is not None:
        table["bottom_m"], below = ground, _over(ground, floor)
        look: Any = {"color": "ink", "width": 1.5, "base": np.full(far.size, floor)}
        marks = [Mark("line", x, "plan.bottom_m", "bottom", **look)]
    elif (level := _deepest_wet(contents, *plan.track[kept, :2].T)) is not None:
        table["deepest_wet_level_m"], below = level, _below(level)
        floor = max(floor, 1.05 * float(level.max()))
        y = "plan.deepest_wet_level_m"
        marks = [Mark("line", x, y, "deepest wet level", "ink", width=1.5)]
    marks.append(Mark("line", x, "plan.depth_m", "planned depth", text="plan.time"))
    over = "" if ground is None else ", over the bottom"
    axes = Axis("distance along the plan", "km"), Axis("depth", "m", (floor, 0.0))
    return Figure(
        "plan-profile",
        "Depth profile of the last plan",
        [Panel("depth along the plan", *axes, marks, shares_legend=True)],
        {"plan": table},
        f"Depth of the last plan along its predicted track, {far[-1]:.1f} km in {hours[-1]:.1f} hours. {below}",
        f"Depth against distance along the last plan, {far[-1]:.0f} km long{over}.",
    )


def profile_floor(depth: Array, ground: Array | None) -> float:
    """Return the lower limit of a depth profile [m]: below the bottom, unless that is far below the plan.

    Args:
        depth: Depth of the plan, shape (n,) [m].
        ground: Depth of the bottom, shape (n,) [m]; NaN if unknown, None without a bathymetry.
    """
    deepest = max(float(depth.max()), 1.0)
    return 1.05 * (
        deepest if ground is None else max(deepest, min(float(np.nanmax(ground)), _BELOW * deepest))
    )


def _over(ground: Array, floor: float) -> str:
    text = "Filled: the bottom of the bathymetry, interpolated linearly; plans keep above the shallowest of the four points around."
    if (ground > floor).any():
        text += f" Where it is not shown it is deeper than {floor:.0f} m: it is {np.nanmin(ground):.0f} to {np.nanmax(ground):.0f} m deep."
    return text


def _below(level: Array) -> str:
    """Return a sentence on the bottom along a plan without a bathymetry."""
    if level.min() < level.max():
        return "The line below is the deepest wet level of the forecast; the bottom lies between it and the next level."
    return "The forecast is wet down to its last level all along the plan."


def _deepest_wet(contents: Contents, east: Array, north: Array) -> Any:
    """Return the deepest wet level at the nearest grid points [m]; None without an estimate."""
    if contents.estimate is None:
        return None
    grid = contents.estimate.grid
    nearest = [
        int(np.argmin((grid.east - e) ** 2 + (grid.north - n) ** 2))
        for e, n in zip(east, north, strict=True)
    ]
    wet = grid.wet.reshape(grid.levels.size, -1)
    deepest = np.where(
        wet.any(axis=0), grid.levels[grid.levels.size - 1 - np.argmax(wet[::-1], axis=0)], 0.0
    )
    return deepest[nearest]


def surfacing_figure(contents: Contents) -> Figure:
    """Return the actual surfacings relative to those predicted by the previous plans."""
    table = contents.result.surfacings
    radians = np.deg2rad(table["direction_deg"].to_numpy(np.float64))
    distance = table["distance"].to_numpy(np.float64) / 1e3
    data = {
        "time": table.index.to_numpy(),
        "east_km": distance * np.sin(radians),
        "north_km": distance * np.cos(radians),
        "delay_min": table["delay"].to_numpy(np.float64) / 60.0,
        "inside_ellipse": table["inside_ellipse"].to_numpy(bool),
    }
    reach = float(f"{1.15 * max(distance.max(), 0.1):.3g}")
    x, y = (f"surfacing_errors.{axis}_km" for axis in ("east", "north"))
    points = Mark("points", x, y, "surfacing", size=9.0, text="surfacing_errors.time")
    ends = -reach, reach
    axes = Axis("east of the prediction", "km", ends), Axis("north of the prediction", "km", ends)
    return Figure(
        "surfacing-errors",
        "Predicted and actual surfacings",
        [Panel("surfacings", *axes, [points], equal=True)],
        {"surfacing_errors": data},
        "Each point is an actual surfacing relative to the one predicted by the previous plan. A cloud off the "
        "centre means that the estimate lacks a current, or that another plan was flown.",
        f"Error of {len(table)} predicted surfacings, east and north.",
    )
