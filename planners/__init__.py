"""Trajectory planning with CasADi over a ``FlowEstimate``.

* ``plan_mission`` makes a mission for a ``MissionRequest``: past goals, along a line, near a mooring, or one glide.
* ``plan_scenarios`` makes one that violates no constraint in most samples of an estimate, ``plan_for_odds`` one that most samples arrive
  with; ``mission_odds`` flies a mission in samples, ``with_odds`` says in its status and message how likely it arrives.
* ``fly_scenarios`` summarises a mission flown in samples, with headings that are held or corrected by a ``Pilot``.
* ``plan_departures`` plans a mission for several departures, ``best_departure`` is the best of them; ``cut_at_horizon`` ends a mission
  where the forecast does.
* ``waypoints_of`` reduces a mission to a list of few waypoints.
"""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from planners.departures import best_departure, cut_at_horizon, plan_departures
    from planners.flights import MonteCarloSummary, closest_approach, fly_mission, fly_scenarios
    from planners.hazards.areas import NoGo
    from planners.hazards.bottom import Bathymetry
    from planners.odds import MissionOdds, mission_odds, plan_for_odds, plan_scenarios, with_odds
    from planners.plan import plan_mission
    from planners.request import (
        Line,
        MissionPlan,
        MissionRequest,
        MissionSettings,
        Mooring,
        Weights,
    )
    from planners.simulation.steer import Pilot
    from planners.vehicle import Glider, SteadyFlight, fit_flight
    from planners.waypoints import Waypoints, waypoints_of

__all__ = [
    "Bathymetry",
    "Glider",
    "Line",
    "MissionOdds",
    "MissionPlan",
    "MissionRequest",
    "MissionSettings",
    "MonteCarloSummary",
    "Mooring",
    "NoGo",
    "Pilot",
    "SteadyFlight",
    "Waypoints",
    "Weights",
    "best_departure",
    "closest_approach",
    "cut_at_horizon",
    "fit_flight",
    "fly_mission",
    "fly_scenarios",
    "mission_odds",
    "plan_departures",
    "plan_for_odds",
    "plan_mission",
    "plan_scenarios",
    "waypoints_of",
    "with_odds",
]

# a place outside of an estimate is refused without casadi
__getattr__ = on_demand(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
