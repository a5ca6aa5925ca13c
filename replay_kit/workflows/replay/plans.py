"""Planning stage: times and starts of plans, and outcomes of predicted surfacings."""

from dataclasses import dataclass, field, replace
from typing import Any

from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.observation import VehicleState
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Surfacing, SurfacingOutcome, surfacing_outcome
from replay_kit.measurements.track.dives import SurfacingState, detect_surfacing
from replay_kit.workflows.replay.inputs.planner import Planner, PlanQuery, PlanResult
from replay_kit.workflows.replay.publishing import FlowAt, Output, depth_of

#: Why nothing is planned for a table of profiles.
NO_START = (
    "the log has no position of the vehicle to start from; plan on the result: replay-kit plan RESULT.mcap --start LON,LAT,DEPTH --goal "
    "LON,LAT,DEPTH"
)


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

    @property
    def interval_ns(self) -> int:
        """Time between plans [ns]."""
        return int(self.settings.interval * 1e9)

    @property
    def waits_ns(self) -> int:
        """Longest wait of a due plan for a surfacing, at which a glider can receive a mission [ns]; 0 for no wait."""
        waits = (self.settings.kind, self.settings.when) == ("mission", "interval")
        return self.interval_ns if waits else 0


@dataclass(frozen=True, slots=True, eq=False)
class PlanningState:
    """State of the planning stage.

    Attributes:
        position: Last position, if any.
        result: Last plan; None before the first, or failed.
        failure: Reason of a failed last plan; empty otherwise.
        expected: Start of the last plan [ns, UTC] and its predicted surfacing, until it has surfaced.
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


#: A state and what is published with it.
Planned = tuple[PlanningState, tuple[Output, ...]]


def before_event(
    problem: PlanningProblem, state: PlanningState, event: Any, flow_at: FlowAt
) -> Planned:
    """Return the state before an event; finishes a surfacing once all its observations are assimilated.

    Args:
        problem: Planning problem.
        state: State after the previous event.
        event: Next event.
        flow_at: Estimate before the event.
    """
    if state.surfaced is None or event.time_ns <= state.surfaced.time_ns:
        return state, ()
    return _surfaced(problem, state, state.surfaced, flow_at)


def after_event(
    problem: PlanningProblem, state: PlanningState, event: Any, flow_at: FlowAt
) -> Planned:
    """Return the state after an event; makes a due plan at an observation, and detects surfacings.

    Args:
        problem: Planning problem.
        state: State before the event.
        event: Position or observation.
        flow_at: Estimate after the event.
    """
    outputs: tuple[Output, ...] = ()
    now_ns, due_ns = event.time_ns, state.next_plan_ns
    if isinstance(event, VehicleState):
        state = replace(state, position=event)
    elif due_ns is None or now_ns >= due_ns + problem.waits_ns:
        state = replace(state, next_plan_ns=now_ns + problem.interval_ns)
        if due_ns is not None:
            state, outputs = _planned(problem, state, flow_at(now_ns), now_ns)
    detection, fix = detect_surfacing(state.detection, event, problem.surface_depth)
    return replace(state, detection=detection, surfaced=fix or state.surfaced), outputs


def _surfaced(
    problem: PlanningProblem, state: PlanningState, fix: VehicleState, flow_at: FlowAt
) -> Planned:
    """Return the state after a surfacing; compares its prediction, and makes a plan from there if due.

    Args:
        problem: Planning problem.
        state: State before it.
        fix: Fix of the surfacing.
        flow_at: Estimate with all observations of that time.
    """
    outputs, settings, due_ns = list[Output](), problem.settings, state.next_plan_ns
    if state.expected is not None:
        outcome = surfacing_outcome(*state.expected, fix)
        state = replace(state, expected=None, outcomes=(*state.outcomes, outcome))
        outputs.append(lambda writer: writer.outcome(outcome))
    state = replace(state, surfaced=None)
    due = problem.waits_ns > 0 and due_ns is not None and fix.time_ns >= due_ns
    if not (due or settings.when == "surfacing"):
        return state, (*outputs,)
    state = replace(state, next_plan_ns=fix.time_ns + problem.interval_ns)
    flow, seconds = flow_at(fix.time_ns), settings.surface_time or 0.0
    longitude, latitude = fix.longitude, fix.latitude
    if seconds:
        # where the current takes it at the surface
        east, north = to_local(flow.grid.projection, longitude, latitude)
        u, v = flow.velocity(east, north, 0.0)
        drifted = to_geographic(flow.grid.projection, east + seconds * u, north + seconds * v)
        longitude, latitude = map(float, drifted)
    begin_ns, start = fix.time_ns + int(seconds * 1e9), Place(longitude, latitude, 0.0)
    state, plan = _planned(problem, state, flow, begin_ns, start)
    return state, (*outputs, *plan)


def _planned(
    problem: PlanningProblem,
    state: PlanningState,
    flow: FlowEstimate,
    start_time_ns: int,
    start: Place | None = None,
) -> Planned:
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
    later = (goal for since_ns, goal in reversed(problem.later_goals) if start_time_ns >= since_ns)
    goal, start = next(later, problem.goal), start or _place_of(state.position)
    try:
        result = problem.planner.plan(flow, PlanQuery(start, goal, start_time_ns, state.result))
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
) -> Planned:
    """Return the state at the end of a log, with a finished surfacing and the odds of the last plan, the one to fly.

    Odds of all plans would take as long as the plans. A plan at a final surfacing is the last plan.

    Args:
        problem: Planning problem.
        state: State after the last step.
        flow_at: Estimate after it.
        flow: Last estimate.
        last_ns: Time at which the last plan begins [ns, UTC].
    """
    before, outputs, position = state.result, tuple[Output, ...](), state.position
    if position is None:
        return replace(state, failure=NO_START), (
            lambda writer: writer.log(last_ns, "warning", f"no plan: {NO_START}"),
        )
    judging = replace(problem, planner=problem.planner.with_odds())
    if state.surfaced is not None:
        state, outputs = _surfaced(judging, state, state.surfaced, flow_at)
    result = state.result
    if result is not None and result is not before:
        plan = result.plan
        if (plan.start, plan.start_time_ns) == (_place_of(position), last_ns):
            return state, outputs
    state, more = _planned(judging, state, flow, last_ns)
    return state, (*outputs, *more)


def _place_of(position: VehicleState) -> Place:
    """Return the place of a position; at the surface if its depth is unknown."""
    return Place(position.longitude, position.latitude, depth_of(position))
