"""Smoothed result of logs: at each published time the estimate from observations before and after it.

The file has the format of a replay (``replay_kit/results/CHANNELS.md``) with two differences: grids and unknowns are smoothed at the
published times; an observation's residual is that to the previous smoothed estimate, carried forward to the observation, next to that of
the replay. Innovations, NIS and gate decisions are those of the replay, without later observations.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeGuard

import numpy as np
from threadpoolctl import threadpool_limits

from replay_kit.config.run import RunConfig
from replay_kit.core.as_flown import AS_FLOWN, AsFlown
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Innovation
from replay_kit.core.words.progress import Progress, silent
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import smooth as smoothed
from replay_kit.logs.reader import reading
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, checked_outcome
from replay_kit.workflows.replay.conclude import found_of, useless_of
from replay_kit.workflows.replay.events import Aside, Track
from replay_kit.workflows.replay.inputs.forecast import Forecasts, build, flow_at, with_window
from replay_kit.workflows.replay.inputs.job import ReplayJob, check_outputs
from replay_kit.workflows.replay.inputs.prepare import Prepared, prepare
from replay_kit.workflows.replay.inputs.provenance import run_settings_toml
from replay_kit.workflows.replay.publishing import depth_slices
from replay_kit.workflows.replay.run import Run
from replay_kit.workflows.replay.steps import Step
from replay_kit.workflows.replay.surfacings import flown_of

_NS = 1_000_000_000
# Innovations written together.
_BLOCK = 16
#: Said in a result whose estimate is static.
STATIC = "the estimate is static: smoothed, it is the last estimate at all times"
# Events with their innovations, None of positions.
_Done = list[tuple[Any, Innovation | None]]


def smooth(job: ReplayJob, config: RunConfig, progress: Progress = silent) -> Outcome:
    """Write the smoothed result of logs, and return the outcome of its forward replay.

    The forward replay takes single profiles with their stated errors, and excludes what a replay excludes.

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
        run, inputs = prepare(replace(job, estimator=_one_by_one), config, None, progress)
        vehicle, done = run.vehicles[0], _Done()
        estimator = vehicle.setup.estimator

        def keep(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
            events = ((step.event, step.innovation) for _, step in steps)
            done.extend(one for one in events if not isinstance(one[0], Aside))

        def begin_anew(run: Run, steps: Sequence[tuple[int, Step]]) -> None:
            done[:] = [one for one in done if isinstance(one[0], Track)]
            keep(run, steps)
            done.sort(key=lambda one: one[0].time_ns)

        run.follow_up, run.rebuilt = keep, begin_anew
        advance = reading(inputs.logs.all, progress, "reading the logs")
        for block in inputs.played(run):
            advance(len(block))
        useless_of(run, inputs)
        progress(0, 0, "smoothing")
        static = [] if changes(estimator) else [STATIC]
        found = found_of(vehicle, run.flow_now(), inputs)
        notes = [*inputs.forecasts.notes, *found["notes"], *estimator.notes(), *static]
        outcome = checked_outcome(found | {"notes": notes}, (*job.logs, *job.forecasts))
        with run.clock.stage("smooth"):
            _write(inputs, run, done, outcome)
    return replace(outcome, seconds=dict(run.clock.seconds))


def _one_by_one(forecasts: Forecasts, config: RunConfig) -> Estimator[Any]:
    """Return the estimator of one region, which takes single profiles."""
    if forecasts.read is not None:
        raise ConfigError(
            "smooth: windows that follow the vehicle are not smoothed; state one region with --region, or allow more "
            "points with forecast.window_points"
        )
    return with_window(build(forecasts, config), 0.0)


def published_times(first_ns: int, last_ns: int, interval: float) -> list[int]:
    """Return the publication times of a smoothed estimate [ns, UTC]: every interval from the first on, and the last."""
    return [*range(first_ns, last_ns, round(interval * _NS)), last_ns]


def changes(estimator: Estimator[Any]) -> TypeGuard[ReducedBasisEstimator]:
    """Return whether an estimator changes in time and can be smoothed."""
    return isinstance(estimator, ReducedBasisEstimator) and bool(
        np.isfinite(estimator.observer.tau).any()
    )


def _write(
    inputs: Prepared,
    run: Run,
    done: _Done,
    outcome: Outcome,
) -> None:
    """Write the result."""
    job, config, estimator = inputs.job, run.config, run.vehicles[0].setup.estimator
    measured = [event for event, innovation in done if innovation is not None]
    times = [event.time_ns for event in measured]
    for event, _ in done:
        if isinstance(event, Track):
            times += [int(event.columns["time"].min()), int(event.columns["time"].max())]
    begun_ns, last_ns = min(times), max(times)
    first_ns = min((event.time_ns for event in measured), default=begun_ns)
    published = published_times(first_ns, last_ns, config.output.interval)
    states = [run.current] * len(published)
    if changes(estimator):
        states = smoothed(estimator, measured, published)
    options = {"smoothed": "true", "modes": str(inputs.prior_flow.n_modes)}
    metadata = {**inputs.metadata, "replay_kit.options": options}
    # of a run that goes on
    for name in ("replay_kit.forecast", "replay_kit.reading"):
        metadata.pop(name, None)
    assert job.out is not None
    writer = ResultWriter(job.out, job.overwrite)
    try:
        projection = inputs.prior_flow.grid.projection
        writer.start(projection, begun_ns, metadata, run_settings_toml(config))
        if not changes(estimator):
            writer.log(begun_ns, "info", STATIC)
        due, block = 0, list[Innovation]()
        # observations, and positions one by one
        each = ((one, new) for event, new in done for one in ([event] if new else event))
        for event, innovation in each:
            while due < len(published) and published[due] <= event.time_ns:
                flow = flow_at(estimator, states[due], published[due])
                depth_slices(published[due], flow, config.output)(writer)
                due += 1
            if innovation is None:
                writer.fix(event)
                continue
            state = estimator.predict(states[max(due - 1, 0)], event.time_ns)
            # the residual to the smoothed estimate where that of the replay is defined, beside that
            replayed = innovation.residual
            against = estimator.innovation(state, event)
            residual = np.where(np.isfinite(replayed), against, np.nan)
            found = replace(innovation, replayed_residual=replayed, estimated_std=np.nan)
            block.append(replace(found, residual=residual))
            if len(block) == _BLOCK:
                writer.innovations(block)
                block = []
        if block:
            writer.innovations(block)
        dives = [dive for mean in run.vehicles[0].monitoring.means if (dive := flown_of(mean))]
        if (flown := AsFlown.of(dives)) is not None:
            writer.write_metadata(AS_FLOWN, flown.to_record())
        writer.consistency(last_ns, outcome.consistency)
        writer.summary(last_ns, outcome)
        flow = flow_at(estimator, states[-1], last_ns)
        writer.finish(replace(flow, span_ns=(begun_ns, last_ns)))
    except BaseException:
        writer.abandon()
        raise
