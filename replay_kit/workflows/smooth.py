"""Logs to a smoothed result: at each published time the estimate from the measurements before and after it.

The file is that of a replay (``replay_kit/results/CHANNELS.md``) with other contents in two places: grids and unknowns are those of the
smoothed estimate at the published times; the residual of a measurement is that to the one before, carried forward to the measurement, and
the replay's stands beside it. Innovations, NIS and the gate's decisions stay those of
the replay, which did not know later measurements.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, TypeGuard

import numpy as np
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.as_flown import AS_FLOWN, AsFlown, FlownDive
from replay_kit.core.errors import ConfigError
from replay_kit.core.message import Message
from replay_kit.core.observation import Innovation, Measurement, PathMean, VehicleState
from replay_kit.core.progress import Progress, Stopwatch, silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import smooth as smoothed
from replay_kit.forecast import find_sources
from replay_kit.logs import merge
from replay_kit.logs.reader import reading
from replay_kit.measurements.checks.place import LogTracks
from replay_kit.measurements.observed import begun, blocks, rows
from replay_kit.measurements.region import for_region
from replay_kit.results.mcap_writer import ResultWriter
from replay_kit.results.outcome.run import ReplaySummary
from replay_kit.workflows.replay.inputs.estimator import build, flow_at
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, check_outputs, forecasts_of
from replay_kit.workflows.replay.inputs.provenance import run_metadata, run_settings_toml
from replay_kit.workflows.replay.inputs.scan import open_readers
from replay_kit.workflows.replay.stages.consistency import MonitoringState, require_one_vehicle
from replay_kit.workflows.replay.stages.estimation import EstimationState, assimilate, inputs_of
from replay_kit.workflows.replay.stages.publishing import depth_slices
from replay_kit.workflows.replay.statistics import RunStatistics
from replay_kit.workflows.replay.surfacings.flight_bias import FlightState, as_used
from replay_kit.workflows.replay.surfacings.forecasts import flown_of

_NS = 1_000_000_000
# Innovations written together.
_BLOCK = 16
#: Said in a result whose estimate is static.
STATIC = "the estimate does not change with time: smoothed, it is the last estimate at all times"


@dataclass(frozen=True, slots=True, eq=False)
class _Read:
    """What the logs hold.

    Attributes:
        events: Positions and measurements, in order.
        statistics: Of what is read, and later of what is used.
        flight: What is known of the flight model at the end.
        as_flown: How the vehicle flew; None where no mean current shows it.
    """

    events: Sequence[VehicleState | Measurement]
    statistics: RunStatistics
    flight: FlightState
    as_flown: AsFlown | None


@dataclass(frozen=True, slots=True, eq=False)
class _Forward(_Read):
    """The replay of the logs.

    Attributes:
        innovations: Of the events; None of positions.
        state: The estimator's last state.
    """

    innovations: Sequence[Innovation | None]
    state: Any


def smooth(
    job: ReplayJob,
    config: RunConfig,
    progress: Progress = silent,
    forecasts: Forecasts | None = None,
) -> ReplaySummary:
    """Write the smoothed result of logs, and return the summary of the replay that it begins with.

    An estimator that is static counts all measurements the same at all times: smoothed, it is its last estimate.

    Args:
        job: Logs, ensemble and result; its goal and its other outputs do not count.
        config: The run's settings; grids are published every ``output.interval``.
        progress: Called with how much is done of each stage.
        forecasts: What ``forecasts_of`` reads for this job; None reads it.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: The ensemble cannot be used.
        MeasurementError: The logs hold no usable ping of this region.
        ConfigError: Windows follow the vehicle, or the result exists and may not be replaced, or an option is wrong.
    """
    check_outputs(job)
    with threadpool_limits(limits=config.output.threads):
        clock = Stopwatch()
        progress(0, 0, "reading the forecast")
        with clock.stage("forecast"):
            forecasts = forecasts or forecasts_of(job, config)
            check_smoothable(forecasts)
            estimator = build(forecasts, config)
        with clock.stage("estimate"):
            readers = open_readers(job.logs, config)
            read = _events(readers, estimator, for_region(config, forecasts.ensemble), progress)
            if config.consistency.on_failure != "ignore":
                positions = (event for event in read.events if isinstance(event, VehicleState))
                require_one_vehicle(
                    MonitoringState(tracks=reduce(LogTracks.after, positions, LogTracks())),
                    [log.path for log in readers],
                )
            forward = _replayed(estimator, read)
            reports = [reader.report() for reader in readers]
            forward.statistics.require_usable(reports, forecasts.ensemble.grid)
        progress(0, 0, "smoothing")
        with clock.stage("smooth"):
            _write(job, config, forecasts, estimator, forward)
    notes = (
        *forecasts.notes,
        *forward.statistics.notes(reports),
        *estimator.notes(),
        *_notes(estimator),
    )
    correction = forward.flight.correction(forward.statistics.profiles.corrections)
    return replace(
        forward.statistics.summary(reports),
        seconds=dict(clock.seconds),
        notes=notes,
        flight_correction=correction,
    )


def check_smoothable(forecasts: Forecasts) -> None:
    """Raise ConfigError when windows follow the vehicle, of which none holds all of the log."""
    if forecasts.read is not None:
        raise ConfigError(
            "smooth: windows that follow the vehicle are not smoothed; state one region with --region, or allow more points "
            "with forecast.window_points"
        )


def published_times(first_ns: int, last_ns: int, interval: float) -> list[int]:
    """Return the times at which a smoothed estimate is published [ns, UTC]: every interval from the first on, and the last."""
    return [*range(first_ns, last_ns, round(interval * _NS)), last_ns]


def changes(estimator: Estimator[Any]) -> TypeGuard[ReducedBasisEstimator]:
    """Return whether an estimator is one through time, which can be smoothed."""
    return isinstance(estimator, ReducedBasisEstimator) and bool(
        np.isfinite(estimator.observer.tau).any()
    )


def _notes(estimator: Estimator[Any]) -> list[str]:
    return [] if changes(estimator) else [STATIC]


def _events(
    readers: Any, estimator: Estimator[Any], config: RunConfig, progress: Progress
) -> _Read:
    """Return what the logs hold, with the statistics of all but positions and measurements."""
    kinds = inputs_of(estimator)
    settings, advance = config.logs, reading(readers, progress, "reading the logs")
    merged = merge(readers, settings.reorder_window, settings.start_ns, settings.end_ns)
    kept: list[VehicleState | Measurement] = []
    statistics, flight, dives = RunStatistics(), FlightState(), list[FlownDive]()
    stream = begun(settings.system, settings.component)
    for block in blocks(_each(merged, advance), config.measurements, stream=stream):
        statistics = statistics.after_messages(block.counts())
        for stated in rows(block):
            if isinstance(stated, PathMean) and (dive := flown_of(stated)) is not None:
                dives.append(dive)
            flight, event = as_used(flight, stated, config.measurements)
            if isinstance(event, kinds) and (
                config.measurements.flight_bias
                or not (isinstance(event, PathMean) and event.beside_profiles)
            ):
                kept.append(event)
            elif isinstance(event, Measurement) and not isinstance(event, kinds):
                statistics = statistics.with_unsupported(event)
    return _Read(kept, statistics.with_order(merged), flight, AsFlown.of(dives))


def _each(messages: Iterable[Message], advance: Callable[[], None]) -> Iterator[Message]:
    """Yield messages, and say so."""
    for message in messages:
        advance()
        yield message


def _replayed(estimator: Estimator[Any], read: _Read) -> _Forward:
    """Return the replay of events, in blocks: the states of all steps at once would take too much memory."""
    prior, events, statistics = estimator.initial(), read.events, read.statistics
    state, innovations = EstimationState(prior, prior), []
    for begin in range(0, len(events), estimator.block_size):
        state, steps = assimilate(estimator, state, events[begin : begin + estimator.block_size])
        statistics = statistics.after_steps(steps)
        innovations += [
            None if step.assimilation is None else step.assimilation.innovation for step in steps
        ]
    return _Forward(events, statistics, read.flight, read.as_flown, innovations, state.current)


def _write(
    job: ReplayJob,
    config: RunConfig,
    forecasts: Forecasts,
    estimator: Estimator[Any],
    forward: _Forward,
) -> None:
    """Write the result."""
    measured = [event for event in forward.events if isinstance(event, Measurement)]
    times = [event.time_ns for event in forward.events]
    published = published_times(
        min(event.time_ns for event in measured), max(times), config.output.interval
    )
    states = [forward.state] * len(published)
    if changes(estimator):
        states = smoothed(estimator, measured, published)
    prior = estimator.flow(estimator.initial())
    assert job.out is not None
    options, arguments = (
        {"smoothed": "true", "modes": str(prior.n_modes)},
        find_sources(job.ensemble).arguments,
    )
    metadata = run_metadata(
        job.logs, arguments, forecasts.ensemble, options, found=forecasts.region
    )
    writer = ResultWriter(job.out, job.overwrite)
    try:
        writer.start(prior.grid.projection, min(times), metadata, run_settings_toml(config))
        for note in _notes(estimator):
            writer.log(min(times), "info", note)
        due, block = 0, list[Innovation]()
        for event, innovation in zip(forward.events, forward.innovations, strict=True):
            while due < len(published) and published[due] <= event.time_ns:
                flow = flow_at(estimator, states[due], published[due])
                depth_slices(published[due], flow, config.output)(writer)
                due += 1
            if innovation is None:
                writer.fix(event)  # type: ignore[arg-type]  # a measurement has an innovation
            else:
                state = estimator.predict(states[max(due - 1, 0)], event.time_ns)
                block.append(_smoothed(estimator, state, event, innovation))
                if len(block) == _BLOCK:
                    writer.innovations(block)
                    block = []
        if block:
            writer.innovations(block)
        if forward.as_flown is not None:
            writer.write_metadata(AS_FLOWN, forward.as_flown.to_record())
        flow = flow_at(estimator, states[-1], published[-1])
        writer.finish(replace(flow, span_ns=(min(times), max(times))))
    except BaseException:
        writer.abandon()
        raise


def _smoothed(
    estimator: Estimator[Any], state: Any, measurement: Any, innovation: Innovation
) -> Innovation:
    """Return an innovation whose residual is that to a smoothed estimate, for the bins that have one; it keeps that of the replay."""
    replayed = innovation.residual
    residual = np.where(np.isfinite(replayed), estimator.innovation(state, measurement), np.nan)
    return replace(innovation, residual=residual, replayed_residual=replayed, estimated_std=np.nan)
