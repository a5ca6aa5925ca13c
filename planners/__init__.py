"""Trajectory planning with CasADi over a ``FlowEstimate``.

* ``plan`` makes one glide; ``fly`` flies it in another flow.
* ``plan_mission`` makes a glider's mission of many dives for a ``MissionRequest``; ``plan_mooring`` one that stays near a place,
  ``plan_line`` one that follows a line, ``plan_scenarios`` one that violates no constraint in most samples of an estimate.
* ``fly_scenarios`` summarises a mission flown in samples, with headings that are held or corrected by a ``Pilot``.
  ``plan_for_odds`` the one that most samples arrive with.
* ``mission_odds`` flies a mission in samples of the estimate; ``with_odds`` says in its status and message how likely it arrives.
* ``plan_departures`` plans a mission for several departures, ``best_departure`` is the best of them; ``cut_at_horizon`` ends a mission
  where the forecast does.
* ``waypoints_of`` reduces a mission to a list of few waypoints.
"""

from typing import TYPE_CHECKING

from replay_kit.core.extensions import on_demand

if TYPE_CHECKING:
    from planners.glide.candidate import fly
    from planners.glide.solve import plan
    from planners.glide.transcription import GlideSettings
    from planners.hazards.areas import NoGo
    from planners.hazards.bottom import Bathymetry
    from planners.mission.flight.pilot import Pilot
    from planners.mission.flights import MonteCarloSummary, fly_scenarios
    from planners.mission.odds import MissionOdds, mission_odds, plan_for_odds, with_odds
    from planners.mission.plan import plan_line, plan_mission, plan_mooring
    from planners.mission.scenarios import plan_scenarios
    from planners.mission.timing import best_departure, cut_at_horizon, plan_departures
    from planners.mission.waypoints import Waypoints, waypoints_of
    from planners.request import (
        Line,
        MissionPlan,
        MissionRequest,
        MissionSettings,
        Mooring,
        Weights,
    )
    from planners.vehicle import Glider, SteadyFlight, fit_flight

__all__ = [
    "Bathymetry",
    "GlideSettings",
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
    "cut_at_horizon",
    "fit_flight",
    "fly",
    "fly_scenarios",
    "mission_odds",
    "plan",
    "plan_departures",
    "plan_for_odds",
    "plan_line",
    "plan_mission",
    "plan_mooring",
    "plan_scenarios",
    "waypoints_of",
    "with_odds",
]

# a place outside of an estimate is refused without casadi
__getattr__ = on_demand(__name__, __file__)


def __dir__() -> list[str]:
    return sorted(__all__)
