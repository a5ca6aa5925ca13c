"""Objectives of missions: weights that the optimiser minimises, and what ranks the missions that it finds.

``replay_kit/core/objective.py`` lists their names.
"""

from collections.abc import Callable
from dataclasses import dataclass

from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.objective import ObjectiveName


@dataclass(frozen=True, slots=True)
class Weights:
    """The cost of a mission as a weighted sum.

    Attributes:
        time: Cost of an hour.
        energy: Cost of a kilojoule.
        closest: Cost of a kilometre of miss distance; None when each goal must be met as closely as possible, at any cost.
    """

    time: float = 0.0
    energy: float = 0.0
    closest: float | None = None

    def __post_init__(self) -> None:
        """Raise PlanError for weights that are negative or all zero."""
        values = (self.time, self.energy, self.closest or 0.0)
        if not all(0.0 <= value < float("inf") for value in values) or not any(values):
            raise PlanError(
                f"weights of a mission are {self}; expected numbers of 0 or more, at least one of them above 0"
            )

    def cost(self, duration: float, energy: float, miss: float) -> float:
        """Return the cost of a mission of a duration [s], an energy [J] and a sum of miss distances [m]."""
        return (
            self.time * duration / 3600.0
            + self.energy * energy / 1e3
            + (self.closest or 0.0) * miss / 1e3
        )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a mission that was found may be ranked by.

    Attributes:
        vehicle: The glider.
        glide_angles: shape (L,) [rad], of each leg.
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        duration: [s].
        energy: [J].
        miss: Sum of the miss distances of the goals [m].
    """

    vehicle: Glider
    glide_angles: Array
    yo_depths: tuple[tuple[float, ...], ...]
    duration: float
    energy: float
    miss: float


@dataclass(frozen=True, slots=True)
class Objective:
    """What a mission minimises.

    Attributes:
        weights: What the optimiser minimises with a given number of legs.
        rank: Cost by which missions that meet their goals are compared: those of other numbers of legs, ways and departures. None: the
            weights' cost.
        distance_first: Whether the miss distance alone counts, and the cost only among equals.
        earliest_arrival: Whether of several departures the one that arrives first is the best, as a wait before it costs time too.
    """

    weights: Weights
    rank: Callable[[Found], float] | None = None
    distance_first: bool = False
    earliest_arrival: bool = False

    def cost(self, found: Found) -> float:
        """Return the cost of a mission that was found."""
        return (
            self.weights.cost(found.duration, found.energy, found.miss)
            if self.rank is None
            else self.rank(found)
        )


OBJECTIVES: dict[ObjectiveName, Objective] = {
    "time": Objective(Weights(time=1.0), earliest_arrival=True),
    "energy": Objective(Weights(energy=1.0)),
    # of two missions that are equally close the quicker one
    "closest": Objective(Weights(time=1.0), distance_first=True),
}
