"""``plan --glider``: missions of several vehicles that keep apart; each is a plan of its own too.

And the result of any ``plan`` made again from what it records, for ``verify``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from planners.assignment import assign, times_to_goals
from planners.odds.mission import mission_odds, with_odds
from planners.separation import (
    JointMissions,
    Nearness,
    plan_missions,
    share_of_nearer,
)
from planners.simulation.currents import Flow, Sample
from planners.waypoints import waypoints_of
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.plan import share_interval
from replay_kit.core.progress import announce
from replay_kit.core.text import time_text
from replay_kit.results.differences import Recorded
from replay_kit.show.text import print_table
from replay_kit.workflows.planning.adapters import (
    sample_count,
    with_origin,
    without_odds,
)
from replay_kit.workflows.planning.inputs import PlannedOn, planned_on
from replay_kit.workflows.planning.mission import (
    PlannedMission,
    make_mission,
    mission_planner,
    samples_json,
)
from replay_kit.workflows.planning.outputs import write_mission
from replay_kit.workflows.planning.record import recorded_request
from replay_kit.workflows.planning.request import checked
from replay_kit.workflows.replay.inputs.provenance import PLAN_RECORD


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Plans of several vehicles.

    Attributes:
        planned: Of each vehicle that has one, by its name.
        goals: Number of each vehicle's goal, by its name, counted from 1; None for a vehicle without one.
        left: Numbers of the goals to which no vehicle goes.
        nearness: Of each two missions, by the vehicles' names.
        separation: Least distance asked for [m]; 0 for any.
        count: Number of samples that the missions are flown in.
    """

    planned: Mapping[str, PlannedMission]
    goals: Mapping[str, int | None]
    left: tuple[int, ...] = ()
    nearness: tuple[tuple[str, str, Nearness], ...] = ()
    separation: float = 0.0
    count: int = 0


def make_together(job: PlanRequest, config: PlannerConfig) -> Together:
    """Return the plans of the vehicles of ``--glider``.

    Args:
        job: What is asked for, checked.
        config: ``[planner]`` with the command's options laid over it.

    Raises:
        PlanError: A place cannot be planned for.
        ReplayKitError: A file cannot be read.
    """
    return _missions(job, config, planned_on(job, config))


def _missions(job: PlanRequest, config: PlannerConfig, on: PlannedOn) -> Together:
    known, starts, named = on.known, job.glider_places, job.goals_of_gliders
    goals = tuple(place for _, place in named)
    bound, origin = mission_planner(job, config, on.flown).bound(known.first, goals)
    bound = replace(bound, bathymetry=on.bathymetry)
    begin_ns, notes = known.begin(job.start_time_ns)
    seconds = max(bound.span(start, (goal,)) for start in starts.values() for goal in goals)
    count = sample_count(known.first, config.samples)
    flow = known.flow(begin_ns, seconds)
    # shares that ways were chosen by are too low: they are stated in other samples
    drawn, searched = (known.samples(begin_ns, seconds, count, config.seed + k) for k in range(2))
    apart = job.separation or 0.0
    announce("assigning goals")
    asked = [bound.request(start, goals, begin_ns, on.no_go) for start in starts.values()]
    times = _of_its_own(times_to_goals(flow, asked, goals), tuple(starts), [n for n, _ in named])
    chosen = dict(zip(starts, assign(times), strict=True))
    going = {name: goal for name, goal in chosen.items() if goal is not None}
    if not going:
        raise PlanError(
            "no vehicle can reach a goal within the longest mission considered; plan each alone to see how near it comes"
        )
    requests = [
        replace(asked[list(starts).index(name)], goals=(goals[goal],))
        for name, goal in going.items()
    ]
    announce("planning the missions")
    joint = plan_missions(flow, searched if apart else (), requests, apart, job.accepted_risk)
    planned = {}
    for name, made, request in zip(going, joint.plans, joint.requests, strict=True):
        made = with_origin(made, origin)
        one = PlannedMission(made, on, None, None, None, (*notes, *on.notes), count)
        of_list = None
        if job.waypoints and len(made.headings_deg):
            few, of_list = waypoints_of(flow, made, request, job.waypoint_tolerance, drawn)
            one = replace(one, waypoints=few)
        if count == 0:
            one = replace(one, plan=without_odds(made, known.first))
        elif len(made.headings_deg):
            odds = of_list or mission_odds(flow, drawn, made, request)
            judged = with_odds(made, odds, job.arrive, job.accepted_risk)
            one = replace(one, plan=judged, odds=odds, samples=samples_json(odds, job))
        planned[name] = one
    return Together(
        planned,
        {name: None if goal is None else goal + 1 for name, goal in chosen.items()},
        tuple(k + 1 for k in range(len(goals)) if k not in going.values()),
        _nearness(flow, drawn if apart else (), joint, tuple(going), apart),
        apart,
        count,
    )


def _nearness(
    flow: Flow,
    drawn: Sequence[Sample],
    joint: JointMissions,
    names: tuple[str, ...],
    separation: float,
) -> tuple[tuple[str, str, Nearness], ...]:
    """Return how near each two missions come, with the names of their vehicles; shares are of samples that the ways were not chosen by."""
    found = list[tuple[str, str, Nearness]]()
    for one in joint.nearness:
        if drawn:
            share = share_of_nearer(flow, drawn, joint, one.vehicles, separation)
            one = replace(one, share=share)
        found.append((names[one.vehicles[0]], names[one.vehicles[1]], one))
    return tuple(found)


def _of_its_own(times: Array, vehicles: Sequence[str], goals_of: Sequence[str]) -> Array:
    """Return times in which a goal that is a vehicle's own is out of reach of all others, and all others out of reach of that vehicle."""
    allowed = np.ones(times.shape, dtype=bool)
    for k, vehicle in enumerate(vehicles):
        own = np.array([name == vehicle for name in goals_of])
        allowed[k] = own if own.any() else np.array([not name for name in goals_of])
    return np.where(allowed, times, np.inf)


def separation_rows(made: Together) -> list[dict[str, Any]]:
    """Return how near each two missions come, one row each, for people and ``--json``."""
    return [
        {
            "vehicles": [first, second],
            "least_distance_m": one.distance,
            "time": time_text(one.time_ns),
            "separation_m": made.separation or None,
            "nearer_in_samples": None if np.isnan(one.share) else one.share,
            "nearer_interval": None
            if np.isnan(one.share)
            else share_interval(one.share, made.count),
            "kept": not one.distance < made.separation,
        }
        for first, second, one in made.nearness
    ]


def together_json(made: Together, each: Mapping[str, Any]) -> dict[str, Any]:
    """Return the plans for ``--json``.

    Args:
        made: The plans.
        each: Of each vehicle its plan's own JSON.
    """
    return {
        "vehicles": dict(each),
        "goals": dict(made.goals),
        "goals_left": list(made.left),
        "separation": separation_rows(made),
    }


def print_together(made: Together, console: Console) -> None:
    """Print who goes where, what each two missions keep apart, and what is left out."""
    columns = ("glider", "goal", "status", "hours", "arrives")
    print_table(console, "Gliders", columns, [_cells(made, *one) for one in made.planned.items()])
    for name, goal in made.goals.items():
        if goal is None:
            console.print(f"{name}: no goal is left for it, or none that it can reach")
    for goal in made.left:
        console.print(f"goal {goal}: no glider goes there")
    for row in separation_rows(made):
        console.print(_apart(row))


def _cells(made: Together, name: str, one: PlannedMission) -> tuple[str, ...]:
    share = "-" if one.samples is None else f"{100.0 * one.samples['reached']:.0f} %"
    hours = f"{one.plan.duration / 3600.0:.1f}"
    return name, f"goal {made.goals[name]}", one.plan.status, hours, share


def _apart(row: Mapping[str, Any]) -> str:
    """Return how near two missions come, in words."""
    first, second = row["vehicles"]
    text = f"{first} and {second}: at least {row['least_distance_m'] / 1e3:.1f} km apart, at {row['time']}"
    if row["separation_m"] is None:
        return text
    if row["nearer_in_samples"] is not None:
        text += f"; nearer than {row['separation_m'] / 1e3:g} km in {100.0 * row['nearer_in_samples']:.0f} % of the samples"
    if not row["kept"]:
        text += (
            f"; {row['separation_m'] / 1e3:g} km are not kept: no way round was found for either"
        )
    return text


def plan_again(recorded: Recorded, config: RunConfig, found: Mapping[str, Path], out: Path) -> None:
    """Plan what a result was planned for, and write it as ``plan`` does.

    Args:
        recorded: What the result says of how it was made.
        config: Its configuration.
        found: Its inputs, by the keys of their record.
        out: The new result.

    Raises:
        ReplayKitError: The record is damaged, or there is no such plan any more.
    """
    request = checked(recorded_request(recorded.metadata[PLAN_RECORD], found))
    config = config.model_copy(update={"plan": request})
    if request.glider:
        each = make_together(request, config.planner).planned
        if request.of_glider is None or request.of_glider not in each:
            raise PlanError(
                f"{PLAN_RECORD}: expected the plan of a glider, one of {', '.join(each)}, got {request.of_glider}; plan again"
            )
        planned = each[request.of_glider]
    else:
        on = planned_on(request, config.planner)
        planned = make_mission(request, config.planner, on)
    write_mission(out, False, planned, config)
