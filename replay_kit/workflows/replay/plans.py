"""Planning stage: protocols of planners, times and starts of plans, and outcomes of predicted surfacings."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid, Seabed
from replay_kit.core.observation import VehicleState
from replay_kit.core.plan import Place, Plan
from replay_kit.core.surfacing import Surfacing, SurfacingOutcome, surfacing_outcome
from replay_kit.measurements.track.surfacings import SurfacingState, detect_surfacing
from replay_kit.workflows.replay.publishing import Output


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


#: Returns the estimate for a time [ns, UTC].
FlowAt = Callable[[int], FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class PlanningProblem:
    """Constant part of a replay's planning.

    Attributes:
        planner: Planner.
        goal: Goal of the vehicle.
        settings: Settings of the times of plans.
        surface_depth: Depth above which the vehicle is at the surface [m].
        later_goals: Later goals, in order, with the time from which each holds [ns, UTC].
    """

    planner: Planner
    goal: Place
    settings: PlannerConfig
    surface_depth: float
    later_goals: tuple[tuple[int, Place], ...] = ()

    def goal_at(self, time_ns: int) -> Place:
        """Return the goal of a plan that begins at a given time [ns, UTC]."""
        return next(
            (goal for since_ns, goal in reversed(self.later_goals) if time_ns >= since_ns),
            self.goal,
        )

    @property
    def interval_ns(self) -> int:
        """Time between plans [ns]."""
        return int(self.settings.interval * 1e9)

    @property
    def waits_ns(self) -> int:
        """Longest wait of a due plan for a surfacing, at which a glider can receive a mission [ns]; 0 for no wait."""
        return (
            self.interval_ns
            if (self.settings.kind, self.settings.when) == ("mission", "interval")
            else 0
        )

    def plans_at(self, surfaced_ns: int, due_ns: int | None) -> bool:
        """Return whether a plan is made at a surfacing, given the due time of the next plan [ns, UTC]."""
        return self.settings.when == "surfacing" or (
            self.waits_ns > 0 and due_ns is not None and surfaced_ns >= due_ns
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlanningState:
    """State of the planning stage.

    Attributes:
        position: Last position; None before the first.
        result: Last plan; None before the first, and if it failed.
        failure: Reason of a failed last plan; empty otherwise.
        expected: Start of the last plan [ns, UTC] and its predicted surfacing, until the vehicle has surfaced; None without.
        outcomes: Predicted and actual surfacings.
        detection: Detection of surfacings.
        surfaced: Fix of a surfacing, until all observations of that time are assimilated; None otherwise.
        next_plan_ns: Due time of the next plan [ns, UTC]; None before the first observation.
    """

    position: VehicleState | None = None
    result: PlanResult | None = None
    failure: str = ""
    expected: tuple[int, Surfacing] | None = None
    outcomes: tuple[SurfacingOutcome, ...] = ()
    detection: SurfacingState = field(default_factory=SurfacingState)
    surfaced: VehicleState | None = None
    next_plan_ns: int | None = None


def before_event(
    problem: PlanningProblem, state: PlanningState, event: Any, flow_at: FlowAt
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state before an event; finishes a surfacing once all its observations are assimilated.

    Args:
        problem: Planning problem.
        state: State after the previous event.
        event: Next event.
        flow_at: Estimate before the event.
    """
    if state.surfaced is None or event.time_ns <= state.surfaced.time_ns:
        return state, ()
    return finish_surfacing(problem, state, flow_at)


def after_event(
    problem: PlanningProblem, state: PlanningState, event: Any, flow_at: FlowAt
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state after an event; makes a due plan at an observation, and detects surfacings.

    Args:
        problem: Planning problem.
        state: State before the event.
        event: Position or observation.
        flow_at: Estimate after the event.
    """
    outputs: tuple[Output, ...] = ()
    if isinstance(event, VehicleState):
        state = replace(state, position=event)
    else:
        now_ns, due_ns = event.time_ns, state.next_plan_ns
        if due_ns is None or now_ns >= due_ns + problem.waits_ns:
            state = replace(state, next_plan_ns=now_ns + problem.interval_ns)
        if due_ns is not None and now_ns >= due_ns + problem.waits_ns:
            state, outputs = make_plan(problem, state, flow_at(now_ns), now_ns)
    detection, fix = detect_surfacing(state.detection, event, problem.surface_depth)
    return replace(state, detection=detection, surfaced=fix or state.surfaced), outputs


def finish_surfacing(
    problem: PlanningProblem, state: PlanningState, flow_at: FlowAt
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state after a surfacing, if any; compares its prediction, and makes a plan from there if due.

    Args:
        problem: Planning problem.
        state: State with the fix of the surfacing.
        flow_at: Estimate with all observations of that time.
    """
    fix = state.surfaced
    outputs: tuple[Output, ...] = ()
    if fix is None:
        return state, ()
    if state.expected is not None:
        outcome = surfacing_outcome(*state.expected, fix)
        state = replace(state, expected=None, outcomes=(*state.outcomes, outcome))
        outputs = (lambda writer: writer.outcome(outcome),)
    state = replace(state, surfaced=None)
    if not problem.plans_at(fix.time_ns, state.next_plan_ns):
        return state, outputs
    flow, seconds = flow_at(fix.time_ns), problem.settings.surface_time or 0.0
    state = replace(state, next_plan_ns=fix.time_ns + problem.interval_ns)
    state, plan = make_plan(
        problem, state, flow, fix.time_ns + int(seconds * 1e9), _after_drift(flow, fix, seconds)
    )
    return state, (*outputs, *plan)


def make_plan(
    problem: PlanningProblem,
    state: PlanningState,
    flow: FlowEstimate,
    start_time_ns: int,
    start: Place | None = None,
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state with a new plan, and the plan; outside the region a warning instead.

    Args:
        problem: Planning problem.
        state: State with the last plan, the initial guess.
        flow: Estimate.
        start_time_ns: Start time [ns, UTC].
        start: Start of the plan; None for the last position. Nothing is planned before the first position.
    """
    if state.position is None:
        return state, ()
    start, goal = start or _place_of(state.position), problem.goal_at(start_time_ns)
    query = PlanQuery(start, goal, start_time_ns, state.result)
    try:
        result = problem.planner.plan(flow, query)
    except PlanError as error:
        failure = str(error)
        return replace(state, result=None, failure=failure, expected=None), (
            lambda writer: writer.log(start_time_ns, "warning", f"no plan: {failure}"),
        )
    expected = None if result.surfacing is None else (result.plan.start_time_ns, result.surfacing)
    return replace(state, result=result, failure="", expected=expected), (
        lambda writer: writer.plan(result.plan, flow.grid.projection),
    )


def plan_at_end(
    problem: PlanningProblem,
    state: PlanningState,
    flow_at: FlowAt,
    flow: FlowEstimate,
    last_ns: int,
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state at the end of a log, with a finished surfacing and the odds of the last plan, the one to fly.

    Odds of all plans would take as long as the plans. A plan with odds at a final surfacing is the last plan.

    Args:
        problem: Planning problem.
        state: State after the last step.
        flow_at: Estimate after it.
        flow: Estimate at ``last_ns``.
        last_ns: Time of the last message [ns, UTC].
    """
    before = state.result
    state, outputs = finish_surfacing(problem, state, flow_at)
    result, position = state.result, state.position
    if (
        problem.settings.samples
        and result is not None
        and position is not None
        and result is not before
        and (result.plan.start, result.plan.start_time_ns) == (_place_of(position), last_ns)
    ):
        return state, (*outputs, outputs[-1])
    judging = replace(problem, planner=problem.planner.with_odds())
    state, more = make_plan(judging, state, flow, last_ns)
    return state, (*outputs, *more)


def _place_of(position: VehicleState) -> Place:
    """Return the place of a position; at the surface if its depth is unknown."""
    return Place(
        position.longitude,
        position.latitude,
        max(position.depth, 0.0) if np.isfinite(position.depth) else 0.0,
    )


def _after_drift(flow: FlowEstimate, fix: VehicleState, seconds: float) -> Place:
    """Return the place at which a vehicle leaves the surface after drifting for a given time from a fix."""
    if seconds == 0.0:
        return Place(fix.longitude, fix.latitude, 0.0)
    projection = flow.grid.projection
    east, north = to_local(projection, fix.longitude, fix.latitude)
    current = flow.velocity(east, north, 0.0)
    longitude, latitude = to_geographic(
        projection, east + seconds * current[0], north + seconds * current[1]
    )
    return Place(float(longitude), float(latitude), 0.0)
