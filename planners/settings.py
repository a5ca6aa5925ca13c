"""What a glide may do."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GlideSettings:
    """Limits of a glide and effort of its planner.

    Attributes:
        speed: Through water [m/s].
        tolerance: A path that passes this close has reached the goal [m].
        max_duration: Longest glide considered [s].
        n_steps: RK4 steps of the optimiser, beside one for each level; doubled where the dense path disagrees by a metre.
        starts: Most seeds that the optimiser starts from.
    """

    speed: float = 0.3
    tolerance: float = 250.0
    max_duration: float = 432000.0
    n_steps: int = 24
    starts: int = 3
