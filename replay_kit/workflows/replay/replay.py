"""One log end to end: messages in, observations, estimates and plans out.

The loop is driven by the messages' own times; nothing depends on the wall clock, and the same inputs and options give the same
bytes. Wall times go to the summary only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, LogError, MeasurementError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.netcdf import write_grid
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.logs import merge
from replay_kit.measurements import MeasurementState, finish, initial_state, interpret
from replay_kit.results import Digest, ResultWriter
from replay_kit.results.summary import ReplaySummary, TruthScore
from replay_kit.workflows.replay.build import Forecasts, build, flow_at, read_forecasts
from replay_kit.workflows.replay.checkpoint import Checkpoints, run_identity
from replay_kit.workflows.replay.job import Planner, ReplayJob, check_outputs, copy_inputs, look_ahead, open_readers, open_truth
from replay_kit.workflows.replay.provenance import run_metadata, run_settings_toml
from replay_kit.workflows.replay.scoring import score_against_truth
from replay_kit.workflows.replay.session import Run, handle, make_plan, settle_surfacing, work_off, write_grids
from replay_kit.workflows.replay.statistics import Stopwatch, Tally


def replay(
    job: ReplayJob,
    config: RunConfig,
    planner: Planner | None = None,
    on_message: Callable[[int], None] | None = None,
    on_digest: Callable[[Digest], None] | None = None,
) -> tuple[ReplaySummary, FlowEstimate]:
    """Replay logs through the estimator and return the summary and the final estimate.

    Args:
        job: Inputs and outputs.
        config: The run's settings.
        planner: Makes the plans when the job has a goal.
        on_message: Called with each message's time [ns], for progress.
        on_digest: Called with each digest of the result.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: The ensemble or truth cannot be used.
        MeasurementError: The logs hold no usable ping of this region.
        PlanError: The goal is outside the region or on land.
        ConfigError: An output exists and may not be replaced, or an option is wrong.
    """
    check_outputs(job)
    with threadpool_limits(limits=config.output.threads):
        return _replay(job, config, planner, on_message or (lambda time_ns: None), on_digest)


def _replay(
    job: ReplayJob,
    config: RunConfig,
    planner: Planner | None,
    on_message: Callable[[int], None],
    on_digest: Callable[[Digest], None] | None,
) -> tuple[ReplaySummary, FlowEstimate]:
    clock, tally = Stopwatch(), Tally()
    place_at, near_ns = look_ahead(job.logs, config)
    readers = open_readers(job.logs, config)
    with clock.stage("forecast"):
        forecasts = read_forecasts(job.ensemble, config, near_ns, place_at)
        ensemble = forecasts.ensemble
        truth = open_truth(job, config, near_ns, ensemble)
    with clock.stage("basis"):
        estimator = build(forecasts, config, None if job.goal is None else job.goal.depth)
        prior_flow = estimator.flow(estimator.initial())
    if job.goal is not None and planner is not None:
        planner.check(prior_flow, job.goal)
    run = Run(estimator, None, planner, job, config, ensemble.grid.levels, clock, tally, estimator.initial(), estimator.initial())
    metadata = {} if job.out is None else run_metadata(job.logs, job.ensemble, ensemble, _options(job, prior_flow))
    checkpoints = None
    if job.checkpoint is not None:
        identity = run_identity(metadata, run_settings_toml(config))
        checkpoints = Checkpoints(job.checkpoint, identity, config.output.checkpoint_interval)
    try:
        begin = _begin(run, forecasts, prior_flow, metadata, checkpoints, on_digest)
        _loop(run, begin, readers, checkpoints, on_message)
        summary, flow = _conclude(run, forecasts, prior_flow, readers, truth)
    except (ConfigError, MeasurementError, LogError, PlanError):
        # the input was unusable: there is no result worth keeping
        if run.writer is not None:
            run.writer.discard()
        raise
    except BaseException:
        # anything else, an interrupt first of all, leaves OUT.part with every whole chunk
        if run.writer is not None:
            run.writer.abandon()
        raise
    finally:
        if checkpoints is not None:
            checkpoints.close()
    if checkpoints is not None:
        checkpoints.remove()
    return summary, flow


@dataclass(frozen=True, slots=True)
class _Begin:
    """How a loop begins.

    Attributes:
        first: Called with the time of the first message [ns, UTC], when no result was begun before.
        measurement: What the measurement step remembers.
        skip: Number of messages taken before.
    """

    first: Callable[[int], None]
    measurement: MeasurementState
    skip: int = 0


def _begin(
    run: Run,
    forecasts: Forecasts,
    prior_flow: FlowEstimate,
    metadata: Mapping[str, Mapping[str, str]],
    checkpoints: Checkpoints | None,
    on_digest: Callable[[Digest], None] | None,
) -> _Begin:
    """Open the result and return how the loop begins: anew, or where a checkpoint was made."""
    if run.job.out is None:
        return _Begin(lambda time_ns: None, initial_state(run.config.logs.system))
    resumed = checkpoints.resume(run) if checkpoints is not None else None
    journal = checkpoints.open_journal(resumed) if checkpoints is not None else None
    writer = run.writer = ResultWriter(run.job.out, run.job.overwrite, on_digest, journal)

    def first(time_ns: int) -> None:
        with run.clock.stage("write"):
            writer.start(prior_flow.grid.projection, time_ns, metadata, run_settings_toml(run.config))
            for note in forecasts.notes:
                writer.log(time_ns, "warning", note)
            copy_inputs(writer, run.job, run.config.logs)

    if resumed is None or checkpoints is None:
        return _Begin(first, initial_state(run.config.logs.system))
    checkpoints.write_again(writer, resumed, lambda: copy_inputs(writer, run.job, run.config.logs))
    return _Begin(lambda time_ns: None, resumed.measurement, resumed.messages)


def _loop(
    run: Run, begin: _Begin, readers: Sequence[LogReader], checkpoints: Checkpoints | None, on_message: Callable[[int], None]
) -> None:
    logs = run.config.logs
    merged = merge(readers, logs.reorder_window, logs.start_ns, logs.end_ns)
    messages, taken, state = iter(merged), 0, begin.measurement
    while True:
        with run.clock.stage("read"):
            message = next(messages, None)
        if message is None:
            break
        taken += 1
        if taken <= begin.skip:
            continue
        if taken == 1:
            begin.first(message.time_ns)
        run.last_ns = message.time_ns
        with run.clock.stage("measure"):
            state, events = interpret(state, message, run.config.measurements)
        for event in events:
            handle(run, event)
        if checkpoints is not None:
            checkpoints.keep_when_due(run, state, taken)
        on_message(message.time_ns)
    for event in finish(state, run.config.measurements):
        handle(run, event)
    work_off(run)
    run.tally.late = merged.late


def _options(job: ReplayJob, flow: FlowEstimate) -> dict[str, str]:
    """Return what the run was asked for beyond its configuration, and the basis it chose."""
    goal = job.goal
    return {
        "goal": "" if goal is None else f"{goal.longitude!r},{goal.latitude!r},{goal.depth!r}",
        "include_inputs": str(job.include_inputs).lower(),
        "truth": "" if job.truth is None else Path(job.truth).name,
        "truth_radius_km": "" if job.truth_radius_km is None else repr(job.truth_radius_km),
        "modes": str(flow.n_modes),
        "depth_functions": flow.depth_functions.kind,
        "kernel_length_east_m": repr(flow.kernel.length_east),
        "kernel_length_north_m": repr(flow.kernel.length_north),
        "kernel_speed": repr(flow.kernel.speed),
    }


def _conclude(
    run: Run, forecasts: Forecasts, prior_flow: FlowEstimate, readers: Sequence[LogReader], truth: Ensemble | None
) -> tuple[ReplaySummary, FlowEstimate]:
    """Publish the result, then compare it with the truth: a truth that does not fit must not cost the result."""
    reports = [reader.report() for reader in readers]
    run.tally.require_usable(reports, forecasts.ensemble.grid, run.vehicle)
    settle_surfacing(run)
    flow = flow_at(run.estimator, run.state, run.last_ns)
    make_plan(run, run.last_ns, flow)
    kernel = flow.kernel
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    notes = [*forecasts.notes, *run.tally.notes(reports), basis, *run.estimator.notes(), *run.estimator.bias_notes(run.state)]
    if run.job.goal is None:
        notes.append("no goal was given (--goal LON,LAT,DEPTH), so nothing was planned")
    if run.writer is not None:
        write_grids(run, run.last_ns, flow)
        with run.clock.stage("write"):
            run.writer.digest(run.last_ns)
            run.writer.finish(flow)
            run.writer.close()
    with run.clock.stage("write"):
        if run.job.netcdf is not None:
            write_grid(flow, run.job.netcdf)
        if run.job.save_estimate is not None:
            flow.save(run.job.save_estimate)
    score = None
    if truth is not None:
        with run.clock.stage("score"):
            if forecasts.evolves:
                # the estimate is of the log's end, and so is what it is held against
                truth = open_truth(run.job, run.config, flow.time_ns, forecasts.ensemble) or truth
                prior_flow = prior_flow.at(run.last_ns)
            score, why_not = _score(run, forecasts.nearest(flow.time_ns), flow, prior_flow, truth)
            notes += why_not
    plan = None if run.planned is None else run.planned.plan
    summary = run.tally.summary(reports, run.clock.seconds, (plan, run.plan_note, tuple(run.outcomes)), score, tuple(notes))
    return summary, flow


def _score(
    run: Run, ensemble: Ensemble, flow: FlowEstimate, prior_flow: FlowEstimate, truth: Ensemble
) -> tuple[TruthScore | None, list[str]]:
    """Return the score, or as much of it as there is, and why the rest is missing."""
    try:
        score, truth_flow = score_against_truth(flow, ensemble, truth, run.positions, run.job.truth_radius_km, run.config.estimator)
    except MeasurementError as error:
        return None, [f"no score: {error}"]
    if run.planned is None or run.planner is None or run.planned.plan.status == "failed":
        return score, []
    plan = run.planned.plan
    mean_plan = run.planner.plan(prior_flow, plan.start, plan.goal, plan.start_time_ns, None)
    try:
        closest = [run.planner.closest_approach(truth_flow, planned) for planned in (run.planned, mean_plan)]
    except PlanError as error:
        return score, [f"the plans cannot be flown in the truth: {error}"]
    return replace(score, closest_approach_m=closest[0], ensemble_mean_closest_approach_m=closest[1]), []
