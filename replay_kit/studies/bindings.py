"""The planners' calls that the studies are handed."""

from collections.abc import Callable
from typing import Any

import planners
from planners.mission.flights import fly_mission
from replay_kit.config.planner import PlannerConfig
from replay_kit.studies.planning.calls import Calls
from replay_kit.studies.planning.mission_legs import legs_planner
from replay_kit.workflows.planning import MissionPlanner

PLANNING_CALLS = Calls(
    plan=planners.plan,
    fly=planners.fly,
    plan_mission=planners.plan_mission,
    fly_mission=fly_mission,
    plan_scenarios=planners.plan_scenarios,
    fly_corrected=lambda flow, samples, plan: planners.fly_scenarios(flow, samples, plan, pilot=planners.Pilot()),
    glider=lambda speed, shallowest, steepest: planners.Glider(speed, None, shallowest, steepest),
    settings=planners.MissionSettings,
    no_go=planners.NoGo,
    legs_planner=lambda depth: legs_planner(MissionPlanner.of(PlannerConfig(kind="mission", depth=depth))),
)


def glide_calls() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the calls that plan one glide and that fly its plan in another flow."""
    return planners.plan, planners.fly
