"""Consequences of a step of the estimate: publication, due plans, and comparison of finished dives."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from replay_kit.core.arrays import replace
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import VehicleState
from replay_kit.core.surfacing import DiveOutcome
from replay_kit.workflows.replay.events import Aside, Track
from replay_kit.workflows.replay.run import Run
from replay_kit.workflows.replay.stages import plans
from replay_kit.workflows.replay.stages.estimation import Step
from replay_kit.workflows.replay.stages.plans import PlanningState
from replay_kit.workflows.replay.stages.publishing import (
    Output,
    depth_slices,
    publish_surface,
    publish_track,
    publish_windows,
)
from replay_kit.workflows.replay.surfacings.forecasts import (
    ForecastState,
    forecast_end,
    forecast_step,
    forecast_track,
)


def follow_up(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
    """Publish a block of steps by vehicle with their consequences, then the last estimates of finished windows."""
    for number, step in steps:
        _follow_up(run, number, step)
    if run.writer is not None:
        left_windows(run, map(run.dated, run.estimator(0).left_flows(run.current)))


def _follow_up(run: Run, number: int, step: Step) -> None:
    """Publish a step with its consequences."""
    if not isinstance(step.event, Track):
        _follow_one(run, number, step)
    elif not _passed(run, number, step, step.event):
        for position in step.event:
            _follow_one(run, number, replace(step, event=position))


def _passed(run: Run, number: int, step: Step, track: Track) -> bool:
    """Publish consecutive positions without further consequences, and return whether the step was that."""
    of, setup = run.of[number], run.setups[number]
    if setup.problem or run.is_pooled:
        return False
    depth = setup.config.measurements.surface_depth
    if (forecasts := forecast_track(of.forecasts, track, depth)) is None:
        return False
    run.put(number, forecasts=forecasts)
    if run.writer is not None:
        flow = partial(run.flow, number, step.after)
        publishing, outputs = publish_track(of.publishing, track, flow)
        run.put(number, publishing=publishing)
        run.write(number, outputs)
    return True


def _follow_one(run: Run, number: int, step: Step) -> None:
    """Publish a position or observation with its consequences."""
    before, after = (partial(run.flow, number, state) for state in (step.before, step.after))
    setup, event = run.setups[number], step.event
    depth = setup.config.measurements.surface_depth
    if not isinstance(event, Aside):
        _plan(run, number, plans.before_event, event, before)
        _publish(run, number, step, after)
    _expect(run, number, forecast_step(run.of[number].forecasts, step, before, depth))
    if not isinstance(event, Aside):
        _plan(run, number, plans.after_event, event, after)


def _publish(run: Run, number: int, step: Step, flow_at: Callable[[int], FlowEstimate]) -> None:
    """Publish a position, or the surface current and due depth slices after an observation."""
    if run.writer is None:
        return
    event, state = step.event, run.of[number].publishing
    if isinstance(event, VehicleState):
        publishing, outputs = publish_track(state, [event], flow_at)
    else:
        publishing, outputs = publish_surface(state, step, flow_at)
    run.put(number, publishing=publishing)
    run.write(number, outputs)
    # vehicles share the slices of a window
    window = run.estimator(number).window(step.after) if run.is_pooled else None
    due_ns, settings = run.next_slices_ns.get(window), run.setups[number].config.output
    if step.innovation is not None and (due_ns is None or event.time_ns >= due_ns):
        run.next_slices_ns[window] = event.time_ns + int(settings.interval * 1e9)
        run.write(number, (depth_slices(event.time_ns, flow_at(event.time_ns), settings),))


def left_windows(run: Run, flows: Iterator[FlowEstimate]) -> list[int]:
    """Publish the last estimates of windows; return their numbers."""
    before = run.of[0].publishing
    publishing, windows = publish_windows(before, flows)
    run.put(0, publishing=publishing)
    run.write(0, windows)
    return list(range(before.windows + 1, publishing.windows + 1))


def end(run: Run, number: int) -> FlowEstimate:
    """Finish a surfacing of a vehicle and plan from its last position; return the estimate used."""
    at = partial(run.flow, number, run.current)
    _expect(run, number, forecast_end(run.of[number].forecasts))
    flow = at(run.last_ns)
    _plan(run, number, plans.plan_at_end, at, flow, run.last_ns)
    return flow


def publish(run: Run, flow: FlowEstimate, time_ns: int) -> None:
    """Publish the last depth slices of an estimate for a time [ns, UTC]."""
    run.write(0, (depth_slices(time_ns, flow, run.setups[0].config.output),))


def _plan(
    run: Run,
    number: int,
    stage: Callable[..., tuple[PlanningState, tuple[Output, ...]]],
    *arguments: Any,
) -> None:
    """Run one step of the planning stage, if there is a goal."""
    if (problem := run.problem(number)) is not None:
        with run.clock.stage("plan"):
            planning, outputs = stage(problem, run.of[number].planning, *arguments)
        run.put(number, planning=planning)
        run.write(number, outputs)


def _expect(run: Run, number: int, forecasts: ForecastState) -> None:
    """Store the state of the surfacing forecasts, and write the outcomes that are new."""
    before = run.of[number].forecasts
    if forecasts is not before:
        run.put(number, forecasts=forecasts)
        run.write(number, map(_dive_outcome, forecasts.outcomes[len(before.outcomes) :]))


def _dive_outcome(outcome: DiveOutcome) -> Output:
    return lambda writer: writer.dive_outcome(outcome)
