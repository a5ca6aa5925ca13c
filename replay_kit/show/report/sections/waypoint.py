"""A plan whose waypoints can be moved on the page: the estimate and samples of it are inside, and the glider is flown through them."""

import tomllib
from typing import Any

import numpy as np

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.results.views.steering import (
    LEAST_DIVE,
    STEPS,
    TRIES,
    Arrival,
    Dives,
    GriddedCurrents,
    fly_to_waypoints,
    gridded_currents,
)
from replay_kit.results.views.track import thinned
from replay_kit.show.figures.map_layers import plan_layer
from replay_kit.show.figures.on_page import traces_of
from replay_kit.show.page.section import Control, Figure, column, pack
from replay_kit.show.report.sections.map_frame import arrows, map_layout

_SAMPLES, _SEED = 16, 0
#: Weights of the largest estimate that is sampled: the time grows with their cube.
_SAMPLED = 2500
#: Levels of the currents, and places of each slider.
_LEVELS, _PLACES = 8, 101
#: On the plan's way.
_WAYPOINTS = 5


def waypoint_figure(contents: Contents) -> Figure | None:
    """Return the last plan's way with waypoints to move; None without an estimate or a plan."""
    flow, plan = contents.estimate, contents.last_plan
    if flow is None or plan is None:
        return None
    start, goal, dives = plan.start, plan.goal, _dives(contents)
    levels = flow.levels[thinned(flow.levels.size, _LEVELS)]
    samples = _SAMPLES if 0 < flow.n_modes * flow.levels.size <= _SAMPLED else 0
    currents = gridded_currents(flow, levels, samples, _SEED)
    waypoints = _waypoints(plan)
    places = _places(currents, np.vstack([start, *waypoints, goal]))
    arrivals = [
        fly_to_waypoints(currents, k, dives, start, [*waypoints, goal])
        for k in range(len(currents.velocity))
    ]
    chosen = [int(np.argmin(np.abs(axis - waypoints[0][k]))) for k, axis in enumerate(places)]
    controls = [
        Control("Waypoint", "select", [str(k + 1) for k in range(len(waypoints))]),
        *(
            Control(name, "range", [f"{value / 1e3:.1f} km" for value in axis], k)
            for name, axis, k in zip(("East", "North"), places, chosen, strict=True)
        ),
    ]
    return Figure(
        "waypoint",
        "Move a waypoint",
        _caption(samples, dives),
        "Map of the way from the plan's start over waypoints to its goal, flown in the estimate and in samples of it; "
        "two sliders move the waypoint chosen.",
        {"flights": _table(arrivals)},
        _traces(contents, currents),
        _layout(places),
        controls,
        {
            "currents": pack(
                currents.velocity, max(float(np.abs(currents.velocity).max()), 1e-3) / 32_000.0
            )
        },
        _flight(currents, dives, [start, *waypoints, goal], places),
        readout(arrivals, dives.radius),
    )


def readout(arrivals: list[Arrival], tolerance: float) -> str:
    """Return when a glider arrives, how far it misses and how likely it is near, in words that ``page.js`` writes alike.

    Args:
        arrivals: In the estimate's mean, then in samples.
        tolerance: Within which the goal is reached [m].
    """
    mean, samples = arrivals[0], arrivals[1:]
    verb = (
        f"arrives after {mean.duration / 3600.0:.1f} h"
        if mean.arrived
        else f"has not arrived after {mean.duration / 3600.0:.1f} h"
    )
    text = f"In the estimate the glider {verb}, {mean.miss:.0f} m from the goal."
    if not samples:
        return text
    near = sum(arrival.arrived and arrival.miss <= tolerance for arrival in samples)
    hours = [arrival.duration / 3600.0 for arrival in samples]
    misses = np.median([arrival.miss for arrival in samples])
    return (
        f"{text} In {len(samples)} samples of it: after {min(hours):.1f} to {max(hours):.1f} h, median miss {misses:.0f} m; "
        f"{100.0 * near / len(samples):.0f} % arrive within {tolerance:.0f} m."
    )


def _dives(contents: Contents) -> Dives:
    """Return how the glider of the configuration dives, or as it was flown."""
    known = tomllib.loads(contents.record.config_toml).get("planner", {})
    settings = PlannerConfig(
        **{name: value for name, value in known.items() if name in PlannerConfig.model_fields}
    )
    assert contents.estimate is not None
    deepest, goal_depth = (
        float(contents.estimate.levels[-1]),
        float(contents.result.plans.iloc[-1]["goal_depth"]),
    )
    diving = settings.diving(AsFlown.in_metadata(contents.record.metadata), goal_depth, deepest)
    depth = max(min(diving.depth, deepest), 1.0)
    return Dives(
        diving.speed,
        diving.min_angle,
        depth,
        diving.surface_time,
        settings.tolerance,
        settings.max_duration,
    )


def _waypoints(plan: LastPlan) -> list[Array]:
    """Return places on a plan's way, evenly spread in time; without a way the middle between its start and goal."""
    if len(plan.track) < _WAYPOINTS + 2:
        return [0.5 * (plan.start + plan.goal)]
    seconds = (plan.track.index - plan.track.index[0]).total_seconds().to_numpy()
    at = np.linspace(0.0, seconds[-1], _WAYPOINTS + 2)[1:-1]
    return list(np.column_stack([np.interp(at, seconds, way) for way in (plan.east, plan.north)]))


def _places(currents: GriddedCurrents, way: Array) -> tuple[Array, Array]:
    """Return the places of the sliders [m]: around a way, shape (n, 2) [m], inside the grid."""
    reach = max(0.3 * float(np.ptp(way, axis=0).max()), 5e3)
    axes = []
    for k, axis in enumerate((currents.east, currents.north)):
        least, most = (
            max(way[:, k].min() - reach, float(axis[0])),
            min(way[:, k].max() + reach, float(axis[-1])),
        )
        axes.append(np.linspace(least, most, _PLACES))
    return axes[0], axes[1]


def _flight(
    currents: GriddedCurrents, dives: Dives, way: list[Array], places: tuple[Array, Array]
) -> dict[str, Any]:
    return {
        "depths": currents.depths.tolist(),
        "east": currents.east.tolist(),
        "north": currents.north.tolist(),
        "dives": {
            "speed": dives.speed,
            "angle": float(np.deg2rad(dives.glide_angle_deg)),
            "depth": dives.depth,
            "surfaceTime": dives.surface_time,
            "maxDuration": dives.max_duration,
            "steps": STEPS,
            "radius": dives.radius,
            "leastDive": LEAST_DIVE,
            "tries": TRIES,
        },
        "start": way[0].tolist(),
        "goal": way[-1].tolist(),
        "waypoints": [place.tolist() for place in way[1:-1]],
        "places": [axis.tolist() for axis in places],
    }


def _table(arrivals: list[Arrival]) -> dict[str, Any]:
    return {
        "flow": ["estimate", *(f"sample {k}" for k in range(1, len(arrivals)))],
        "duration_h": column([arrival.duration / 3600.0 for arrival in arrivals]),
        "miss_m": column([arrival.miss for arrival in arrivals]),
        "arrived": [int(arrival.arrived) for arrival in arrivals],
    }


def _traces(contents: Contents, currents: GriddedCurrents) -> list[dict[str, Any]]:
    """Return the mean current at the shallowest level, start and goal; the script adds the flights."""
    fastest = max(float(np.hypot(*currents.velocity[0, 0]).max()), 1e-3)
    ends = [mark for mark in plan_layer(contents).marks if mark.kind == "points"]
    return [
        arrows("currents", (currents.east, currents.north), 1.2 / fastest)
        | {"line": {"color": {"$color": "three"}, "width": 1}},
        *(trace for mark in ends for trace in traces_of(mark)),
    ]


def _layout(places: tuple[Array, Array]) -> dict[str, Any]:
    ends = ([float(axis[0]) / 1e3 - 2.0, float(axis[-1]) / 1e3 + 2.0] for axis in places)
    return {**map_layout(*ends), "height": 700, "dragmode": False}


def _caption(samples: int, dives: Dives) -> str:
    text = (
        "Drag a diamond, or choose a waypoint and move the sliders: the glider steers from the plan's start over the "
        "waypoints to the goal, "
        "dive by dive, and at each surfacing "
        "corrects for the mean current of its last dive. The thick line is its path in the estimate"
        + (
            f", thin lines in {samples} samples of it: where they spread, the current is uncertain."
            if samples
            else "."
        )
        + f" Dives to {dives.depth:.0f} m at {dives.speed:.2f} m/s and {dives.glide_angle_deg:.0f}° of glide; "
        "grey arrows are the current near the surface. "
        "The current is that of the end of the log and constant; land and the plan's constraints are ignored."
    )
    return (
        text
        if samples
        else f"{text} The estimate is without uncertainty, or too large to be sampled here."
    )
