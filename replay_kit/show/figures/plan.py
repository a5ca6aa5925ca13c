"""Figures of plans: depth profile of the last one, and errors of predicted surfacings."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.plan import Plan
from replay_kit.results.innovations import thinned
from replay_kit.results.views.along_track import along
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel

_POINTS = 1000
#: A bottom farther below the plan than this share of its depth is not drawn: dives would be flat.
_BELOW = 2.5


def profile_figure(contents: Contents, plan: Plan) -> Figure:
    """Return the depth profile of the last plan over the bottom."""
    kept = thinned(len(plan.track), _POINTS)
    far, depth = along(*plan.track[:, :2].T)[kept] / 1e3, plan.track[kept, 2]
    ground = None if plan.bottom is None else plan.bottom[kept]
    floor, marks, below = profile_floor(depth, ground), [], ""
    if ground is not None:
        look: Any = {"color": "ink", "width": 1.5, "base": np.full(far.size, floor)}
        marks, below = [Mark("line", far, ground, "bottom", **look)], _over(ground, floor)
    elif (level := _deepest_wet(contents, plan.track[kept])) is not None:
        floor = max(floor, 1.05 * float(level.max()))
        marks = [Mark("line", far, level, "deepest wet level", "ink", width=1.5)]
        below = "The forecast is wet down to its last level all along the plan."
        if level.min() < level.max():
            below = "The line below is the deepest wet level of the forecast; the bottom lies between it and the next level."
    times = plan.start_time_ns + np.rint(1e9 * plan.track_time[kept]).astype(np.int64)
    text = times.astype("datetime64[ns]")
    marks.append(Mark("line", far, depth, "planned depth", text=text))
    over, hours = "" if ground is None else ", over the bottom", plan.track_time[-1] / 3600.0
    axes = Axis("distance along the plan", "km"), Axis("depth", "m", (floor, 0.0))
    return Figure(
        "plan-profile",
        "Depth profile of the last plan",
        [Panel("depth along the plan", *axes, marks, shares_legend=True)],
        f"Depth of the last plan along its predicted track, {far[-1]:.1f} km in {hours:.1f} hours. {below}",
        f"Depth against distance along the last plan, {far[-1]:.0f} km long{over}.",
    )


def profile_floor(depth: Array, ground: Array | None) -> float:
    """Return the lower limit of a depth profile [m]: below the bottom, unless that is far below the plan.

    Args:
        depth: Depth of the plan, shape (n,) [m].
        ground: Depth of the bottom, shape (n,) [m]; NaN if unknown, None without a bathymetry.
    """
    deepest = max(float(depth.max()), 1.0)
    lowest = deepest if ground is None else min(float(np.nanmax(ground)), _BELOW * deepest)
    return 1.05 * max(deepest, lowest)


def _over(ground: Array, floor: float) -> str:
    text = "Filled: the bottom of the bathymetry, interpolated linearly; plans keep above the shallowest of the four points around."
    if (ground > floor).any():
        text += f" Where it is not shown it is deeper than {floor:.0f} m: it is {np.nanmin(ground):.0f} to {np.nanmax(ground):.0f} m deep."
    return text


def _deepest_wet(contents: Contents, track: Array) -> Any:
    """Return the deepest wet level at the grid points nearest to a track, shape (n, 3) [m]; None without an estimate."""
    if contents.estimate is None:
        return None
    grid = contents.estimate.grid
    nearest = [int(np.argmin((grid.east - e) ** 2 + (grid.north - n) ** 2)) for e, n, _ in track]
    wet = grid.wet.reshape(grid.levels.size, -1)[:, nearest]
    return np.max(np.where(wet, grid.levels[:, None], 0.0), axis=0)


def surfacing_figure(contents: Contents) -> Figure:
    """Return the actual surfacings relative to those predicted by the previous plans."""
    table = contents.result.surfacings
    radians = np.deg2rad(table["direction_deg"].to_numpy(np.float64))
    distance = table["distance"].to_numpy(np.float64) / 1e3
    east_km, north_km = distance * np.sin(radians), distance * np.cos(radians)
    points = Mark("points", east_km, north_km, "surfacing", size=9.0, text=table.index.to_numpy())
    reach = float(f"{1.15 * max(distance.max(), 0.1):.3g}")
    x, y = (Axis(f"{end} of the prediction", "km", (-reach, reach)) for end in ("east", "north"))
    return Figure(
        "surfacing-errors",
        "Predicted and actual surfacings",
        [Panel("surfacings", x, y, [points], equal=True)],
        "Each point is an actual surfacing relative to the one predicted by the previous plan. A cloud off the "
        "centre means that the estimate lacks a current, or that another plan was flown.",
        f"Error of {len(table)} predicted surfacings, east and north.",
    )
