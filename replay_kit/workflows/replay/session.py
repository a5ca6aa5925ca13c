"""A replay's moving parts: what the next message changes, and what is published when."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.observation import Innovation, Measurement, PathMean, VehicleState
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Outcome, Surfacing, outcome_of
from replay_kit.estimator import Estimator
from replay_kit.measurements import Event, Skipped, Used
from replay_kit.measurements.vehicle.surfacing import SurfacingWatch, watched
from replay_kit.results import ResultWriter
from replay_kit.workflows.replay.build import flow_at
from replay_kit.workflows.replay.job import Planned, Planner, ReplayJob
from replay_kit.workflows.replay.statistics import Stopwatch, Tally

# A log may hold positions and nothing else.
_WAITING = 4096


@dataclass(slots=True)
class Run:
    """The loop's moving parts: everything here is a frozen value that the next message replaces.

    Attributes:
        estimator: Does the estimating.
        writer: Takes what is published; None publishes nothing.
        planner: Makes the plans when the job has a goal.
        job: Inputs and outputs.
        config: The run's settings.
        levels: shape (Z,) [m].
        clock: Wall time of each stage.
        tally: What was counted.
        state: The estimator's, after the last observation published.
        dive_start: The state before the dive's first observation.
        dive: Number of the dive.
        vehicle: Last position.
        planned: Last plan, or None, with the reason in ``plan_note``.
        expected: When it begins [ns, UTC] and the surfacing that it says is next, until the vehicle has surfaced; None without.
        outcomes: Surfacings that plans said would be next, beside the vehicle's.
        watch: What tells a surfacing.
        surfaced: Fix at which the vehicle surfaced, until all that came with it is assimilated; None at other times.
        next_plan_ns: When the next plan is due [ns, UTC].
        next_grid_ns: When the next depth slices are due.
        last_ns: Time of the last message.
        positions: Longitude and latitude of each measurement used; of a path, where it ended.
        waiting: Positions and measurements in the order of the log, not yet published.
        n_observations: Measurements among them.
    """

    # Any: each kind of estimator has a state of its own, which only it looks into
    estimator: Estimator[Any]
    writer: ResultWriter | None
    planner: Planner | None
    job: ReplayJob
    config: RunConfig
    levels: Array
    clock: Stopwatch
    tally: Tally
    state: Any
    dive_start: Any
    dive: int = 0
    vehicle: VehicleState | None = None
    planned: Planned | None = None
    expected: tuple[int, Surfacing] | None = None
    outcomes: list[Outcome] = field(default_factory=list)
    watch: SurfacingWatch = field(default_factory=SurfacingWatch)
    surfaced: VehicleState | None = None
    plan_note: str = ""
    next_plan_ns: int | None = None
    next_grid_ns: int | None = None
    last_ns: int = 0
    positions: list[tuple[float, float]] = field(default_factory=list)
    waiting: list[VehicleState | Measurement] = field(default_factory=list)
    n_observations: int = 0


def handle(run: Run, event: Event) -> None:
    """Count an event; what the estimate is made of waits for its like, because a block of observations takes little longer than one."""
    if isinstance(event, Used):
        run.tally.used(event.topic)
    elif isinstance(event, Skipped):
        run.tally.skipped(event.topic, event.reason)
    elif isinstance(event, PathMean) and not run.estimator.supports_path_means:
        run.tally.not_taken(event)
    else:
        run.waiting.append(event)
        run.n_observations += isinstance(event, Measurement)
        if run.n_observations == run.estimator.block_size or len(run.waiting) == _WAITING:
            work_off(run)


def work_off(run: Run) -> None:
    """Assimilate the observations that wait, then publish everything in the order in which it came."""
    # Any: only an estimator that says so is given mean currents
    observations: list[Any] = [event for event in run.waiting if isinstance(event, Measurement)]
    with run.clock.stage("estimate"):
        done = list(run.estimator.steps(run.state, observations))
        states = [state for state, _ in done]
        means = run.estimator.weights(states)
    after = iter(zip(done, means, strict=True))
    for event in run.waiting:
        if run.surfaced is not None and event.time_ns > run.surfaced.time_ns:
            settle_surfacing(run)
        if isinstance(event, Measurement):
            (state, innovation), mean = next(after)
            _assimilated(run, event, state, innovation, mean)
        else:
            run.vehicle = event
            if run.writer is not None:
                with run.clock.stage("write"):
                    run.writer.fix(event)
        run.watch, fix = watched(run.watch, event, run.config.measurements.surface_depth)
        run.surfaced = fix or run.surfaced
    run.waiting.clear()
    run.n_observations = 0


def _assimilated(run: Run, observation: Any, state: Any, innovation: Innovation, mean: Array | None) -> None:
    """Publish what a measurement said and the state after it; ``mean`` is that of the state's weights, where it has weights."""
    if observation.dive != run.dive:
        run.dive, run.dive_start = observation.dive, run.state
    with run.clock.stage("estimate"):
        predicted = run.estimator.innovation(run.dive_start, observation)
    run.state = state
    run.tally.observed(innovation, predicted)
    if innovation.accepted:
        run.positions.append(_place_of(observation))
    if run.writer is not None:
        with run.clock.stage("write"):
            run.writer.innovation(innovation)
            if innovation.accepted and mean is not None:
                run.writer.estimate(observation.time_ns, mean, run.levels)
    _publish_when_due(run, observation.time_ns)


def _place_of(measurement: Measurement) -> tuple[float, float]:
    if isinstance(measurement, PathMean):
        return float(measurement.longitude[-1]), float(measurement.latitude[-1])
    return measurement.longitude, measurement.latitude


def _publish_when_due(run: Run, now_ns: int) -> None:
    if run.next_grid_ns is None or now_ns >= run.next_grid_ns:
        run.next_grid_ns = now_ns + int(run.config.output.interval * 1e9)
        write_grids(run, now_ns, flow_at(run.estimator, run.state, now_ns))
        if run.writer is not None:
            run.writer.digest(now_ns)
    if run.next_plan_ns is None:
        run.next_plan_ns = now_ns + int(run.config.planner.interval * 1e9)
    elif now_ns >= run.next_plan_ns:
        run.next_plan_ns = now_ns + int(run.config.planner.interval * 1e9)
        make_plan(run, now_ns, flow_at(run.estimator, run.state, now_ns))


def settle_surfacing(run: Run) -> None:
    """Put the last plan's next surfacing beside the vehicle's, if it has surfaced, and plan anew from there when that is asked for."""
    fix, run.surfaced = run.surfaced, None
    if fix is None or run.planner is None or run.job.goal is None:
        return
    if run.expected is not None:
        outcome, run.expected = outcome_of(*run.expected, fix), None
        run.outcomes.append(outcome)
        if run.writer is not None:
            with run.clock.stage("write"):
                run.writer.outcome(outcome)
    if run.config.planner.at_surfacings:
        run.next_plan_ns = fix.time_ns + int(run.config.planner.interval * 1e9)
        flow, seconds = flow_at(run.estimator, run.state, fix.time_ns), run.config.planner.surface_time
        make_plan(run, fix.time_ns + int(seconds * 1e9), flow, _adrift(flow, fix, seconds))


def _adrift(flow: FlowEstimate, fix: VehicleState, seconds: float) -> Place:
    """Return where a vehicle that has surfaced leaves the surface after some time adrift."""
    east, north = to_local(flow.grid.projection, fix.longitude, fix.latitude)
    current = flow.velocity(east, north, 0.0)
    longitude, latitude = to_geographic(flow.grid.projection, east + seconds * current[0], north + seconds * current[1])
    return Place(float(longitude), float(latitude), 0.0)


def write_grids(run: Run, now_ns: int, flow: FlowEstimate) -> None:
    """Write the depth slices of a flow, if there is a result to write."""
    if run.writer is None:
        return
    levels = flow.levels
    depths = run.config.output.depths or tuple(float(levels[i]) for i in sorted({0, levels.size // 2, levels.size - 1}))
    with run.clock.stage("write"):
        run.writer.grids(now_ns, flow, depths)


def _start_place(vehicle: VehicleState) -> Place:
    return Place(vehicle.longitude, vehicle.latitude, max(vehicle.depth, 0.0) if np.isfinite(vehicle.depth) else 0.0)


def make_plan(run: Run, now_ns: int, flow: FlowEstimate, start: Place | None = None) -> None:
    """Plan from a place, by default from where the vehicle is; a vehicle outside the region is said and does not end the replay."""
    if run.planner is None or run.job.goal is None or run.vehicle is None:
        return
    with run.clock.stage("plan"):
        try:
            run.planned, run.plan_note = run.planner.plan(flow, start or _start_place(run.vehicle), run.job.goal, now_ns, run.planned), ""
        except PlanError as error:
            run.planned, run.plan_note = None, str(error)
    run.expected = None
    if run.planned is not None and run.planned.surfacing is not None:
        run.expected = run.planned.plan.start_time_ns, run.planned.surfacing
    if run.writer is not None:
        with run.clock.stage("write"):
            if run.planned is not None:
                run.writer.plan(run.planned.plan, flow.grid.projection)
            else:
                run.writer.log(now_ns, "warning", f"no plan: {run.plan_note}")
