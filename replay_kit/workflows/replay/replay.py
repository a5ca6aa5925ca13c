"""One log end to end: messages in, observations, estimates and plans out.

The messages' own times drive the loop; nothing depends on the wall clock, and the same inputs and options give the same bytes. Wall times
go to the summary only.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError, LogError, MeasurementError, PlanError, ReplayKitError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.netcdf import write_grid
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.core.progress import Progress, silent
from replay_kit.core.region import around
from replay_kit.core.unchanged import check_unchanged
from replay_kit.forecast import ensemble_files, find_sources
from replay_kit.logs import merge
from replay_kit.measurements import finish, initial_state, interpret_block
from replay_kit.results import Digest, ResultWriter
from replay_kit.results.summary import ReplaySummary, TruthScore
from replay_kit.results.summary_json import failure_json, to_record
from replay_kit.workflows.replay.basis_store import built
from replay_kit.workflows.replay.build import Forecasts
from replay_kit.workflows.replay.checkpoint import Checkpoint, CheckpointFile, resuming, run_identity
from replay_kit.workflows.replay.consistency import checked_speeds, conclusions
from replay_kit.workflows.replay.inputs import (
    ReplayJob,
    check_goal,
    check_outputs,
    copy_inputs,
    forecasts_of,
    input_stamps,
    open_truth,
    reading,
    with_planner_kind,
)
from replay_kit.workflows.replay.look_ahead import check_span, open_readers
from replay_kit.workflows.replay.planner import PlannerFactory
from replay_kit.workflows.replay.plans import PlanningProblem
from replay_kit.workflows.replay.provenance import run_metadata, run_options, run_settings_toml
from replay_kit.workflows.replay.region import REGION_RECORD
from replay_kit.workflows.replay.scoring import score_against_truth
from replay_kit.workflows.replay.session import Session
from replay_kit.workflows.replay.stopwatch import Stopwatch

# Messages that are decoded and tested together.
_BLOCK = 128


def replay(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
    progress: Progress = silent,
    on_digest: Callable[[Digest], None] | None = None,
    forecasts: Forecasts | None = None,
) -> tuple[ReplaySummary, FlowEstimate]:
    """Replay logs through the estimator and return the summary and the final estimate.

    Args:
        job: Inputs and outputs.
        config: The run's settings.
        planner_of: Makes the planner, when the job has a goal.
        progress: Called with how much is done of each stage.
        on_digest: Called with each digest of the result.
        forecasts: What ``forecasts_of`` reads for this job; None reads it.

    Raises:
        LogError: A log cannot be opened; or an input changed while it was read.
        ForecastError: The ensemble or truth cannot be used.
        MeasurementError: The logs hold no usable ping of this region.
        PlanError: The goal is outside the region or on land.
        ConfigError: An output exists and may not be replaced, or an option is wrong.
    """
    check_outputs(job)
    with threadpool_limits(limits=config.output.threads), resuming(job.checkpoint):
        return _replay(job, config, planner_of, progress, on_digest, forecasts)


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """What a replay has read before its first message.

    Attributes:
        job: Inputs and outputs.
        readers: The opened logs.
        forecasts: The forecast that the estimator is built from.
        prior_flow: The estimate before any observation.
        truth: What the estimate is scored against; None without.
        metadata: Records of the result: inputs, options, versions, region.
    """

    job: ReplayJob
    readers: Sequence[LogReader]
    forecasts: Forecasts
    prior_flow: FlowEstimate
    truth: Ensemble | None
    metadata: Mapping[str, Mapping[str, str]]


def _replay(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None,
    progress: Progress,
    on_digest: Callable[[Digest], None] | None,
    forecasts: Forecasts | None,
) -> tuple[ReplaySummary, FlowEstimate]:
    read = input_stamps(job)
    session, inputs = _prepare(job, config, planner_of, progress, forecasts)
    checkpoints = None
    if job.checkpoint is not None:
        identity = run_identity(inputs.metadata, run_settings_toml(session.config))
        prior, interval = session.estimator.common_part, config.output.checkpoint_interval
        checkpoints = CheckpointFile(job.checkpoint, identity, interval, prior, inputs.forecasts.region)
    try:
        checkpoint = _open_result(session, inputs, checkpoints, on_digest)
        _loop(session, inputs, checkpoints, checkpoint, reading(inputs.readers, progress, "replaying"))
        check_unchanged(read)
        progress(0, 1, "writing the results")
        summary, flow = _conclude(session, inputs)
    except BaseException as error:
        # an unusable input has no result worth keeping; anything else, as an interrupt, leaves OUT.part with every whole chunk
        unusable = isinstance(error, ConfigError | MeasurementError | LogError | PlanError)
        if session.writer is not None:
            (session.writer.discard if unusable else session.writer.abandon)()
        if isinstance(error, ReplayKitError) and unusable:
            error.findings = error.findings or session.monitoring.checks.findings
            error.answer = failure_json(error, session.statistics.summary([reader.report() for reader in inputs.readers]))
        raise
    finally:
        if checkpoints is not None:
            checkpoints.close()
    if checkpoints is not None:
        checkpoints.remove()
    return summary, flow


def _prepare(
    job: ReplayJob, config: RunConfig, planner_of: PlannerFactory | None, progress: Progress, forecasts: Forecasts | None
) -> tuple[Session, _Inputs]:
    """Return a replay before its first message, and what was read for it."""
    progress(0, 0, "reading the forecast")
    clock = Stopwatch()
    with clock.stage("forecast"):
        forecasts = forecasts or forecasts_of(job, config)
        ensemble = forecasts.ensemble
        speeds = checked_speeds(ensemble, config)
        truth = open_truth(job, config, forecasts.near_ns, ensemble, forecasts.box)
    readers = open_readers(job.logs, config)
    config = with_planner_kind(job, readers, config, float(ensemble.grid.levels[-1]))
    progress(0, 0, "computing the basis and the prior")
    with clock.stage("basis"):
        estimator = built(forecasts, config, job)
        prior_flow = estimator.flow(estimator.initial())
    problem = None
    if job.goal is not None and planner_of is not None:
        planner = planner_of(config.planner, ensemble.grid)
        check_goal(planner, prior_flow, job, config)
        problem = PlanningProblem(planner, job.goal, config.planner, config.measurements.surface_depth)
    # without a goal nothing reads the bathymetry
    arguments, bathymetry = find_sources(job.ensemble).arguments, None if problem is None else config.planner.bathymetry_path
    metadata = {} if job.out is None else run_metadata(job.logs, arguments, ensemble, run_options(job, prior_flow), bathymetry)
    if metadata and forecasts.region is not None:
        metadata[REGION_RECORD] = forecasts.region.to_record()
    if metadata and (assumed := {Path(log.path).name: "; ".join(log.report().notes) for log in readers if log.report().notes}):
        metadata["replay_kit.reading"] = assumed
    session = Session(estimator, ensemble.grid.levels, config, problem, clock, speeds)
    return session, _Inputs(job, readers, forecasts, prior_flow, truth, metadata)


def _open_result(
    session: Session, inputs: _Inputs, checkpoints: CheckpointFile | None, on_digest: Callable[[Digest], None] | None
) -> Checkpoint | None:
    """Open the result, and return the checkpoint from which the session continues; None when it begins."""
    if (job := inputs.job).out is None:
        return None
    checkpoint = journal = None
    if checkpoints is not None:
        checkpoint = checkpoints.read()
        journal = checkpoints.open_journal(checkpoint)
    session.writer = ResultWriter(job.out, job.overwrite, on_digest, journal)
    if checkpoints is not None and checkpoint is not None:
        session.restore(checkpoint.state)
        checkpoints.restore_result(session.writer, checkpoint, partial(copy_inputs, session.writer, job, session.config.logs))
    return checkpoint


def _loop(
    session: Session, inputs: _Inputs, checkpoints: CheckpointFile | None, checkpoint: Checkpoint | None, on_message: Callable[[], None]
) -> None:
    """Pass the logs' messages, those after the checkpoint, through the session."""
    logs, measurements = session.config.logs, session.config.measurements
    merged = merge(inputs.readers, logs.reorder_window, logs.start_ns, logs.end_ns)
    state, count = (initial_state(logs.system), 0) if checkpoint is None else (checkpoint.measurement, checkpoint.messages)
    messages = iter(merged)
    with session.clock.stage("read"):
        deque(islice(messages, count), 0)
    while True:
        with session.clock.stage("read"):
            block = list(islice(messages, _BLOCK))
        if not block:
            check_span(inputs.job.logs, session.config, session.last_ns if count else None)
            break
        if not count:
            _begin_result(session, inputs, block[0].time_ns)
        with session.clock.stage("measure"):
            steps = interpret_block(state, block, measurements)
        pings = session.summarised(event for _, events in steps for event in events)
        for message, (state, events) in zip(block, steps, strict=True):
            count += 1
            session.last_ns = message.time_ns
            session.take(events, pings)
            if checkpoints is not None:
                checkpoints.write_when_due(session, state, count)
            on_message()
    session.take(finish(state, measurements))
    session.assimilate_buffer(last=True)
    session.statistics = session.statistics.with_order(merged)


def _begin_result(session: Session, inputs: _Inputs, time_ns: int) -> None:
    """Write what precedes the messages of a result: metadata, notes on the forecast, and the inputs' messages if asked for."""
    if (writer := session.writer) is None:
        return
    with session.clock.stage("write"):
        writer.start(inputs.prior_flow.grid.projection, time_ns, inputs.metadata, run_settings_toml(session.config))
        for note in inputs.forecasts.notes:
            writer.log(time_ns, "warning", note)
        if session.problem is not None and (seabed := session.problem.planner.seabed) is not None:
            writer.seabed(time_ns, seabed)
        copy_inputs(writer, inputs.job, session.config.logs)


def _conclude(session: Session, inputs: _Inputs) -> tuple[ReplaySummary, FlowEstimate]:
    """Publish the result, then compare it with the truth: a truth that does not fit must not cost the result."""
    job, reports = inputs.job, [reader.report() for reader in inputs.readers]
    if not session.monitoring.explains_no_profile:
        session.statistics.require_usable(reports, inputs.forecasts.ensemble.grid)
    flow = session.conclude()
    notes = _notes(session, inputs, flow, session.statistics.notes(reports))
    planning, (found, blind) = session.planning, conclusions(session.monitoring, session.statistics, session.config)
    outside = tuple(note for note in inputs.forecasts.notes if "outside" in note or "is no forecast" in note)
    summary = replace(
        session.statistics.summary(reports),
        plan=None if planning.result is None else planning.result.plan,
        plan_note=planning.failure,
        outcomes=planning.outcomes,
        notes=tuple(notes),
        findings=found,
        doubts=blind + outside,
    )
    with session.clock.stage("write"):
        if session.writer is not None:
            session.writer.summary(session.last_ns, to_record(summary, (*job.logs, *ensemble_files(job.ensemble))))
            if spread := session.estimator.spread_record(session.estimation.current):
                session.writer.write_metadata("replay_kit.spread", spread)
            for number, left in enumerate(session.estimator.left_flows(session.estimation.current), 1):
                session.writer.window(number, left)
            session.writer.finish(flow)
        if job.netcdf is not None:
            write_grid(flow, job.netcdf)
        if job.save_estimate is not None:
            flow.save(job.save_estimate)
    score = None
    if inputs.truth is not None:
        with session.clock.stage("score"):
            score, failures = _score(session, inputs, inputs.truth, flow)
            notes += failures
    return replace(summary, seconds=dict(session.clock.seconds), truth=score, notes=tuple(notes)), flow


def _notes(session: Session, inputs: _Inputs, flow: FlowEstimate, of_logs: Sequence[str]) -> list[str]:
    """Return what the user should know of the forecast, the logs, the basis, the prior and the instrument, as sentences."""
    kernel, estimator = flow.horizontal.kernel, session.estimator
    lengths = f"{kernel.length_east / 1e3:.1f} x {kernel.length_north / 1e3:.1f} km"
    basis = f"{flow.n_modes} modes a level, kernel lengths {lengths}, mu {kernel.speed:.3f} m/s"
    no_goal = [] if inputs.job.goal is not None else ["no goal was given (--goal LON,LAT,DEPTH), so nothing was planned"]
    biases = estimator.bias_notes(session.estimation.current)
    return [*inputs.forecasts.notes, *of_logs, basis, *estimator.notes(), *biases, *no_goal]


def _score(session: Session, inputs: _Inputs, truth: Ensemble, flow: FlowEstimate) -> tuple[TruthScore | None, list[str]]:
    """Return the score, or as much of it as there is, and why the rest is missing."""
    job, forecasts, prior_flow, config = inputs.job, inputs.forecasts, inputs.prior_flow, session.config
    if forecasts.evolves:
        # the estimate is of the log's end, and so is what it is compared with
        truth = open_truth(job, config, flow.time_ns, forecasts.ensemble, forecasts.box) or truth
        prior_flow = prior_flow.at(session.last_ns)
    if forecasts.read is not None:
        # windows followed the vehicle: the last one is scored
        region = around(np.column_stack([flow.grid.longitude.ravel(), flow.grid.latitude.ravel()]), 0.0)
        truth = open_truth(job, config, forecasts.near_ns, forecasts.ensemble, region) or truth
        forecasts = replace(forecasts, series=(forecasts.read(region),))
    positions, ensemble = session.statistics.profiles.positions, forecasts.nearest(flow.time_ns)
    try:
        score, truth_flow = score_against_truth(flow, ensemble, truth, positions, job.truth_radius_km, config.estimator)
    except MeasurementError as error:
        return None, [f"no score: {error}"]
    problem, result = session.problem, session.planning.result
    if problem is None or result is None or result.plan.status == "failed":
        return score, []
    plan = result.plan
    mean_plan = problem.planner.plan(prior_flow, plan.start, plan.goal, plan.start_time_ns, None)
    try:
        closest = [problem.planner.closest_approach(truth_flow, planned) for planned in (result, mean_plan)]
    except PlanError as error:
        return score, [f"the plans cannot be flown in the truth: {error}"]
    return replace(score, closest_approach_m=closest[0], ensemble_mean_closest_approach_m=closest[1]), []
