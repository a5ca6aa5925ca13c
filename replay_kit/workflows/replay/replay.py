"""Replay of logs from end to end: messages in, observations, estimates and plans out.

Message times drive the loop, not the wall clock: the same inputs and options give the same bytes. Wall times enter the returned outcome
only.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import (
    ConfigError,
    ForecastError,
    LogError,
    MeasurementError,
    PlanError,
    ReplayKitError,
)
from replay_kit.core.files.atomic import part_of
from replay_kit.core.files.inputs import check_unchanged, stamps_of
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation.evidence import Evidence
from replay_kit.core.words.progress import Progress, silent
from replay_kit.logs.reader import reading
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, failed_outcome
from replay_kit.workflows.replay.checkpoint import StateError, States, run_identity
from replay_kit.workflows.replay.conclude import conclude, so_far
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, check_outputs, copy_inputs, name_of
from replay_kit.workflows.replay.inputs.planner import PlannerFactory
from replay_kit.workflows.replay.inputs.prepare import Prepared, prepare
from replay_kit.workflows.replay.inputs.provenance import lasting_records, run_settings_toml
from replay_kit.workflows.replay.inputs.vehicles import with_vehicles
from replay_kit.workflows.replay.run import Run, follow_up

# Objects made before those are looked for that hold each other: a replay makes none, and to look takes a tenth of its loop.
_COLLECTED = 50_000


def replay(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None = None,
    progress: Progress = silent,
    forecasts: Forecasts | None = None,
) -> tuple[Outcome, FlowEstimate]:
    """Replay logs through the estimator and return the outcome and the final estimate.

    Args:
        job: Inputs and outputs.
        config: The run's settings.
        planner_of: Factory of the planner for a job with a goal.
        progress: Called with the progress of each stage.
        forecasts: Result of ``forecasts_of`` for this job; None reads it.

    Raises:
        LogError: A log cannot be opened, or an input changed while it was read.
        ForecastError: The ensemble or truth cannot be used.
        MeasurementError: The logs have no usable ping in this region.
        PlanError: The goal is outside the region or on land.
        ConfigError: An output exists and may not be replaced, or an option is wrong.
    """
    if job.against and job.following is not None:
        raise ConfigError(
            "--against: expected a finished log, got one that is followed; compare forecasts when it has ended"
        )
    check_outputs(job)
    threads = threadpool_limits(limits=config.output.threads)
    with threads, _collecting_seldom():
        return _replay(with_vehicles(job, config), config, planner_of, progress, forecasts)[:2]


@contextmanager
def _collecting_seldom() -> Iterator[None]:
    before = gc.get_threshold()
    gc.set_threshold(max(_COLLECTED, before[0]) if before[0] else 0, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _replay(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None,
    progress: Progress,
    forecasts: Forecasts | None,
) -> tuple[Outcome, FlowEstimate, Run]:
    read = stamps_of([*job.log_files, *job.forecasts])
    # before the run itself: a forecast that cannot be used should cost no result
    others = tuple(_rivals(job, config, progress))
    run, inputs = prepare(job, config, planner_of, progress, forecasts)
    run.follow_up = follow_up
    states = _states(run, inputs)
    try:
        _loop(run, inputs, states, reading(inputs.logs.all, progress, "replaying"))
        check_unchanged(read, may_grow=job.following is not None)
        progress(0, 1, "writing the results")
        outcome, flow = conclude(run, inputs, others)
    except StateError as error:
        if run.writer is not None:
            run.writer.abandon()
        assert states is not None, "a run without a state reads none"
        job.tell(f"{error}; the replay restarts")
        states.forget()
        inputs.logs.close()
        return _replay(job, config, planner_of, progress, inputs.forecasts)
    except BaseException as error:
        # an unusable input has no result worth keeping; anything else, as an interrupt, leaves OUT.part with every whole chunk
        unusable = isinstance(error, ConfigError | MeasurementError | LogError | PlanError)
        if run.writer is not None:
            (run.writer.discard if unusable else run.writer.abandon)()
        if isinstance(error, ReplayKitError) and unusable:
            found = (one for vehicle in run.vehicles for one in vehicle.monitoring.findings)
            error.findings = error.findings or tuple(found)
            error.answer = failed_outcome(error, so_far(run, inputs)).to_json()
        raise
    if states is not None:
        states.end()
    return outcome, flow, run


def _rivals(
    job: ReplayJob, config: RunConfig, progress: Progress
) -> Iterator[tuple[str, Evidence]]:
    """Yield the name of each competing forecast, and the log evidence under it."""
    for each in job.against:
        alone = ReplayJob(job.logs, each, estimator=job.estimator, tell=job.tell)
        counts = _replay(alone, config, None, progress, None)[2].vehicles[0].counts
        if (evidence := counts.log_evidence) is None:
            raise ForecastError(
                f"{name_of(each)}: this estimator states no density of the measurements, so there is no evidence to compare"
            )
        yield name_of(each), evidence


def _states(run: Run, inputs: Prepared) -> States | None:
    """Return the state file of a replay; None without one."""
    job, config, window = inputs.job, run.config, None
    path, records = job.checkpoint, inputs.metadata
    if job.following is not None:
        path, records = job.following.states / "state", lasting_records(records)
        window = config.logs.reorder_window
    if path is None:
        return None
    identity = run_identity(records, run_settings_toml(config))
    return States(path, identity, config.output.checkpoint_interval, window)


def _loop(
    run: Run, inputs: Prepared, states: States | None, on_messages: Callable[[int], None]
) -> None:
    """Pass the logs' messages, or those after a state, through the run."""
    job, begin = inputs.job, partial(_begin_result, run, inputs)
    checkpoint, messages = (None, None) if states is None else states.resume(inputs.messages)
    if job.out is not None:
        goes_on = checkpoint is not None and job.following is None and part_of(job.out).exists()
        run.writer = ResultWriter(job.out, job.overwrite, goes_on)
    if states is not None and checkpoint is not None:
        states.restore(run, checkpoint, begin)
    for block in inputs.played(run, messages, begin):
        on_messages(len(block))
        if run.writer is not None:
            run.writer.digest(run.last_ns)
        if states is not None:
            states.keep(run, block)


def _begin_result(run: Run, inputs: Prepared, time_ns: int) -> None:
    """Write the head of a result: metadata, notes on the forecast, and the inputs' messages if requested."""
    if (writer := run.writer) is None:
        return
    with run.clock.stage("write"):
        projection, settings = inputs.prior_flow.grid.projection, run_settings_toml(run.config)
        writer.start(projection, time_ns, inputs.metadata, settings)
        for note in inputs.forecasts.notes:
            writer.log(time_ns, "warning", note)
        problems = (vehicle.setup.problem for vehicle in run.vehicles)
        beds = (one.planner.seabed for one in problems if one is not None)
        for seabed in [bed for bed in beds if bed is not None][:1]:
            writer.seabed(time_ns, seabed)
        copy_inputs(writer, inputs.job, run.config.logs)
        writer.digest(time_ns)
