"""The mission planner as the study of replanning calls it."""

from dataclasses import replace

import numpy as np

import planners
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place
from replay_kit.studies.planning.legs import Leg
from replay_kit.studies.planning.replanning import PlanLegs, PlannedLegs
from replay_kit.workflows.planning import MissionPlanner


def legs_planner(planner: MissionPlanner) -> PlanLegs:
    """Return the mission planner as the study of replanning calls it."""

    def plan(flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: PlannedLegs | None, most_legs: int) -> PlannedLegs:
        limited = replace(planner, settings=replace(planner.settings, max_legs=most_legs))
        planned = limited.plan(flow, start, goal, start_time_ns, None if warm is None else warm.memory)
        mission: planners.MissionPlan = planned.memory
        drifts = np.append(np.full(max(len(mission.yo_depths) - 1, 0), mission.settings.surface_time), 0.0)
        speeds = (mission.vehicle.speeds(np, angle) for angle in np.deg2rad(mission.glide_angles_deg))
        legs = tuple(
            Leg(float(heading), float(along), float(down), turns, float(drift))
            for heading, (along, down), turns, drift in zip(mission.headings_deg, speeds, mission.yo_depths, drifts, strict=False)
        )
        ends = tuple(Place(float(longitude), float(latitude), 0.0) for longitude, latitude in mission.surfacings)
        return PlannedLegs(legs, ends, float(mission.closest_approach[-1]), planned)

    return plan
