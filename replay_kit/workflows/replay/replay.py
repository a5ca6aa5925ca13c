"""One log end to end: messages in, observations, estimates and plans out.

The messages' own times drive the loop; nothing depends on the wall clock, and the same inputs and options give the same bytes. Wall times
go to the summary only.
"""

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.atomic import part_of
from replay_kit.core.errors import (
    ConfigError,
    LogError,
    MeasurementError,
    PlanError,
    ReplayKitError,
)
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.inputs import check_unchanged
from replay_kit.core.message import LogReader, Message
from replay_kit.core.progress import Progress, Stopwatch, silent
from replay_kit.core.region import Region, centre, inside
from replay_kit.forecast import find_sources
from replay_kit.logs import merge
from replay_kit.logs.merge import Merge
from replay_kit.logs.reader import reading
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.observed import Stream, begun, taken
from replay_kit.measurements.region import for_region
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.outcome.from_run import failed
from replay_kit.results.outcome.run import ReplaySummary
from replay_kit.results.topics import Digest
from replay_kit.results.vehicles import VEHICLES_RECORD
from replay_kit.workflows.replay.array import END, ArraySession, streams
from replay_kit.workflows.replay.checkpoint import Checkpoint, States, run_identity
from replay_kit.workflows.replay.checks import check_goal, with_planner_kind
from replay_kit.workflows.replay.conclude import conclude, counted, findings_so_far
from replay_kit.workflows.replay.inputs.estimator import built
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import (
    Prepared,
    ReplayJob,
    check_outputs,
    copy_inputs,
    flat,
    forecasts_of,
    input_stamps,
    open_each,
    open_truth,
)
from replay_kit.workflows.replay.inputs.provenance import (
    FOLLOWED,
    forecast_times,
    lasting,
    named_hash,
    run_metadata,
    run_options,
    run_settings_toml,
    vehicles_record,
)
from replay_kit.workflows.replay.inputs.scan import check_span, next_block
from replay_kit.workflows.replay.inputs.vehicles import by_tracks, first_windows, identified
from replay_kit.workflows.replay.scoring import check_against, rival_inputs, rivals
from replay_kit.workflows.replay.session import Given, Session
from replay_kit.workflows.replay.shared import SharedEstimate
from replay_kit.workflows.replay.stages.consistency import checked_speeds
from replay_kit.workflows.replay.stages.planner import PlannerFactory
from replay_kit.workflows.replay.stages.plans import PlanningProblem
from replay_kit.workflows.replay.state_file import StateError

# Of one vehicle, or of several.
AnySession = Session | ArraySession
# Objects made before those are looked for that hold each other: a replay makes none, and to look takes a tenth of its loop.
_COLLECTED = 50_000


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
    check_against(job)
    check_outputs(job)
    threads = threadpool_limits(limits=config.output.threads)
    with threads, _collecting_seldom():
        job = identified(job, config)
        try:
            return _replay(job, config, planner_of, progress, on_digest, forecasts)
        except MeasurementError as error:
            vehicles = by_tracks(job, config, error)
            if not vehicles:
                raise
        # taken for one vehicle's, the logs are of several
        job = identified(replace(job, vehicles=vehicles), config)
        return _replay(job, config, planner_of, progress, on_digest, None)


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
    on_digest: Callable[[Digest], None] | None,
    forecasts: Forecasts | None,
) -> tuple[ReplaySummary, FlowEstimate]:
    read = input_stamps(job)
    # before the run itself: a forecast that cannot be used should cost no result
    others = tuple(rivals(job, lambda each: _replay(each, config, None, progress, None, None)[0]))
    session, inputs = _prepare(job, config, planner_of, progress, forecasts)
    states = _states(session, inputs)
    try:
        stream = _stream(inputs, session.config, states)
        _open_result(session, inputs, states, stream.checkpoint, on_digest)
        _loop(session, inputs, states, stream, reading(inputs.readers, progress, "replaying"))
        check_unchanged(read, may_grow=job.following is not None)
        progress(0, 1, "writing the results")
        summary, flow = conclude(session, inputs, others)
    except StateError as error:
        if session.writer is not None:
            session.writer.abandon()
        assert states is not None, "a run without a state reads none"
        job.tell(f"{error}; the replay begins anew")
        states.path.unlink()
        return _replay(job, config, planner_of, progress, on_digest, inputs.forecasts)
    except BaseException as error:
        # an unusable input has no result worth keeping; anything else, as an interrupt, leaves OUT.part with every whole chunk
        unusable = isinstance(error, ConfigError | MeasurementError | LogError | PlanError)
        if session.writer is not None:
            (session.writer.discard if unusable else session.writer.abandon)()
        if isinstance(error, ReplayKitError) and unusable:
            error.findings = error.findings or findings_so_far(session)
            error.answer = failed(error, counted(session, inputs)).to_json()
        raise
    if states is not None:
        states.end()
    return summary, flow


def _prepare(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None,
    progress: Progress,
    forecasts: Forecasts | None,
) -> tuple[AnySession, Prepared]:
    """Return a replay before its first message, and what was read for it."""
    progress(0, 0, "reading the forecast")
    clock = Stopwatch()
    with clock.stage("forecast"):
        forecasts = forecasts or forecasts_of(job, config)
        ensemble = forecasts.ensemble
        speeds = checked_speeds(ensemble, config)
        truth = open_truth(job, config, forecasts.near_ns, ensemble, forecasts.box)
    firsts = first_windows(job, forecasts)
    readers = open_each(job, config)
    progress(0, 0, "computing the basis and the prior")
    with clock.stage("basis"):
        estimator = built(forecasts, with_planner_kind(job, flat(readers), config), job)
        prior_flow = estimator.flow(estimator.initial())
    shared, sessions = SharedEstimate(clock), list[Session]()
    speeds_of = _speeds_of(firsts, forecasts, config, speeds)
    for number, (vehicle, of_vehicle) in enumerate(zip(job.each_vehicle, readers, strict=True)):
        own = with_planner_kind(vehicle, of_vehicle, config)
        problem = None
        if vehicle.goal is not None and planner_of is not None:
            planner = planner_of(own.planner, ensemble.grid)
            check_goal(planner, prior_flow, vehicle, own)
            goals = () if job.following is None else job.following.goals
            surface = own.measurements.surface_depth
            problem = PlanningProblem(planner, vehicle.goal, own.planner, surface, goals)
        levels, follows = ensemble.grid.levels, estimator
        if vehicle.name in speeds_of:
            follows, speeds = (
                estimator.of_vehicle(number, firsts[vehicle.name]),
                speeds_of[vehicle.name],
            )
        sessions.append(Session(follows, levels, own, problem, speeds, shared, vehicle.name))
    # without a goal nothing reads the bathymetry
    bathymetry = config.planner.bathymetry_path if any(one.problem for one in sessions) else None
    metadata = _metadata(job, forecasts, readers, prior_flow, bathymetry)
    session = ArraySession(sessions) if job.vehicles else sessions[0]
    return session, Prepared(job, readers, forecasts, prior_flow, truth, metadata)


def _speeds_of(
    firsts: Mapping[str, Region],
    forecasts: Forecasts,
    config: RunConfig,
    speeds: EnsembleSpeeds | None,
) -> dict[str, EnsembleSpeeds | None]:
    """Return the speeds that the checks expect where each vehicle begins, by its name; those of one window serve all that begin in it.

    Args:
        firsts: The windows in which vehicles begin, by their names.
        forecasts: With the first window of the run.
        config: The run's settings.
        speeds: Of that window.
    """
    found = dict[str, EnsembleSpeeds | None]()
    if forecasts.read is None:
        return found
    known = {} if forecasts.box is None else {forecasts.box: speeds}
    for name, first in firsts.items():
        region = next((each for each in known if inside(each, *centre(first))), first)
        if region not in known:
            known[region] = checked_speeds(forecasts.read(region), config)
        found[name] = known[region]
    return found


def _metadata(
    job: ReplayJob,
    forecasts: Forecasts,
    readers: Sequence[Sequence[LogReader]],
    prior_flow: FlowEstimate,
    bathymetry: Path | None,
) -> dict[str, Mapping[str, str]]:
    """Return the records that a result has of its run, by their names; none where no result is written."""
    if job.out is None:
        return {}
    metadata = run_metadata(
        job.logs,
        find_sources(job.ensemble).arguments,
        forecasts.ensemble,
        run_options(job, prior_flow),
        bathymetry,
        forecasts.region,
    )
    if job.vehicles:
        metadata[VEHICLES_RECORD] = vehicles_record(job)
    if assumed := {
        Path(log.path).name: "; ".join(log.report().notes)
        for log in flat(readers)
        if log.report().notes
    }:
        metadata["replay_kit.reading"] = assumed
    if times := forecast_times(forecasts):
        metadata["replay_kit.forecast"] = times
    if job.following is not None:
        metadata[FOLLOWED] = job.following.record
    if job.against:
        named = {key: named_hash(path) for key, path in rival_inputs(job.against).items()}
        metadata["replay_kit.inputs"] = {**metadata["replay_kit.inputs"], **named}
    return metadata


def _states(session: AnySession, inputs: Prepared) -> States | None:
    """Return where the state of a replay is kept; None where it is not."""
    job, config = inputs.job, session.config
    settings, interval = run_settings_toml(config), config.output.checkpoint_interval
    if job.following is not None:
        run = run_identity(lasting(inputs.metadata), settings)
        return States(job.following.states / "state", run, interval, config.logs.reorder_window)
    if job.checkpoint is None:
        return None
    return States(job.checkpoint, run_identity(inputs.metadata, settings), interval, None)


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """The messages of a replay.

    Attributes:
        merged: All of them, vehicle by vehicle.
        messages: Those after the checkpoint, of all vehicles.
        checkpoint: Where the replay goes on; None when it begins.
    """

    merged: Sequence[Merge[Message]]
    messages: Iterator[Message]
    checkpoint: Checkpoint | None = None


def _stream(inputs: Prepared, config: RunConfig, states: States | None) -> _Stream:
    logs = config.logs
    merged = [
        merge(readers, logs.reorder_window, logs.start_ns, logs.end_ns)
        for readers in inputs.by_vehicle
    ]
    firsts = [readers[0].input for readers in inputs.by_vehicle]

    def begin() -> Iterator[Message]:
        each = [iter(one) for one in merged]
        return streams(each, firsts) if inputs.job.vehicles else each[0]

    if states is None:
        return _Stream(merged, begin())
    checkpoint, messages = states.resume(begin)
    return _Stream(merged, messages, checkpoint)


def _open_result(
    session: AnySession,
    inputs: Prepared,
    states: States | None,
    checkpoint: Checkpoint | None,
    on_digest: Callable[[Digest], None] | None,
) -> None:
    """Open the result, and let the session go on from the checkpoint if there is one."""
    if (job := inputs.job).out is None:
        return
    goes_on = checkpoint is not None and job.following is None and part_of(job.out).exists()
    writer = session.writer = ResultWriter(job.out, job.overwrite, on_digest, goes_on)
    if states is not None and checkpoint is not None:
        states.restore(session, writer, checkpoint, partial(_begin_result, session, inputs))


def _loop(
    session: AnySession,
    inputs: Prepared,
    keeper: States | None,
    stream: _Stream,
    on_message: Callable[[], None],
) -> None:
    """Pass the logs' messages, those after the checkpoint, through the sessions of their vehicles."""
    checkpoint, sessions = stream.checkpoint, session.vehicles
    logs, count = session.config.logs, 0
    states = [begun(logs.system, logs.component) for _ in sessions]
    if checkpoint is not None:
        states, count = list(checkpoint.measurement), checkpoint.messages
    measurements = for_region(session.config, inputs.forecasts.ensemble).measurements
    while True:
        with session.clock.stage("read"):
            block = next_block(stream.messages, session.config.output.checkpoint_interval)
        if not block:
            check_span(inputs.job.logs, session.config, session.last_ns if count else None)
            break
        if not count:
            _begin_result(session, inputs, block[0].time_ns)
        for number, message, events in _taken(states, block, inputs, session, measurements):
            count += 1
            session.last_ns = message.time_ns
            sessions[number].take_message(message.time_ns, events)
            if message.schema == END:
                session.shared.end(number)
            on_message()
        if session.writer is not None:
            session.writer.digest(session.last_ns)
        if keeper is not None:
            keeper.keep(session, states, count, block)
    if not inputs.job.vehicles:
        _, rest = taken(states[0], [], measurements, last=True)
        for events in sessions[0].take_block(rest).values():
            sessions[0].take_message(session.last_ns, events)
    session.shared.assimilate(last=True)
    for one, merged, readers in zip(sessions, stream.merged, inputs.by_vehicle, strict=True):
        one.statistics = one.statistics.with_order(merged, readers[0].input)


def _taken(
    states: list[Stream],
    block: Sequence[Message],
    inputs: Prepared,
    session: AnySession,
    config: MeasurementConfig,
) -> list[tuple[int, Message, list[Given]]]:
    """Return the messages of a block, each with the number of its vehicle and its events; the vehicles' states become those after it."""
    own: dict[int, list[Message]] = {}
    numbers = [inputs.owners[one.input] if inputs.job.vehicles else 0 for one in block]
    for number, message in zip(numbers, block, strict=True):
        own.setdefault(number, []).append(message)
    given: dict[int, list[list[Given]]] = {}
    for number, messages in own.items():
        read = [one for one in messages if one.schema != END]
        first = states[number].order
        with session.clock.stage("measure"):
            states[number], found = taken(states[number], read, config, len(read) < len(messages))
        by_message = session.vehicles[number].take_block(found)
        given[number] = [by_message.pop(first + k, []) for k in range(len(read))]
        # what waited for the end of the logs
        given[number] += [[one for rest in by_message.values() for one in rest]] * (
            len(messages) - len(read)
        )
    each = {number: iter(events) for number, events in given.items()}
    return [
        (number, message, next(each[number]))
        for number, message in zip(numbers, block, strict=True)
    ]


def _begin_result(session: AnySession, inputs: Prepared, time_ns: int) -> None:
    """Write what precedes the messages of a result: metadata, notes on the forecast, and the inputs' messages if asked for."""
    if (writer := session.writer) is None:
        return
    with session.clock.stage("write"):
        writer.start(
            inputs.prior_flow.grid.projection,
            time_ns,
            inputs.metadata,
            run_settings_toml(session.config),
        )
        for note in inputs.forecasts.notes:
            writer.log(time_ns, "warning", note)
        for one in session.vehicles:
            if one.problem is not None and (seabed := one.problem.planner.seabed) is not None:
                writer.seabed(time_ns, seabed)
                break
        copy_inputs(writer, inputs.job, session.config.logs)
        writer.digest(time_ns)
