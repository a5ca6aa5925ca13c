"""Protocols of planners in a replay, and their plans."""

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
    """Plan with its prediction.

    Attributes:
        plan: Plan, as in results.
        surfacing: Predicted next surfacing; None if not predicted.
        memory: Planner's own form of the plan, a frozen value: initial guess of the next plan, and input of flights.
    """

    plan: Plan
    surfacing: Surfacing | None = None
    memory: Any = None


@dataclass(frozen=True, slots=True, eq=False)
class PlanQuery:
    """Request to a planner.

    Attributes:
        start: Start of the plan.
        goal: Goal of the plan.
        start_time_ns: Start time [ns, UTC].
        warm: Last plan, as initial guess; None without one.
    """

    start: Place
    goal: Place
    start_time_ns: int
    warm: PlanResult | None = None


class HasGrid(Protocol):
    """Protocol of an estimate or its forecast."""

    @property
    def grid(self) -> Grid:
        """Grid of the estimate."""
        ...


class Planner(Protocol):
    """Protocol of a planner bound to its settings."""

    @property
    def seabed(self) -> Seabed | None:
        """Bottom depth under its plans; None without a bathymetry."""
        ...

    def plan(self, flow: FlowEstimate, query: PlanQuery) -> PlanResult:
        """Return the best plan found from start to goal."""
        ...

    def with_odds(self) -> "Planner":
        """Return the planner of a replay's last plan, which also gives odds for a vehicle that may follow it."""
        ...

    def check(self, flow: HasGrid, goal: Place) -> None:
        """Raise PlanError if the goal is outside the region or on land."""
        ...


@runtime_checkable
class VehiclePlanner(Planner, Protocol):
    """Protocol of a planner whose settings may omit the flight parameters."""

    def as_flown(self, flown: AsFlown) -> Planner:
        """Return the planner with flight parameters as flown where the settings state none."""
        ...


#: Makes the planner of a configuration for a region.
PlannerFactory = Callable[[PlannerConfig, Grid], Planner]
