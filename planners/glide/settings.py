"""Limits of a glide."""

from dataclasses import dataclass

from planners.track import Integrator


@dataclass(frozen=True, slots=True)
class GlideSettings:
    """Limits of a glide and effort of its planner.

    Attributes:
        speed: Through water [m/s].
        tolerance: A path that passes this close has reached the goal [m].
        max_duration: Longest glide considered [s].
        n_steps: Steps of the optimiser, beside one for each level; doubled where the dense path disagrees by a metre.
        clearance: Least height above the bottom of a bathymetry [m].
        starts: Most seeds that the optimiser starts from.
        integrator: Of the optimiser's steps: Runge-Kutta's, or Euler's as in the paper, whose steps are never doubled. The path of the plan
            is integrated by Runge-Kutta either way; the closest approach by the optimiser's own path is in ``statistics``.
    """

    speed: float = 0.3
    tolerance: float = 250.0
    max_duration: float = 432000.0
    n_steps: int = 24
    starts: int = 3
    clearance: float = 20.0
    integrator: Integrator = "rk4"
