"""A mission that keeps clear of what is forbidden in most samples of what an estimate does not know, not in the estimate alone.

Headings that are held whatever comes cannot make the spread of where they lead smaller: what a plan can do is to keep farther away. So
the margin kept from forbidden areas, land and shallows is widened by what the samples fall short of, until few enough trespass.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners.flight import Currents, Legs, currents_of_samples, fly_legs, refined
from planners.mission import plan_mission
from planners.mission_check import check
from planners.mission_task import REFINED, MissionTask, mission_task
from planners.mission_values import Bathymetry, MissionPlan, MissionSettings, NoGo
from planners.vehicle import Glider
from replay_kit.errors import PlanError
from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import grid_bearing_of_true_north
from replay_kit.types import Array, Place

_VEHICLE, _SETTINGS = Glider(), MissionSettings()
# Most plans made, and by how much more than the samples fall short a margin is widened.
_PLANS, _MORE = 4, 1.15


@dataclass(frozen=True, slots=True)
class Chances:
    """What comes of a mission in samples of the current.

    Attributes:
        reached: Share that meets every goal within the tolerance.
        safe: Share that goes nowhere that it may not.
        miss_median: Of the last goal [m].
        miss_90_percent: Nine of ten miss the last goal by less [m].
    """

    reached: float
    safe: float
    miss_median: float
    miss_90_percent: float


def plan_scenarios(
    flow: FlowEstimate,
    samples: Sequence[FlowEstimate],
    start: Place,
    goals: Place | tuple[Place, ...],
    *,
    allowed: float = 0.1,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
) -> tuple[MissionPlan, Chances]:
    """Return the mission planned on the estimate with the margin that keeps the samples clear, and what comes of it in them.

    When no margin tried keeps enough of them clear, the plan that keeps most is returned: ``Chances.safe`` says how many.

    Args:
        flow: The estimate.
        samples: Flows on its nodes, as ``flow.sample`` draws them: some twenty or more.
        start: As for ``plan_mission``, as are the others.
        goals: Where it should go.
        allowed: Share of the samples that may trespass.
        vehicle: What glides.
        settings: How; its margin is the least one.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom.
        start_time_ns: When it begins [ns, UTC].

    Raises:
        PlanError: As for ``plan_mission``; or there are no samples, or they are not on the nodes of the estimate.
    """
    asked, currents = goals if isinstance(goals, tuple) else (goals,), _currents_of(flow, samples)
    task = mission_task(flow, (start, asked), vehicle, settings, (no_go, bathymetry), start_time_ns)
    best, plan, margin = None, None, settings.margin
    for _ in range(_PLANS):
        wider = replace(settings, margin=margin)
        rest: dict[str, Any] = {"no_go": no_go, "bathymetry": bathymetry, "start_time_ns": start_time_ns, "warm": plan}
        plan = plan_mission(flow, start, asked, vehicle=vehicle, settings=wider, **rest)
        if plan.status == "failed":
            return plan, Chances(0.0, 0.0, float("nan"), float("nan"))
        chances, clearance = chances_of(task, currents, legs_of(task, plan), plan.goal_times)
        if best is None or (chances.safe, plan.status == "reached") > (best[1].safe, best[0].status == "reached"):
            best = plan, chances
        if chances.safe >= 1.0 - allowed:
            break
        margin += max(_MORE * float(np.quantile(-clearance, 1.0 - allowed)), 0.1 * margin)
    assert best is not None
    return best


def _currents_of(flow: FlowEstimate, samples: Sequence[FlowEstimate]) -> Currents:
    """Return the samples' currents, all on the nodes of the estimate."""
    if not samples:
        raise PlanError("a plan for samples of the estimate needs some; draw them with flow.sample(20, seed)")
    both = currents_of_samples([flow, *samples])
    return replace(both, latent=both.latent[1:])


def chances_of(task: MissionTask, currents: Currents, legs: Legs, goal_times: Array) -> tuple[Chances, Array]:
    """Return what comes of legs in each of some currents, and how far each keeps clear [m], shape (K,): negative where it trespasses."""
    flight = fly_legs(currents, task.vehicle, task.start[:2], legs)
    met = flight.place[:, np.searchsorted(flight.time, goal_times - 1e-6)]
    miss = np.linalg.norm(met - task.goals[:, :2], axis=2)
    safe = [check(task, replace(flight, place=flight.place[k : k + 1])) is None for k in range(len(flight.place))]
    median, ninety = (float(np.quantile(miss[:, -1], share)) for share in (0.5, 0.9))
    reached = float(np.mean(np.all(miss <= task.settings.tolerance, axis=1)))
    points = flight.place.reshape(-1, 2)
    clearance = np.full(len(points), np.inf)
    for ring in task.rings:
        if not ring.surface_only:
            distance = np.linalg.norm(ring.nearest(points) - points, axis=1)
            clearance = np.minimum(clearance, np.where(ring.forbids(points), -distance, distance))
    return Chances(reached, float(np.mean(safe)), median, ninety), clearance.reshape(len(flight.place), -1).min(axis=1)


def legs_of(task: MissionTask, plan: MissionPlan) -> Legs:
    """Return what a plan tells the glider, its steps as fine as in the check."""
    begins = np.vstack([[plan.start.longitude, plan.start.latitude], plan.surfacings[:-1]])
    turn = grid_bearing_of_true_north(task.region.grid.projection, *begins.T)
    depths = tuple(refined(steps, REFINED) for steps in task.depths(plan.turns))
    return Legs(np.deg2rad(plan.headings_deg) + turn, np.deg2rad(plan.glide_angles_deg), depths, task.drifts(plan.turns))
