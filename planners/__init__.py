"""Trajectory planning with CasADi over a ``FlowEstimate``.

``plan`` makes one glide and ``fly`` flies it in another flow; ``plan_mission`` makes a glider's mission of many dives,
``plan_mooring`` one that stays near a place, ``plan_line`` one that follows a line, ``plan_scenarios`` one that keeps clear in most
samples of an estimate; ``fly_scenarios`` says what comes of a mission, held whatever comes or corrected by a ``Pilot``; ``waypoints_of``
makes a list of few places of it; ``plan_path`` makes a free path of a vehicle of bounded speed.
"""

from planners.auv import AuvPlan, plan_path
from planners.auv_program import Auv, AuvSettings
from planners.feedback import Pilot
from planners.mission import plan_mission
from planners.mission_kinds import plan_line, plan_mooring
from planners.mission_values import Bathymetry, MissionPlan, MissionSettings, NoGo, Weights
from planners.scenario import Chances, fly_scenarios, plan_scenarios
from planners.settings import GlideSettings
from planners.simulate import fly
from planners.solve import plan
from planners.vehicle import Glider, SteadyFlight, fit_flight
from planners.waypoints import Waypoints, waypoints_of

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
