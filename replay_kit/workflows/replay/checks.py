"""The checks of a replay's inputs, made without an estimate: what would end the replay ends this.

A replay makes the same checks in its course; ``info``, ``replay --dry-run`` and ``fleet --dry-run`` make them here.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Grid
from replay_kit.core.message import LogReader, LogReport, Message
from replay_kit.core.observation import Measurement, Observation, PathMean, VehicleState, usable
from replay_kit.core.region import inside
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.estimator.update.screening import screened
from replay_kit.logs import merge
from replay_kit.logs.reader import LogFile
from replay_kit.measurements.observed import begun, blocks, rows
from replay_kit.measurements.region import for_region
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle, forecasts_of
from replay_kit.workflows.replay.inputs.scan import check_span, open_readers, positions_of
from replay_kit.workflows.replay.stages.consistency import (
    MonitoringState,
    checked,
    checked_speeds,
    noted,
    require_one_vehicle,
)
from replay_kit.workflows.replay.stages.estimation import Assimilation, Step
from replay_kit.workflows.replay.stages.planner import HasGrid, Planner, PlannerFactory
from replay_kit.workflows.replay.statistics import RunStatistics

# Messages that are decoded and tested together.
_BLOCK = 128


@dataclass(frozen=True, slots=True, eq=False)
class CheckedInputs:
    """Inputs that a replay can use.

    Attributes:
        forecasts: The part of the forecast that it would read.
        profiles: Number of profiles that the logs give.
        used: Number of those with a usable bin in the region.
        first: The first of these, as many as an estimate takes up together.
    """

    forecasts: Forecasts
    profiles: int
    used: int
    first: tuple[Observation, ...]


def check_inputs(
    job: ReplayJob, config: RunConfig, planner_of: PlannerFactory | None = None
) -> CheckedInputs:
    """Return what a replay would use; the logs are read to their end.

    Args:
        job: The replay.
        config: Its settings.
        planner_of: Makes the planner, when the job has a goal; None leaves the goal unchecked.

    Raises:
        ReplayKitError: As the replay itself would, for inputs that it would refuse.
    """
    if job.vehicles:
        each = [
            check_inputs(
                replace(job, logs=one.logs, goal=one.goal, vehicles=()), config, planner_of
            )
            for one in job.each_vehicle
        ]
        first = tuple(profile for one in each for profile in one.first)
        profiles, used = sum(one.profiles for one in each), sum(one.used for one in each)
        return CheckedInputs(forecasts_of(job, config), profiles, used, first)
    forecasts = forecasts_of(job, config)
    ensemble, readers = forecasts.ensemble, open_readers(job.logs, config)
    speeds = checked_speeds(ensemble, config)
    if job.goal is not None and planner_of is not None:
        settings = with_planner_kind(job, readers, config).planner
        check_goal(planner_of(settings, ensemble.grid), ensemble, job, config)
    merged = merge(readers, config.logs.reorder_window, config.logs.start_ns, config.logs.end_ns)
    config = for_region(config, ensemble)
    kinds = (
        (VehicleState, Measurement) if config.estimator.name == OWN else (VehicleState, Observation)
    )
    monitoring, statistics, profiles, used = MonitoringState(), RunStatistics(), 0, 0
    stream = begun(config.logs.system, config.logs.component)
    times = list[int]()
    taken = list[Observation]()
    for block in blocks(_noting(merged, times), config.measurements, _BLOCK, stream):
        monitoring, block, with_event = checked(monitoring, block, config, speeds)
        statistics, steps = statistics.after_messages(block.counts()), list[Step]()
        for k, event in enumerate(rows(block)):
            monitoring = noted(monitoring, event, with_event.get(k, ()), config)
            if isinstance(event, kinds):
                if not _aside(event, config):
                    steps.append(Step(event, None, None, _screened(event, forecasts, config)))
            elif isinstance(event, Measurement):
                statistics = statistics.with_unsupported(event)
        statistics = statistics.after_steps(steps)
        given = [
            (step.event, step.assimilation)
            for step in steps
            if isinstance(step.event, Observation) and step.assimilation is not None
        ]
        accepted = [event for event, found in given if found.innovation.accepted]
        taken += accepted[: ReducedBasisEstimator.block_size - len(taken)]
        profiles, used = profiles + len(given), used + len(accepted)
    check_span(job.logs, config, times[-1] if times else None)
    reports = [reader.report() for reader in readers]
    require_usable(monitoring, statistics.with_order(merged), reports, ensemble.grid, config)
    return CheckedInputs(forecasts, profiles, used, tuple(taken))


def require_usable(
    monitoring: MonitoringState,
    statistics: RunStatistics,
    reports: Sequence[LogReport],
    grid: Grid,
    config: RunConfig,
    first_input: int = 0,
) -> None:
    """Raise MeasurementError when logs that were read to their end are of two vehicles, or give nothing of what was asked for.

    Args:
        monitoring: What the checks of each event found.
        statistics: Of what was used.
        reports: Of the logs.
        grid: Of the forecast.
        config: The run's settings.
        first_input: Of these logs among those of all vehicles.
    """
    names = [report.path for report in reports]
    require_one_vehicle(monitoring, [*[""] * first_input, *names])
    if not monitoring.explains_no_profile:
        statistics.require_usable(reports, grid)
    statistics.require_left_out(config.measurements.without)


def _noting(messages: Iterable[Message], times: list[int]) -> Iterator[Message]:
    """Yield messages; the time of the last one is kept [ns, UTC]."""
    for message in messages:
        times[:] = [message.time_ns]
        yield message


def _aside(event: VehicleState | Measurement, config: RunConfig) -> bool:
    """Return whether an event is a mean current that no estimate is given, because the profiles beside it were computed from it."""
    return (
        isinstance(event, PathMean)
        and event.beside_profiles
        and not config.measurements.flight_bias
    )


def _screened(
    event: VehicleState | Measurement, forecasts: Forecasts, config: RunConfig
) -> Assimilation | None:
    """Return a measurement as assimilated where the region's water has a use for it; None for a position."""
    if isinstance(event, VehicleState):
        return None
    grid = forecasts.ensemble.grid
    ((one,),) = screened([(event,)], grid, relative=config.estimator.name == OWN)
    accepted = one.is_used or _in_later_window(event, forecasts)
    unused = replace(one.unused(), accepted=accepted)
    return Assimilation(unused, unused.innovation)


def _in_later_window(event: Measurement, forecasts: Forecasts) -> bool:
    """Return whether a measurement lies in a window that is read when the vehicle comes to it."""
    region = forecasts.region
    place = float(np.atleast_1d(event.longitude)[-1]), float(np.atleast_1d(event.latitude)[-1])
    if (
        region is None
        or not region.follows
        or inside(region.region, *place)
        or not inside(region.bounds, *place)
    ):
        return False
    deepest = forecasts.ensemble.grid.levels[-1]
    linear = event.linear
    return not linear.at_one_place or bool(
        np.any(usable(linear.flags) & (linear.value_depth <= deepest))
    )


def with_planner_kind(
    job: ReplayJob | Vehicle, readers: Sequence[LogReader], config: RunConfig
) -> RunConfig:
    """Return the settings with what a replay with a goal plans: for a glider's logs a mission, where no kind is chosen.

    Args:
        job: Without a goal, nothing changes.
        readers: Its opened logs.
        config: The settings.
    """
    if job.goal is None or config.planner.kind != "auto":
        return config
    gliders = any(isinstance(log, LogFile) and log.is_gliders() for log in readers)
    return config.model_copy(update={"planner": config.planner.resolved(gliders)})


def check_goal(
    planner: Planner, flow: HasGrid, job: ReplayJob | Vehicle, config: RunConfig
) -> None:
    """Raise PlanError when the goal is outside the region or on land, and say so when the whole log is outside the region too."""
    assert job.goal is not None
    try:
        planner.check(flow, job.goal)
    except PlanError as error:
        positions, _ = positions_of(job.logs, config)
        local = (
            to_local(flow.grid.projection, *np.array(positions).T)
            if positions
            else (np.empty(0), np.empty(0))
        )
        if not positions or np.any(inside_grid(flow.grid, *local)):
            raise
        (west, south), (east, north) = np.min(positions, axis=0), np.max(positions, axis=0)
        raise PlanError(
            f"{error}. The whole log lies outside it too, in {west:.4f}..{east:.4f} E, {south:.4f}..{north:.4f} N: "
            "use an ensemble of that place, or --place-ensemble for a study"
        ) from error
