"""Trajectory planning with CasADi over a ``FlowEstimate``.

* ``plan_mission`` plans a ``MissionRequest``: goals in order, a line, a mooring, or a single glide.
* ``mission_odds`` simulates flights of a plan in samples of the estimate; ``with_odds`` adds the odds to its status and message;
  ``plan_by_odds`` returns the plan with the best odds, or the fastest within an accepted risk.
* ``best_departure`` selects one of the plans for several start times; ``cut_at_horizon`` truncates a plan.
* ``waypoints_of`` reduces a plan to a few waypoints.
"""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from planners.hazards.areas import NoGo
    from planners.hazards.domain import Bathymetry
    from planners.odds.mission import MissionOdds, mission_odds, next_surfacing, with_odds
    from planners.odds.rank import plan_by_odds
    from planners.plan import (
        best_departure,
        closest_approach,
        cut_at_horizon,
        fly_mission,
        plan_mission,
    )
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
    "plan_mission",
    "waypoints_of",
    "with_odds",
]

# a place outside of an estimate is refused without casadi
__getattr__ = on_demand(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
