"""Limits of a glide."""

from dataclasses import dataclass
from math import inf

from planners.route.bottom import Bathymetry
from planners.track import Integrator


@dataclass(frozen=True, slots=True)
class GlideSettings:
    """Limits of a glide and effort of its planner.

    Attributes:
        speed: Through water [m/s].
        tolerance: A path that passes this close has reached the goal [m].
        max_duration: Longest glide considered [s].
        max_depth: Greatest depth that the vehicle may go to [m].
        n_steps: Steps of the optimiser, beside one for each level; doubled where the dense path disagrees by a metre.
        bathymetry: Bottom depth; a glide ends where it comes nearer to it than the clearance. None leaves the bottom out of account.
        clearance: Least height above it [m].
        starts: Most seeds that the optimiser starts from.
        integrator: Of the optimiser's steps: Runge-Kutta's, or Euler's as in the paper, whose steps are never doubled. The path of the plan
            is integrated by Runge-Kutta either way; the closest approach by the optimiser's own path is in ``statistics``.
    """

    speed: float = 0.3
    tolerance: float = 250.0
    max_duration: float = 432000.0
    max_depth: float = inf
    n_steps: int = 24
    starts: int = 3
    bathymetry: Bathymetry | None = None
    clearance: float = 20.0
    integrator: Integrator = "rk4"
