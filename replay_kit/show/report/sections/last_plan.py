"""The last plan: its outcome, energy and odds in words, and its depth over the bottom."""

from html import escape
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.results.views.track import thinned
from replay_kit.show.page.section import Figure, column, number, table_html

_POINTS = 3000
#: A bottom farther below the plan than this share of its depth is not drawn: dives would be flat.
_BELOW = 2.5
_STATUS = {
    "reached": "the predicted path passes the goal within the tolerance",
    "uncertain": "the predicted path passes the goal, but fewer samples of the estimate than asked for arrive",
    "partial": "the predicted path ends at the horizon that was asked for, before the goal",
    "unsafe": "the predicted path, or more samples of the estimate than accepted, violates a constraint",
    "unreachable": "the best path found does not pass the goal within the tolerance",
    "failed": "no usable path was found",
}


def last_plan_html(contents: Contents, plan: LastPlan) -> str:
    """Return the outcome of the last plan as a table."""
    row = plan.row
    rows = [
        ["status", f"<strong>{escape(row['status'])}</strong>: {_STATUS.get(row['status'], '')}"],
        ["message", escape(row["message"])],
    ]
    rows += [["energy", _energy(plan.energy, plan.battery)]] if plan.energy is not None else []
    rows += [["odds of arriving", odds]] if (odds := _odds(plan)) else []
    if plan.areas:
        rows.append(
            [
                "no-go areas",
                ", ".join(
                    escape(area.name + (" (surface only)" if area.surface_only else ""))
                    for area in plan.areas
                ),
            ]
        )
    if (
        named := contents.record.metadata.get("replay_kit.inputs", {}).get("bathymetry")
    ) is not None:
        name, _, digest = named.partition(" sha256:")
        rows.append(["bathymetry", f"{escape(name)}, SHA-256 <code>{escape(digest)}</code>"])
    if (bottom := plan.bottom) is not None:
        height = float(np.nanmin(bottom - plan.track["depth"].to_numpy(np.float64)))
        rows.append(["least height above the bottom", f"{height:.0f} m"])
    return table_html(["what", "of the last plan"], rows, "The last plan")


def _energy(energy: float, battery: float | None) -> str:
    text = number("plan.energy_j", energy, f"{energy / 1e3:,.0f} kJ")
    if battery is None:
        return f"{text}; the energy of the battery was not stated"
    stated = number("plan.battery_j", battery, f"{battery / 1e6:g} MJ")
    return f"{text}, {100.0 * energy / battery:.1f} % of {stated}" + (
        ": more than the battery holds" if energy > battery else ""
    )


def _odds(plan: LastPlan) -> str:
    odds = plan.odds
    if odds is None:
        return ""
    said = {
        name: number(f"plan.odds.{name}", odds[name], f"{100.0 * odds[name]:.0f} %")
        for name in ("reached", "reached_held", "safe")
    }
    count = number("plan.odds.n_samples", odds["n_samples"], f"{odds['n_samples']:.0f}")
    median, most = (
        number(f"plan.odds.{name}", odds[name], f"{odds[name]:,.0f} m")
        for name in ("miss_median", "miss_90_percent")
    )
    return (
        f"{said['reached']} of {count} samples of the estimate arrive with headings corrected at each surfacing, "
        f"{said['reached_held']} with headings held; "
        f"{said['safe']} violate no constraint; they end {median} off in the median, 90 % within {most}"
    )


def what_is_missing(plan: LastPlan) -> list[str]:
    """Return what the result does not hold of its last plan, and what would give it."""
    out = []
    if plan.energy is None:
        out.append(
            "The result holds no energy of the plan: a single glide has none, a mission (--planner mission) has."
        )
    if plan.odds is None and plan.row["status"] != "failed":
        out.append(
            "The result holds no odds of arriving: [planner] samples = 40 flies each mission through as many samples of the estimate."
        )
    if plan.bottom is None:
        out.append(
            "The result holds no depth of the bottom: --bathymetry keeps plans above it and shows it here."
        )
    return out


def profile_figure(contents: Contents, plan: LastPlan) -> Figure:
    """Return the depth of the last plan along its way, over the bottom."""
    kept = thinned(len(plan.track), _POINTS)
    track, along = plan.track.iloc[kept], plan.along[kept] / 1e3
    hours = (track.index - track.index[0]).total_seconds().to_numpy() / 3600.0
    depth = track["depth"].to_numpy(np.float64)
    table: dict[str, Any] = {
        "time": [str(time)[:19] for time in track.index],
        "hours": column(hours),
        "distance_km": column(along),
        "depth_m": column(depth),
        "longitude": column(track["longitude"], 9),
        "latitude": column(track["latitude"], 9),
    }
    path = {
        "type": "scatter",
        "mode": "lines",
        "name": "planned depth",
        "x": "$plan.distance_km",
        "y": "$plan.depth_m",
        "text": "$plan.time",
        "line": {"color": {"$color": "two"}, "width": 1.8},
        "hovertemplate": "%{text}<br>%{x:.1f} km, %{y:.0f} m<extra></extra>",
    }
    ground = None if plan.bottom is None else plan.bottom[kept]
    level = (
        None if ground is not None else _deepest_wet(contents, plan.east[kept], plan.north[kept])
    )
    floor = profile_floor(depth, ground)
    under = [] if ground is None else _ground(along, ground, floor, table)
    if level is not None:
        table["deepest_wet_level_m"] = column(level)
        line = {"color": {"$color": "ink"}, "width": 1.5, "shape": "hvh"}
        under = [
            {**path, "name": "deepest wet level", "y": "$plan.deepest_wet_level_m", "line": line}
        ]
    layout = {
        "height": 400,
        "xaxis": {"title": {"text": "distance along the plan [km]"}},
        "yaxis": {
            "title": {"text": "depth [m]"},
            **({"autorange": "reversed"} if ground is None else {"range": [floor, 0.0]}),
        },
    }
    caption = f"Depth that the last plan reaches along its predicted track, {along[-1]:.1f} km in {hours[-1]:.1f} hours. "
    return Figure(
        "plan-profile",
        "Depth profile of the last plan",
        caption + (_below(level) if ground is None else _over(ground, floor)),
        f"Depth against distance along the last plan, {along[-1]:.0f} km long{'' if ground is None else ', over the bottom'}.",
        {"plan": table},
        [*under, path],
        layout,
    )


def profile_floor(depth: Array, ground: Array | None) -> float:
    """Return the depth [m] at which a profile ends below: somewhat below the bottom, unless that lies far below the plan.

    Args:
        depth: shape (n,) [m], of the plan.
        ground: shape (n,) [m], of the bottom, NaN where unknown; None without.
    """
    deepest = max(float(depth.max()), 1.0)
    return 1.05 * (
        deepest if ground is None else max(deepest, min(float(np.nanmax(ground)), _BELOW * deepest))
    )


def _ground(
    along: Array, ground: Array, floor: float, table: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return the bottom as a line over a filled area, and add it to the table."""
    table["bottom_m"] = column(ground)
    common = {"type": "scatter", "mode": "lines", "x": "$plan.distance_km"}
    below = {
        **common,
        "y": column(np.full(along.size, floor)),
        "line": {"width": 0},
        "showlegend": False,
        "hoverinfo": "skip",
    }
    hover = "%{x:.1f} km: bottom at %{y:.0f} m<extra></extra>"
    look = {
        "fill": "tonexty",
        "fillcolor": {"$color": "land"},
        "line": {"color": {"$color": "ink"}, "width": 1.5},
        "hovertemplate": hover,
    }
    return [below, {**common, "name": "bottom", "y": "$plan.bottom_m", **look}]


def _over(ground: Array, floor: float) -> str:
    text = "The filled area is the bottom of the bathymetry, linear between its points; plans keep above the shallowest of four."
    if (ground > floor).any():
        text += f" Where it is not seen it lies deeper than {floor:.0f} m: it is {np.nanmin(ground):.0f} to {np.nanmax(ground):.0f} m deep."
    return text


def _below(level: Any) -> str:
    """Return what is known of the bottom along a plan without a bathymetry."""
    if level is None:
        return ""
    if level.min() < level.max():
        return "The line below is the deepest level of the forecast that is wet there; the bottom lies between it and the next level."
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
