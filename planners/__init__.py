"""Trajectory planning with CasADi over a ``FlowEstimate``: one glide (``plan``, ``fly``), or a mission of many dives (``plan_mission``)."""

from planners.mission import plan_mission
from planners.mission_values import Bathymetry, MissionPlan, MissionSettings, NoGo
from planners.settings import GlideSettings
from planners.simulate import fly
from planners.solve import plan
from planners.vehicle import Glider, SteadyFlight, fit_flight

__all__ = [
    "Bathymetry",
    "GlideSettings",
    "Glider",
    "MissionPlan",
    "MissionSettings",
    "NoGo",
    "SteadyFlight",
    "fit_flight",
    "fly",
    "plan",
    "plan_mission",
]
