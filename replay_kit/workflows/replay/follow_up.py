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
from replay_kit.workflows.replay.vehicle import OfVehicle


def follow_up(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
    """Publish a block of steps by vehicle with their consequences, then the last estimates of finished windows."""
    for number, step in steps:
        _follow_up(run, run.of[number], step)
    if run.writer is not None:
        left_windows(run, map(run.dated, run.of[0].estimator.left_flows(run.current)))


def _follow_up(run: Run, of: OfVehicle, step: Step) -> None:
    """Publish a step with its consequences."""
    if not isinstance(step.event, Track):
        _follow_one(run, of, step)
    elif not _passed(run, of, step, step.event):
        for position in step.event:
            _follow_one(run, of, replace(step, event=position))


def _passed(run: Run, of: OfVehicle, step: Step, track: Track) -> bool:
    """Publish consecutive positions without further consequences, and return whether the step was that."""
    if of.setup.problem or run.is_pooled:
        return False
    depth = of.setup.config.measurements.surface_depth
    if (forecasts := forecast_track(of.forecasts, track, depth)) is None:
        return False
    of.forecasts = forecasts
    _publish(run, of, step, partial(of.flow, step.after))
    return True


def _follow_one(run: Run, of: OfVehicle, step: Step) -> None:
    """Publish a position or observation with its consequences."""
    before, after = partial(of.flow, step.before), partial(of.flow, step.after)
    depth, event = of.setup.config.measurements.surface_depth, step.event
    if not isinstance(event, Aside):
        _plan(run, of, plans.before_event, event, before)
        _publish(run, of, step, after)
    _expect(run, of, forecast_step(of.forecasts, step, before, depth))
    if not isinstance(event, Aside):
        _plan(run, of, plans.after_event, event, after)


def _publish(
    run: Run, of: OfVehicle, step: Step, flow_after: Callable[[int], FlowEstimate]
) -> None:
    """Publish positions, or the surface current and due depth slices after an observation."""
    if run.writer is None:
        return
    if isinstance(event := step.event, Track | VehicleState):
        track = event if isinstance(event, Track) else [event]
        of.publishing, outputs = publish_track(of.publishing, track, flow_after)
    else:
        of.publishing, outputs = publish_surface(of.publishing, step, flow_after)
    run.write(of, outputs)
    # vehicles share the slices of a window
    window = of.estimator.window(step.after) if run.is_pooled else None
    due_ns, settings = run.next_slices_ns.get(window), of.setup.config.output
    if step.innovation is not None and (due_ns is None or event.time_ns >= due_ns):
        run.next_slices_ns[window] = event.time_ns + int(settings.interval * 1e9)
        run.write(of, (depth_slices(event.time_ns, flow_after(event.time_ns), settings),))


def left_windows(run: Run, flows: Iterator[FlowEstimate]) -> list[int]:
    """Publish the last estimates of windows; return their numbers."""
    of, before = run.of[0], run.of[0].publishing.windows
    of.publishing, windows = publish_windows(of.publishing, flows)
    run.write(of, windows)
    return list(range(before + 1, of.publishing.windows + 1))


def end(run: Run, of: OfVehicle) -> FlowEstimate:
    """Finish a surfacing of a vehicle and plan from its last position; return the estimate used."""
    _expect(run, of, forecast_end(of.forecasts))
    flow = of.flow(run.current, run.last_ns)
    _plan(run, of, plans.plan_at_end, partial(of.flow, run.current), flow, run.last_ns)
    return flow


def publish(run: Run, flow: FlowEstimate, time_ns: int) -> None:
    """Publish the last depth slices of an estimate for a time [ns, UTC]."""
    run.write(run.of[0], (depth_slices(time_ns, flow, run.config.output),))


def _plan(
    run: Run,
    of: OfVehicle,
    stage: Callable[..., tuple[PlanningState, tuple[Output, ...]]],
    *arguments: Any,
) -> None:
    """Run one step of the planning stage, if there is a goal."""
    if (problem := of.problem) is not None:
        with run.clock.stage("plan"):
            of.planning, outputs = stage(problem, of.planning, *arguments)
        run.write(of, outputs)


def _expect(run: Run, of: OfVehicle, forecasts: ForecastState) -> None:
    """Store the state of the surfacing forecasts, and write the outcomes that are new."""
    known, of.forecasts = len(of.forecasts.outcomes), forecasts
    run.write(of, map(_dive_outcome, forecasts.outcomes[known:]))


def _dive_outcome(outcome: DiveOutcome) -> Output:
    return lambda writer: writer.dive_outcome(outcome)
