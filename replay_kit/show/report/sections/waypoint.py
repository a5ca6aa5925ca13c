"""Editing a plan on the page's map: the estimate and samples of it are inside, and the glider is flown through them."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.results.views.contents import Contents
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
from replay_kit.results.views.track import LastPlan, thinned
from replay_kit.show.page.section import column, pack

_SAMPLES, _SEED = 16, 0
#: Weights of the largest estimate that is sampled: the time grows with their cube.
_SAMPLED = 2500
#: Levels of the currents, and steps of the largest one: packed numbers have 16 bits, but samples differ more than these steps.
_LEVELS, _WHOLE = 8, 2_000.0
#: On the plan's way.
_WAYPOINTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Editing:
    """What the page needs to edit a plan on its map; empty without an estimate or a plan.

    Attributes:
        tables: How the untouched way arrives, in the estimate and its samples.
        packed: Their currents.
        flight: What the script flies.
        readout: How the untouched way arrives, in words.
        arrivals: The same as values.
    """

    tables: Mapping[str, Any] = field(default_factory=dict)
    packed: Mapping[str, Any] = field(default_factory=dict)
    flight: Mapping[str, Any] = field(default_factory=dict)
    readout: str = ""
    arrivals: Sequence[Arrival] = ()


def editing(contents: Contents) -> Editing:
    """Return what it takes to edit the last plan's way, which is flown in the estimate and in samples of it."""
    flow, plan = contents.estimate, contents.last_plan
    if flow is None or plan is None or not np.isfinite(plan.row["heading_deg"]):
        return Editing()
    dives = _dives(contents)
    levels = flow.levels[thinned(flow.levels.size, _LEVELS)]
    samples = _SAMPLES if 0 < flow.n_modes * flow.levels.size <= _SAMPLED else 0
    currents = gridded_currents(flow, levels, samples, _SEED)
    step = max(float(np.abs(currents.velocity).max()), 1e-3) / _WHOLE
    # flown as the page has them, so that both write the same numbers
    currents = replace(currents, velocity=step * np.rint(currents.velocity / step))
    waypoints = _waypoints(plan)
    arrivals = [
        fly_to_waypoints(currents, k, dives, plan.start, [*waypoints, plan.goal])
        for k in range(len(currents.velocity))
    ]
    odds = plan.odds
    hours = float(plan.row["duration"]) / 3600.0
    known = "" if odds is None else f", odds {100.0 * odds['reached']:.0f} %"
    flight = _flight(currents, dives, [plan.start, *waypoints, plan.goal]) | {
        "plan": {
            "duration": float(plan.row["duration"]),
            "reached": None if odds is None else odds["reached"],
        },
        "rule": _rule(dives),
        "untouched": f"The plan: {hours:.1f} h{known}. Drag a numbered waypoint, or state its place.",
    }
    packed = {"currents": pack(currents.velocity, step, 4)}
    said = f"{readout(arrivals)} {_rule(dives)}"
    return Editing({"flights": _table(arrivals)}, packed, flight, said, arrivals)


def readout(arrivals: Sequence[Arrival]) -> str:
    """Return when a glider arrives and how far it misses, in words that ``waypoint.js`` writes alike.

    Args:
        arrivals: In the estimate's mean, then in samples.
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
    hours = [arrival.duration / 3600.0 for arrival in samples]
    misses = np.median([arrival.miss for arrival in samples])
    return f"{text} In {len(samples)} samples of it: after {min(hours):.1f} to {max(hours):.1f} h, median miss {misses:.0f} m."


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


def _flight(currents: GriddedCurrents, dives: Dives, way: list[Array]) -> dict[str, Any]:
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
    }


def _table(arrivals: list[Arrival]) -> dict[str, Any]:
    return {
        "flow": ["estimate", *(f"sample {k}" for k in range(1, len(arrivals)))],
        "duration_h": column([arrival.duration / 3600.0 for arrival in arrivals]),
        "miss_m": column([arrival.miss for arrival in arrivals]),
        "arrived": [int(arrival.arrived) for arrival in arrivals],
    }


def _rule(dives: Dives) -> str:
    return (
        f"Flown dive by dive to {dives.depth:.0f} m at {dives.speed:.2f} m/s and {dives.glide_angle_deg:.0f}° of glide; at each "
        "surfacing the glider corrects for the current of its last dive. The current is that of the end of the log and constant; "
        "land and the plan's constraints are ignored."
    )
