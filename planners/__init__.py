"""Trajectory planning with CasADi over a ``FlowEstimate``.

* ``plan_mission`` makes a mission for a ``MissionRequest``: past goals, along a line, near a mooring, or one glide.
* ``mission_odds`` flies a mission in samples of an estimate, steered at each surfacing; ``with_odds`` says in its status and message how
  likely it arrives; ``plan_by_odds`` makes the mission with the best odds, or with a margin that keeps a risk.
* ``plan_departures`` plans a mission for several departures, ``best_departure`` is the best of them; ``cut_at_horizon`` ends a mission
  where the forecast does.
* ``waypoints_of`` reduces a mission to a list of few waypoints.
"""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from planners.departures import best_departure, cut_at_horizon, plan_departures
    from planners.flights import closest_approach, fly_mission
    from planners.hazards.areas import NoGo
    from planners.hazards.bottom import Bathymetry
    from planners.odds.mission import MissionOdds, mission_odds, next_surfacing, with_odds
    from planners.odds.rank import plan_by_odds
    from planners.plan import plan_mission
    from planners.request import (
        Line,
        MissionPlan,
        MissionRequest,
        MissionSettings,
        Mooring,
        Weights,
    )
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
    "Mooring",
    "NoGo",
    "SteadyFlight",
    "Waypoints",
    "Weights",
    "best_departure",
    "closest_approach",
    "cut_at_horizon",
    "fit_flight",
    "fly_mission",
    "mission_odds",
    "next_surfacing",
    "plan_by_odds",
    "plan_departures",
    "plan_mission",
    "waypoints_of",
    "with_odds",
]

# a place outside of an estimate is refused without casadi
__getattr__ = on_demand(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
