"""Open-loop flights of a plan, in the true current or in samples."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planners.request import MissionPlan
from planners.simulation.currents import Flow, Sample, currents_of, currents_of_samples
from planners.simulation.fly import COARSE, Flight, Legs, fly
from planners.task import turns_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local

# Share of a glide by which it goes on.
_MORE = 0.5


def fly_mission(flows: FlowEstimate | Sequence[Sample], plan: MissionPlan) -> tuple[Flight, Array]:
    """Return open-loop flights of a plan in K currents, and the miss distance of each goal at its planned time, shape (K, G) [m].

    Args:
        flows: Flows on the same nodes; time-dependent ones at the same increasing times. Their projection may differ from the plan's.
        plan: The mission.

    Raises:
        PlanError: The plan has no legs, or the flows are not on the same nodes.
    """
    currents = currents_of_samples([flows] if isinstance(flows, FlowEstimate) else flows)
    count, vehicle = len(currents.latent), plan.vehicle
    if count > 1 and (vehicle.speed_spread or vehicle.speed_error):
        each = [vehicle.paces(count, dive) for dive in range(len(plan.headings_deg))]
        currents = replace(currents, pace=np.mean(each, axis=0))
    legs, frame = legs_of_plan(plan), currents.flow.grid.projection
    start, *goals = (
        np.array(to_local(frame, place.longitude, place.latitude))
        for place in (plan.start, *plan.goals)
    )
    clock, parts = currents.clock(plan.start_time_ns), int(plan.statistics.get("steps", COARSE))
    deep = np.array([goal.depth for goal in plan.goals])
    flight = fly(currents, vehicle, (start, clock), legs, parts, deep)
    met = flight.place[:, np.searchsorted(flight.time[0], plan.goal_times - 1e-3)]
    return flight, np.linalg.norm(met - np.array(goals), axis=2)


def closest_approach(flow: Flow, plan: MissionPlan) -> float:
    """Return the closest approach of a plan's open-loop track to its last goal, in three dimensions [m].

    The last leg is extended by half its duration.
    """
    flight, _ = fly_mission([flow], _longer(plan))
    goal, projection = plan.goals[-1], currents_of(flow).flow.grid.projection
    at = np.array([*to_local(projection, goal.longitude, goal.latitude), goal.depth])
    track = np.column_stack([flight.place[0], flight.depth])
    begin, way = track[:-1], np.diff(track, axis=0)
    share = np.sum((at - begin) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-9)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.min(np.linalg.norm(nearest - at, axis=1)))


def _longer(plan: MissionPlan) -> MissionPlan:
    """Return a glide extended as far as its depth allows; other plans unchanged."""
    if plan.settings.yos > 0:
        return plan
    first, last = plan.yo_depths[0][0], plan.yo_depths[0][-1]
    return replace(plan, yo_depths=((first, max(last + _MORE * (last - first), 0.0)),))


def legs_of_plan(plan: MissionPlan) -> Legs:
    """Return the commands of a plan.

    Raises:
        PlanError: The plan has no legs.
    """
    if len(plan.headings_deg) == 0:
        raise PlanError(f"a mission without legs cannot be flown: {plan.message}")
    drifts = np.append(np.full(len(plan.yo_depths) - 1, plan.settings.surface_time), 0.0)
    return Legs(
        np.deg2rad(plan.headings_deg),
        np.deg2rad(plan.glide_angles_deg),
        turns_of(plan.yo_depths),
        drifts,
    )
