"""Trajectory planning with CasADi over a ``FlowEstimate``.

``plan`` makes one glide and ``fly`` flies it in another flow; ``plan_mission`` makes a glider's mission of many dives,
``plan_mooring`` one that stays near a place, ``plan_line`` one that follows a line, ``plan_scenarios`` one that keeps clear in most
samples of an estimate; ``fly_scenarios`` says what comes of a mission, held whatever comes or corrected by a ``Pilot``; ``waypoints_of``
makes a list of few places of it; ``plan_path`` makes a free path of a vehicle of bounded speed.
"""

from planners.glide.settings import GlideSettings
from planners.glide.simulate import fly
from planners.glide.solve import plan
from planners.mission.feedback import Pilot
from planners.mission.kinds import plan_line, plan_mooring
from planners.mission.plan import plan_mission
from planners.mission.scenario import Chances, fly_scenarios, plan_scenarios
from planners.mission.values import MissionPlan, MissionSettings, Weights
from planners.mission.waypoints import Waypoints, waypoints_of
from planners.path.plan import AuvPlan, plan_path
from planners.path.program import Auv, AuvSettings
from planners.route.hazards import Bathymetry, NoGo
from planners.vehicle import Glider, SteadyFlight, fit_flight

__all__ = [
    "Auv",
    "AuvPlan",
    "AuvSettings",
    "Bathymetry",
    "Chances",
    "GlideSettings",
    "Glider",
    "MissionPlan",
    "MissionSettings",
    "NoGo",
    "Pilot",
    "SteadyFlight",
    "Waypoints",
    "Weights",
    "fit_flight",
    "fly",
    "fly_scenarios",
    "plan",
    "plan_line",
    "plan_mission",
    "plan_mooring",
    "plan_path",
    "plan_scenarios",
    "waypoints_of",
]
