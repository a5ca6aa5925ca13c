"""Inputs and outputs of a replay: checked, opened, and scanned for their place and start."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import Paths, check_paths, truth_path
from replay_kit.core.grid import Ensemble
from replay_kit.core.plan import Place
from replay_kit.core.region import Region
from replay_kit.estimator import Estimator
from replay_kit.forecast import ensemble_files, read_truth
from replay_kit.forecast.members.collection import open_collection
from replay_kit.forecast.members.rules import parse_rule
from replay_kit.logs import open_logs
from replay_kit.logs.opening import logs_in
from replay_kit.results.mcap.writer import ResultWriter
from replay_kit.workflows.replay.inputs.forecast import Forecasts, read_forecasts
from replay_kit.workflows.replay.inputs.region import FoundRegion, find_region
from replay_kit.workflows.replay.inputs.scan import Logs


@dataclass(frozen=True, slots=True)
class Following:
    """Additions for a replay of growing logs.

    Attributes:
        states: Folder of its state, from which the next replay resumes.
        record: Record of the inputs in the result, by key.
        goals: Later goals, in order, with the time from which each holds [ns, UTC].
    """

    states: Path
    record: Mapping[str, str] = field(default_factory=dict)
    goals: tuple[tuple[int, Place], ...] = ()


def _silent(text: str) -> None: ...


#: Another ensemble: a file, folder or pattern, or files that belong together.
Against = Path | tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Vehicle of a replay, one of several that share an estimate or the only one.

    Attributes:
        name: Name in the result; empty for the only vehicle.
        logs: Its log files.
        goal: Goal; None plans nothing for it.
        why_not: Reason that it contributes nothing to the estimate; empty otherwise.
        places: Longitude and latitude of some positions [degrees].
    """

    name: str
    logs: tuple[Path, ...]
    goal: Place | None = None
    why_not: str = ""
    places: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """Files and goal of a replay.

    Attributes:
        logs: Log files.
        ensemble: Ensemble files, stores, folders and patterns; those in one inner tuple belong together.
        out: Result MCAP; None computes without writing.
        goal: Goal of the vehicle; None plans nothing.
        netcdf: Gridded estimate, CF NetCDF.
        save_estimate: Lossless estimate, NetCDF.
        truth: ``PATH`` or ``PATH#MEMBER`` to score against.
        checkpoint: File from which an interrupted run continues, deleted at its end.
        overwrite: Whether existing outputs are replaced.
        include_inputs: Whether the logs' messages are copied.
        following: For growing logs; None for finished ones.
        region: Part of the forecast found by an earlier run; None finds it, unless the settings state it.
        against: Competing ensembles.
        estimator: Factory of the estimator; None for that of the settings.
        provided: Parts that a script replaces.
        vehicles: Vehicles by name, each with its logs in order; empty for a single one.
        tell: Called with messages during the run.
    """

    logs: tuple[Path, ...]
    ensemble: Path | tuple[Path | tuple[Path, ...], ...]
    out: Path | None = None
    goal: Place | None = None
    netcdf: Path | None = None
    save_estimate: Path | None = None
    truth: str | None = None
    checkpoint: Path | None = None
    overwrite: bool = False
    include_inputs: bool = False
    following: Following | None = None
    region: FoundRegion | None = None
    against: tuple[Against, ...] = ()
    estimator: Callable[[Forecasts, RunConfig], Estimator[Any]] | None = None
    provided: tuple[str, ...] = ()
    vehicles: tuple[Vehicle, ...] = ()
    tell: Callable[[str], None] = _silent

    @property
    def each_vehicle(self) -> tuple[Vehicle, ...]:
        """Replayed vehicles: those of several that contribute to the estimate, or the only one."""
        used = tuple(vehicle for vehicle in self.vehicles if not vehicle.why_not)
        return used if self.vehicles else (Vehicle("", self.logs, self.goal),)

    @property
    def log_files(self) -> list[Path]:
        """Log files, also those in folders of logs."""
        return [file for path in self.logs for file in logs_in(Path(path))]

    @property
    def forecasts(self) -> tuple[Path, ...]:
        """Files of the ensemble, of competing forecasts and of the truth."""
        rivals = (path for each in self.against for path in ensemble_files(each))
        truth = filter(None, [truth_path(self.truth)])
        return (*ensemble_files(self.ensemble), *rivals, *truth)

    @property
    def goals(self) -> tuple[Place, ...]:
        """Goals of the vehicles."""
        goals = (vehicle.goal for vehicle in self.each_vehicle)
        return tuple(goal for goal in goals if goal is not None)


def check_outputs(
    job: ReplayJob, also_read: Iterable[Path | None] = (), also_written: Iterable[Path | None] = ()
) -> None:
    """Raise ConfigError if an output is an input, exists and may not be replaced, or has no folder.

    Args:
        job: The replay.
        also_read: Further inputs, such as the configuration file.
        also_written: Further outputs, such as the JSON summary.
    """
    check_paths(
        (*job.logs, *job.forecasts, *also_read),
        (job.out, job.netcdf, job.save_estimate, *also_written),
        job.overwrite,
        () if job.checkpoint is None else (job.checkpoint,),
    )


def logs_of(job: ReplayJob, config: RunConfig) -> Logs:
    """Return the opened logs of a job.

    Raises:
        LogError: A file is missing or is not a log.
    """
    return Logs([vehicle.logs for vehicle in job.each_vehicle], config)


def copy_inputs(writer: ResultWriter, job: ReplayJob, config: LogConfig) -> None:
    """Copy the logs' messages unchanged into the result, if the job asks for it; frames of a telemetry log."""
    if job.include_inputs:
        logs = open_logs(job.logs, config)
        writer.copy(
            message
            for log in logs
            for message in (log.frames() if log.has_own_frames else log.raw_messages())
        )


def forecasts_of(job: ReplayJob, config: RunConfig, logs: Logs | None = None) -> Forecasts:
    """Return the part of a forecast that a job needs at the time of its logs, moved to their place if set.

    Raises:
        MeasurementError: The ensemble is to be moved to the log, which has no position in the time span.
        ForecastError: The ensemble cannot be used.
        ConfigError: A setting needs an estimator that changes in time.
    """
    logs = logs or logs_of(job, config)
    place_at, near_ns = logs.ahead()
    with open_collection(job.ensemble, parse_rule(config.forecast.members)) as found:
        near = config, near_ns, job.goals
        # a long log is read only if its places are needed
        region = job.region or find_region(lambda: logs.reach.places, found, *near)
        return read_forecasts(job.ensemble, config, near_ns, place_at, region, found)


def open_truth(
    job: ReplayJob,
    config: RunConfig,
    near_ns: int | None,
    ensemble: Ensemble,
    region: Region | None = None,
) -> Ensemble | None:
    """Return the opened truth of a job; None without one.

    Args:
        job: The replay.
        config: Settings; a truth need not have the forecast's leads or times.
        near_ns: Time of the logs' first message [ns, UTC].
        ensemble: The forecast; if it was moved, the truth is moved to the same place.
        region: Part to read; None for that of the settings.

    Raises:
        ForecastError: It cannot be read.
    """
    if job.truth is None:
        return None
    centre = ensemble.grid.projection
    part = config.forecast.model_copy(update={"region": region or config.forecast.region})
    settings = part.model_copy(update={"lead": None, "reference_time": None, "time": None})
    place_at = (centre.longitude, centre.latitude) if config.forecast.place else None
    try:
        return read_truth(job.truth, part, near_ns=near_ns, place_at=place_at)
    except ForecastError:
        return read_truth(job.truth, settings, near_ns=near_ns, place_at=place_at)


def name_of(ensemble: Paths) -> str:
    """Return the name of an ensemble's file without its folder; for several the first name and their number."""
    files = ensemble_files(ensemble)
    return files[0].name if len(files) == 1 else f"{files[0].name} and {len(files) - 1} more"
