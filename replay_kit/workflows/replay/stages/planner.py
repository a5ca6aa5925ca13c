"""What a replay needs of a planner, and what a planner returns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Grid, Seabed
from replay_kit.core.plan import Place, Plan
from replay_kit.core.surfacing import Surfacing


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """A plan, and what it predicts.

    Attributes:
        plan: The plan, as results hold it.
        surfacing: Predicted next surfacing; None when the planner does not predict it.
        memory: The planner's own form of the plan, a frozen value: the planner starts from it when it plans anew, and flies it.
    """

    plan: Plan
    surfacing: Surfacing | None = None
    memory: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuery:
    """What a planner is asked at one time.

    Attributes:
        start: Where the plan begins.
        goal: Where it leads.
        start_time_ns: When it begins [ns, UTC].
        warm: The last plan, to begin from; None without.
    """

    start: Place
    goal: Place
    start_time_ns: int
    warm: PlanResult | None = None


class HasGrid(Protocol):
    """An estimate, or the forecast that it is made of."""

    @property
    def grid(self) -> Grid:
        """Where it holds."""
        ...


class Planner(Protocol):
    """A planner bound to its settings."""

    @property
    def seabed(self) -> Seabed | None:
        """The bottom that its plans stay above; None without a bathymetry."""
        ...

    def plan(self, flow: FlowEstimate, query: PlanQuery) -> PlanResult:
        """Return the best plan found from a start towards a goal."""
        ...

    def with_odds(self) -> "Planner":
        """Return the planner of a replay's last plan, which says how likely it arrives where a vehicle may follow it."""
        ...

    def check(self, flow: HasGrid, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land."""
        ...

    def closest_approach(self, flow: FlowEstimate, result: PlanResult) -> float:
        """Return how close [m] a plan comes to its goal when it is flown in a flow."""
        ...


@runtime_checkable
class VehiclePlanner(Planner, Protocol):
    """A planner whose settings need not state how the vehicle flies."""

    def as_flown(self, flown: AsFlown) -> Planner:
        """Return the planner of a vehicle that flies as its dives so far, where the settings state nothing else."""
        ...


#: Makes the planner of a configuration for a region.
PlannerFactory = Callable[[PlannerConfig, Grid], Planner]
