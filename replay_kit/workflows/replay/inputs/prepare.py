"""State of a replay before its first message: forecast, estimator, and setup of each vehicle."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from heapq import merge as merged_by

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.message import Message
from replay_kit.core.plan import Place
from replay_kit.core.words.progress import Progress, Stopwatch
from replay_kit.logs.reader import LogFile
from replay_kit.measurements.step import for_region
from replay_kit.workflows.replay.account import surface_only
from replay_kit.workflows.replay.consistency import checked_speeds
from replay_kit.workflows.replay.inputs.forecast import Forecasts, build
from replay_kit.workflows.replay.inputs.job import (
    ReplayJob,
    Vehicle,
    forecasts_of,
    logs_of,
    open_truth,
)
from replay_kit.workflows.replay.inputs.planner import HasGrid, Planner, PlannerFactory
from replay_kit.workflows.replay.inputs.provenance import run_metadata, run_options
from replay_kit.workflows.replay.inputs.scan import Logs, VehicleLogs, next_block
from replay_kit.workflows.replay.inputs.vehicles import first_windows
from replay_kit.workflows.replay.plans import PlanningProblem
from replay_kit.workflows.replay.run import END, Run
from replay_kit.workflows.replay.vehicle import Setup


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Inputs of a replay read before its first message.

    Attributes:
        job: Inputs and outputs.
        logs: The logs, opened.
        forecasts: Forecast of the estimator.
        prior_flow: Prior current.
        metadata: Records of the result: inputs, options, versions, region.
    """

    job: ReplayJob
    logs: Logs
    forecasts: Forecasts
    prior_flow: FlowEstimate
    metadata: Mapping[str, Mapping[str, str]]

    def messages(self) -> Iterator[Message]:
        """Yield the messages of all vehicles by time, then by input, and a mark where those of each vehicle end."""
        each = [_to_end(iter(one.merged), one.files[0].input) for one in self.logs.by_vehicle]
        if len(each) == 1:
            return each[0]
        return merged_by(*each, key=lambda message: (message.time_ns, message.input))

    def played(
        self,
        run: Run,
        messages: Iterator[Message] | None = None,
        begin: Callable[[int], None] | None = None,
    ) -> Iterator[list[Message]]:
        """Pass messages, None for all, through a run, yield each finished block, then end the run.

        ``begin`` is called with the time of the run's first message [ns, UTC] before it.

        Raises:
            ConfigError: No message lies in the time span that is asked for.
        """
        messages = messages or self.messages()
        while True:
            with run.clock.stage("read"):
                block = next_block(messages, run.config.output.checkpoint_interval)
            if not block:
                break
            if begin is not None and not run.messages:
                begin(block[0].time_ns)
            run.take(block)
            yield block
        self.logs.check_span(run.last_ns if run.messages else None)
        run.finish()


def _to_end(messages: Iterator[Message], number: int) -> Iterator[Message]:
    last_ns = None
    for message in messages:
        last_ns = message.time_ns
        yield message
    if last_ns is not None:
        yield Message(last_ns, "", END, {}, number, 2**62)


def prepare(
    job: ReplayJob,
    config: RunConfig,
    planner_of: PlannerFactory | None,
    progress: Progress,
    forecasts: Forecasts | None = None,
) -> tuple[Run, Prepared]:
    """Return a replay before its first message, and its inputs.

    Args:
        job: Inputs and outputs.
        config: The run's settings.
        planner_of: Factory of the planner for a job with a goal.
        progress: Called with the progress of each stage.
        forecasts: Result of ``forecasts_of`` for this job; None reads it.
    """
    progress(0, 0, "reading the forecast")
    clock = Stopwatch()
    with clock.stage("forecast"):
        logs = logs_of(job, config)
        forecasts = forecasts or forecasts_of(job, config, logs)
        ensemble = forecasts.ensemble
        speeds = checked_speeds(ensemble, config)
        # one that cannot be read is refused before the run
        open_truth(job, config, forecasts.near_ns, ensemble, forecasts.box)
    firsts = first_windows(job, forecasts)
    # goals out of reach are refused before the basis is computed
    each = list[tuple[Vehicle, VehicleLogs, RunConfig, PlanningProblem | None]]()
    for vehicle, own_logs in zip(job.each_vehicle, logs.by_vehicle, strict=True):
        settings, problem = with_planner_kind(vehicle, own_logs.files, config), None
        if vehicle.goal is not None and planner_of is not None:
            planner = planner_of(settings.planner, ensemble.grid)
            check_goal(planner, ensemble, vehicle.goal, logs)
            later = () if job.following is None else job.following.goals
            surface = settings.measurements.surface_depth
            problem = PlanningProblem(planner, vehicle.goal, settings.planner, surface, later)
        each.append((vehicle, own_logs, settings, problem))
    progress(0, 0, "computing the basis and the prior")
    with clock.stage("basis"):
        make = job.estimator or partial(build, vehicles=len(each))
        estimator = make(forecasts, config)
        prior_flow = estimator.flow(estimator.initial())
    setups = list[Setup]()
    for number, (vehicle, own_logs, settings, problem) in enumerate(each):
        follows, expected, first = estimator, speeds, firsts.get(vehicle.name)
        if first is not None and forecasts.read is not None:
            follows = estimator.of_vehicle(number, first)
            expected = checked_speeds(forecasts.read(first), config)
        setups.append(Setup(follows, settings, problem, expected, vehicle.name, own_logs))
    # without a goal nothing reads the bathymetry
    bathymetry = config.planner.bathymetry_path if any(one.problem for one in setups) else None
    metadata = dict[str, Mapping[str, str]]()
    if job.out is not None:
        options = run_options(job, prior_flow)
        metadata = run_metadata(job, forecasts, logs.all, options, bathymetry)
    measured_by = for_region(setups[0].config, ensemble).measurements
    owners = [number for number, one in enumerate(logs.by_vehicle) for _ in one.files]
    run = Run(setups, measured_by, clock, owners)
    return run, Prepared(job, logs, forecasts, prior_flow, metadata)


def with_planner_kind(vehicle: Vehicle, readers: Sequence[LogFile], config: RunConfig) -> RunConfig:
    """Return the settings with a mission as kind of plan for a goal and a glider's logs; ``auto`` stays where dives may show one."""
    asked = vehicle.goal is None or config.planner.kind != "auto"
    if asked or not any(log.is_gliders() for log in readers):
        return config
    return config.model_copy(update={"planner": config.planner.resolved(of_glider=True)})


def check_goal(planner: Planner, flow: HasGrid, goal: Place, logs: Logs) -> None:
    """Raise PlanError if the goal is outside the region or on land; the message adds if the logs are outside too."""
    try:
        planner.check(flow, goal)
    except PlanError as error:
        if below := surface_only(flow.grid, logs):
            raise PlanError(f"{error}. {below}") from error
        places = logs.reach.places
        local = to_local(flow.grid.projection, *places.T)
        if not len(places) or np.any(inside_grid(flow.grid, *local)):
            raise
        (west, south), (east, north) = places.min(axis=0), places.max(axis=0)
        raise PlanError(
            f"{error}. The whole log lies outside it too, in {west:.2f}..{east:.2f} E, {south:.2f}..{north:.2f} N: "
            "use an ensemble of that place, or --place-ensemble for a study"
        ) from error
