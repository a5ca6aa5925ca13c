"""The planning stage: when the vehicle's way is planned, from where, and how each prediction of a surfacing turned out."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.observation import VehicleState
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Surfacing, SurfacingOutcome, surfacing_outcome
from replay_kit.measurements.surfacings import SurfacingState, detect_surfacing
from replay_kit.workflows.replay.stages.planner import Planner, PlanQuery, PlanResult
from replay_kit.workflows.replay.stages.publishing import Output

#: Returns the estimate for a time [ns, UTC].
FlowAt = Callable[[int], FlowEstimate]


@dataclass(frozen=True, slots=True, eq=False)
class PlanningProblem:
    """What stays the same while a replay plans.

    Attributes:
        planner: Makes the plans.
        goal: Where the vehicle should go.
        settings: When to plan.
        surface_depth: Shallower than this the vehicle is at the surface [m].
        later_goals: From when on [ns, UTC] it should go elsewhere, in order.
    """

    planner: Planner
    goal: Place
    settings: PlannerConfig
    surface_depth: float
    later_goals: tuple[tuple[int, Place], ...] = ()

    def goal_at(self, time_ns: int) -> Place:
        """Return the goal of a plan that begins at a time [ns, UTC]."""
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
        """How long a plan that is due waits for a surfacing, at which a glider can be told a mission [ns]; 0 where it does not."""
        return (
            self.interval_ns
            if (self.settings.kind, self.settings.when) == ("mission", "interval")
            else 0
        )

    def plans_at(self, surfaced_ns: int, due_ns: int | None) -> bool:
        """Return whether a plan is made at a surfacing, given when the next plan is due [ns, UTC]."""
        return self.settings.when == "surfacing" or (
            self.waits_ns > 0 and due_ns is not None and surfaced_ns >= due_ns
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlanningState:
    """What the planning stage remembers.

    Attributes:
        position: Last position; None before the first.
        result: Last plan; None before the first, and when it failed.
        failure: Why the last plan failed; empty otherwise.
        expected: Start of the last plan [ns, UTC] and the surfacing that it predicts, until the vehicle has surfaced; None without.
        outcomes: Predicted surfacings beside the vehicle's.
        detection: Of surfacings.
        surfaced: Fix at which the vehicle surfaced, until all measurements of that time are assimilated; None at other times.
        next_plan_ns: When the next plan is due [ns, UTC]; None before the first measurement.
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
    """Return the state before an event: a surfacing is finished once everything that came with it is assimilated.

    Args:
        problem: What stays the same.
        state: After the event before.
        event: The next one.
        flow_at: The estimate before it.
    """
    if state.surfaced is None or event.time_ns <= state.surfaced.time_ns:
        return state, ()
    return finish_surfacing(problem, state, flow_at)


def after_event(
    problem: PlanningProblem, state: PlanningState, event: Any, flow_at: FlowAt
) -> tuple[PlanningState, tuple[Output, ...]]:
    """Return the state after an event: planned at a measurement when a plan is due; a surfacing is detected.

    Args:
        problem: What stays the same.
        state: Before the event.
        event: A position or a measurement.
        flow_at: The estimate after it.
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
    """Return the state after a surfacing, if there was one: its prediction is compared, and the next plan begins there if one is.

    Args:
        problem: What stays the same.
        state: With the fix at which the vehicle surfaced.
        flow_at: The estimate with all measurements of that time.
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
    """Return the state with a new plan, and the plan; a vehicle outside the region gives a warning and does not end the replay.

    Args:
        problem: What stays the same.
        state: With the last plan, from which the planner starts.
        flow: The estimate.
        start_time_ns: [ns, UTC].
        start: Where the plan begins; None for the last position. Before the first position nothing is planned.
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
    """Return the state at the end of a log: a surfacing is finished, and the last plan, the one to act on, has its odds.

    Those of all plans would take as long as the plans. Where the log ends with a surfacing, and its plan has odds, that is the last one.

    Args:
        problem: What stays the same.
        state: After the last step.
        flow_at: The estimate after it.
        flow: That for ``last_ns``.
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
    """Return a position as a place; at the surface when its depth is unknown."""
    return Place(
        position.longitude,
        position.latitude,
        max(position.depth, 0.0) if np.isfinite(position.depth) else 0.0,
    )


def _after_drift(flow: FlowEstimate, fix: VehicleState, seconds: float) -> Place:
    """Return where a vehicle leaves the surface that drifts with the current for some time after a fix."""
    if seconds == 0.0:
        return Place(fix.longitude, fix.latitude, 0.0)
    projection = flow.grid.projection
    east, north = to_local(projection, fix.longitude, fix.latitude)
    current = flow.velocity(east, north, 0.0)
    longitude, latitude = to_geographic(
        projection, east + seconds * current[0], north + seconds * current[1]
    )
    return Place(float(longitude), float(latitude), 0.0)
