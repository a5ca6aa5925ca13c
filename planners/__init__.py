"""Trajectory planning with CasADi over a ``FlowEstimate``.

``plan`` makes one glide and ``fly`` flies it in another flow; ``plan_mission`` makes a glider's mission of many dives,
``plan_scenarios`` one that keeps clear in most samples of an estimate, and ``fly_scenarios`` says what comes of one, held whatever comes
or corrected by a ``Pilot``; ``plan_path`` makes a free path of a vehicle of bounded speed.
"""

from planners.auv import Auv, AuvPlan, AuvSettings, plan_path
from planners.feedback import Pilot
from planners.mission import plan_mission
from planners.mission_values import Bathymetry, MissionPlan, MissionSettings, NoGo
from planners.scenario import Chances, fly_scenarios, plan_scenarios
from planners.settings import GlideSettings
from planners.simulate import fly
from planners.solve import plan
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
    "fit_flight",
    "fly",
    "fly_scenarios",
    "plan",
    "plan_mission",
    "plan_path",
    "plan_scenarios",
]
