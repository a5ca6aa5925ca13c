"""Open-loop flights of a plan, in the true current or in samples."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.request import MissionPlan
from planners.simulation.currents import Flow, Sample, currents_of_samples
from planners.simulation.fly import COARSE, Legs, fly
from planners.task import turns_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection

# Share of a glide by which it goes on.
_MORE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class MissionFlights:
    """Open-loop flights of a plan in K currents.

    Attributes:
        time: Time since the start, shape (n,) [s]; the same in all currents.
        depth: Depth, shape (n,) [m].
        place: Position, shape (K, n, 2) [m], local east and north.
        surfacings: End of each leg, shape (K, L, 2), longitude and latitude [degrees].
        miss: Miss distance of each goal at its planned time, shape (K, G) [m].
        projection: Local frame of the flows.
    """

    time: Array
    depth: Array
    place: Array
    surfacings: Array
    miss: Array
    projection: Projection


def fly_mission(flows: FlowEstimate | Sequence[Sample], plan: MissionPlan) -> MissionFlights:
    """Return the tracks of a plan's commands in other currents, without corrections.

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
    legs, projection = legs_of_plan(plan), currents.flow.grid.projection
    start = np.array(
        to_local(projection, plan.start.longitude, plan.start.latitude), dtype=np.float64
    )
    clock, parts = currents.clock(plan.start_time_ns), int(plan.statistics.get("steps", COARSE))
    deep = np.array([goal.depth for goal in plan.goals])
    flight = fly(currents, vehicle, (start, clock), legs, parts, deep)
    ends = flight.place[:, flight.ends]
    met = flight.place[:, np.searchsorted(flight.time[0], plan.goal_times - 1e-3)]
    goals = np.column_stack(
        to_local(projection, *np.array([[goal.longitude, goal.latitude] for goal in plan.goals]).T)
    )
    miss = np.linalg.norm(met - goals, axis=2)
    surfacings = np.stack(to_geographic(projection, ends[..., 0], ends[..., 1]), axis=-1)
    return MissionFlights(flight.time[0], flight.depth, flight.place, surfacings, miss, projection)


def closest_approach(flow: Flow, plan: MissionPlan) -> float:
    """Return the closest approach of a plan's open-loop track to its last goal, in three dimensions [m].

    The last leg is extended by half its duration.
    """
    longer = _longer(plan)
    flights = fly_mission([flow], longer)
    goal, projection = plan.goals[-1], flights.projection
    at = np.array([*to_local(projection, goal.longitude, goal.latitude), goal.depth])
    track = np.column_stack([flights.place[0], flights.depth])
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
