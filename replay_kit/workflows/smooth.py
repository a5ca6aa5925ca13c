"""Smoothed result of logs: at each published time the estimate from observations before and after it.

The file has the format of a replay (``replay_kit/results/CHANNELS.md``) with two differences: grids and unknowns are smoothed at the
published times; an observation's residual is that to the previous smoothed estimate, carried forward to the observation, next to that of
the replay. Innovations, NIS and gate decisions are those of the replay, without later observations.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any, TypeGuard

import numpy as np
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Innovation
from replay_kit.core.words.progress import Progress, Stopwatch, silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import smooth as smoothed
from replay_kit.forecast import find_sources
from replay_kit.logs.reader import reading
from replay_kit.measurements.checks.place import LogTracks
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, made
from replay_kit.results.outcome.parts import correction_part
from replay_kit.workflows.replay.events import Aside, Track
from replay_kit.workflows.replay.inputs.estimator import build, flow_at, with_window
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.job import (
    ReplayJob,
    check_outputs,
    forecasts_of,
    logs_of,
)
from replay_kit.workflows.replay.inputs.provenance import run_metadata, run_settings_toml
from replay_kit.workflows.replay.inputs.scan import Logs
from replay_kit.workflows.replay.prepare import Prepared, prepare
from replay_kit.workflows.replay.run import Run
from replay_kit.workflows.replay.stages.consistency import MonitoringState, require_one_vehicle
from replay_kit.workflows.replay.stages.estimation import Step
from replay_kit.workflows.replay.stages.publishing import depth_slices
from replay_kit.workflows.replay.surfacings.forecasts import flown_of

_NS = 1_000_000_000
# Innovations written together.
_BLOCK = 16
#: Said in a result whose estimate is static.
STATIC = "the estimate is static: smoothed, it is the last estimate at all times"


def smooth(
    job: ReplayJob,
    config: RunConfig,
    progress: Progress = silent,
) -> Outcome:
    """Write the smoothed result of logs, and return the outcome of its forward replay.

    The smoothed estimate of a static estimator is the last one.

    Args:
        job: Logs, ensemble and result alone.
        config: Settings of the run; grids are published every ``output.interval``.
        progress: Called with the progress of each stage.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: The ensemble cannot be used.
        MeasurementError: The logs have no usable ping in this region.
        ConfigError: Windows follow the vehicle, or the result exists and may not be replaced, or an option is wrong.
    """
    check_outputs(job)
    with threadpool_limits(limits=config.output.threads):
        clock = Stopwatch()
        progress(0, 0, "reading the forecast")
        with clock.stage("forecast"):
            logs = logs_of(job, config)
            forecasts = forecasts_of(job, config, logs)
            if forecasts.read is not None:
                raise ConfigError(
                    "smooth: windows that follow the vehicle are not smoothed; state one region with --region, or allow more "
                    "points with forecast.window_points"
                )
            estimator = build(forecasts, config)
        with clock.stage("estimate"):
            run, inputs, done = _forward(job, config, estimator, forecasts, logs, progress)
            of, (account,) = run.of[0], inputs.accounts(run)
            if config.consistency.on_failure != "ignore":
                each = (event.columns for event, _ in done if isinstance(event, Track))
                tracks = reduce(LogTracks.after, each, LogTracks())
                names = [report.path for report in account.reports]
                require_one_vehicle(MonitoringState(tracks=tracks), names)
            account.require_usable(forecasts.ensemble.grid)
        progress(0, 0, "smoothing")
        notes = [*account.notes(), *estimator.notes(), *_notes(estimator)]
        correction = of.flight.correction(of.counts.corrections)
        more = {
            "notes": [*forecasts.notes, *notes],
            "flight_correction": correction_part(correction),
        }
        outcome = made(account.part() | more, (*job.logs, *job.forecasts))
        with clock.stage("smooth"):
            _write(job, config, forecasts, estimator, run, done, outcome)
    return replace(outcome, seconds=dict(clock.seconds))


def published_times(first_ns: int, last_ns: int, interval: float) -> list[int]:
    """Return the publication times of a smoothed estimate [ns, UTC]: every interval from the first on, and the last."""
    return [*range(first_ns, last_ns, round(interval * _NS)), last_ns]


def changes(estimator: Estimator[Any]) -> TypeGuard[ReducedBasisEstimator]:
    """Return whether an estimator changes in time and can be smoothed."""
    return isinstance(estimator, ReducedBasisEstimator) and bool(
        np.isfinite(estimator.observer.tau).any()
    )


def _notes(estimator: Estimator[Any]) -> list[str]:
    return [] if changes(estimator) else [STATIC]


def _forward(
    job: ReplayJob,
    config: RunConfig,
    estimator: Estimator[Any],
    forecasts: Forecasts,
    logs: Logs,
    progress: Progress,
) -> tuple[Run, Prepared, list[tuple[Any, Innovation | None]]]:
    """Return the forward replay with single profiles and stated errors, and its events with innovations, None for positions."""
    unchecked = config.consistency.model_copy(update={"on_failure": "ignore"})
    config = config.model_copy(update={"consistency": unchecked})
    job = replace(job, out=None, truth=None, goal=None)
    alone = with_window(estimator, 0.0)
    run, inputs = prepare(job, config, None, silent, forecasts, alone, logs)
    done = list[tuple[Any, Innovation | None]]()

    def keep(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
        for _, step in steps:
            if not isinstance(step.event, Aside):
                done.append((step.event, step.innovation))

    run.follow_up = keep
    advance = reading(inputs.logs.all, progress, "reading the logs")
    for block in inputs.played(run):
        advance(len(block))
    return run, inputs, done


def _write(
    job: ReplayJob,
    config: RunConfig,
    forecasts: Forecasts,
    estimator: Estimator[Any],
    run: Run,
    done: Sequence[tuple[Any, Innovation | None]],
    outcome: Outcome,
) -> None:
    """Write the result."""
    measured = [event for event, innovation in done if innovation is not None]
    times = [event.time_ns for event in measured]
    for event, _ in done:
        if isinstance(event, Track):
            times += [int(event.columns["time"].min()), int(event.columns["time"].max())]
    published = published_times(
        min(event.time_ns for event in measured), max(times), config.output.interval
    )
    states = [run.current] * len(published)
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
        # observations, and positions one by one
        each = (
            (one, found) for event, found in done for one in (event if found is None else [event])
        )
        for event, innovation in each:
            while due < len(published) and published[due] <= event.time_ns:
                flow = flow_at(estimator, states[due], published[due])
                depth_slices(published[due], flow, config.output)(writer)
                due += 1
            if innovation is None:
                writer.fix(event)
            else:
                state = estimator.predict(states[max(due - 1, 0)], event.time_ns)
                block.append(_smoothed(estimator, state, event, innovation))
                if len(block) == _BLOCK:
                    writer.innovations(block)
                    block = []
        if block:
            writer.innovations(block)
        dives = [dive for mean in run.of[0].monitoring.means if (dive := flown_of(mean))]
        if (flown := AsFlown.of(dives)) is not None:
            writer.write_metadata(AS_FLOWN, flown.to_record())
        writer.summary(published[-1], outcome)
        flow = flow_at(estimator, states[-1], published[-1])
        writer.finish(replace(flow, span_ns=(min(times), max(times))))
    except BaseException:
        writer.abandon()
        raise


def _smoothed(
    estimator: Estimator[Any], state: Any, measurement: Any, innovation: Innovation
) -> Innovation:
    """Return an innovation with the residual to a smoothed estimate where defined, in addition to that of the replay."""
    replayed = innovation.residual
    residual = np.where(np.isfinite(replayed), estimator.innovation(state, measurement), np.nan)
    return replace(innovation, residual=residual, replayed_residual=replayed, estimated_std=np.nan)
