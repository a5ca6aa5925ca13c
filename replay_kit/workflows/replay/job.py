"""What to replay and where to put it: the job, checked and opened."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import ForecastError, MeasurementError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.core.observation import VehicleState
from replay_kit.core.paths import check_paths, truth_path
from replay_kit.core.plan import Place, Plan
from replay_kit.core.surfacing import Surfacing
from replay_kit.forecast import read_truth
from replay_kit.logs import merge, open_log
from replay_kit.logs.copying import RawLog
from replay_kit.measurements import MAVLINK_NAMES, initial_state, interpret
from replay_kit.results import ResultWriter


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What a planner answers.

    Attributes:
        plan: The plan, as results hold it.
        surfacing: Where and when it says that the vehicle will surface next; None when it does not say.
        memory: What the planner wants back when it plans anew, or flies the plan; a frozen value.
    """

    plan: Plan
    surfacing: Surfacing | None = None
    memory: Any = None


class Planner(Protocol):
    """What a replay needs of a planner; the command line hands one in."""

    def plan(self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: Planned | None) -> Planned:
        """Return the best plan found from start towards goal."""
        ...

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land."""
        ...

    def closest_approach(self, flow: FlowEstimate, planned: Planned) -> float:
        """Return how close [m] a plan comes to its goal when it is flown in a flow."""
        ...


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """What to replay, and where to put what comes out.

    Attributes:
        logs: Log files.
        ensemble: Ensemble file or store.
        out: Result MCAP; None computes without writing.
        goal: Where the vehicle should go; None plans nothing.
        netcdf: Gridded estimate, CF NetCDF.
        save_estimate: Lossless estimate, NetCDF.
        truth: ``PATH`` or ``PATH#MEMBER`` to score against.
        truth_radius_km: Score only grid points this near to a profile used; None scores all.
        checkpoint: File from which a killed run goes on; made as the run goes, and deleted at its end.
        overwrite: Whether existing outputs are replaced.
        include_inputs: Whether the logs' messages are copied into the result.
    """

    logs: tuple[Path, ...]
    ensemble: Path
    out: Path | None = None
    goal: Place | None = None
    netcdf: Path | None = None
    save_estimate: Path | None = None
    truth: str | None = None
    truth_radius_km: float | None = None
    checkpoint: Path | None = None
    overwrite: bool = False
    include_inputs: bool = False


def check_outputs(job: ReplayJob, also_read: Iterable[Path | None] = (), also_written: Iterable[Path | None] = ()) -> None:
    """Raise ConfigError when an output of a replay is an input, or exists and may not be replaced, or has no folder.

    Args:
        job: The replay.
        also_read: Inputs that the job does not know, such as the configuration file.
        also_written: Outputs that the job does not know, such as the JSON summary.
    """
    inputs = (*job.logs, job.ensemble, truth_path(job.truth), *also_read)
    check_paths(inputs, (job.out, job.netcdf, job.save_estimate, *also_written), job.overwrite, checkpoint_files(job.checkpoint))


def checkpoint_files(path: Path | None) -> tuple[Path, ...]:
    """Return the files of a checkpoint of that name: itself, and the journal beside it."""
    return () if path is None else (path, path.with_name(path.name + ".journal"))


def open_readers(logs: Sequence[Path], config: RunConfig) -> list[LogReader]:
    """Return the logs, opened; of MAVLink and DataFlash only what the estimator uses, and topics mapped, is decoded.

    Raises:
        LogError: One is missing or not a log.
    """
    mapped = [entry.topic.split("/") for entry in config.measurements.map]
    # a schema of DataFlash has its format's name before that of the record
    wanted = MAVLINK_NAMES | {".".join(parts) if parts[0] == "dataflash" else parts[-1] for parts in mapped}
    return [open_log(path, position, config.logs, wanted=wanted) for position, path in enumerate(logs)]


def copy_inputs(writer: ResultWriter, job: ReplayJob, config: LogConfig) -> None:
    """Copy the logs' messages into the result as they are, when the job wants them there: frames of a telemetry log as frames."""
    if job.include_inputs:
        logs = [RawLog(path, number, config) for number, path in enumerate(job.logs)]
        writer.copy(message for log in logs for message in (log.frames() if log.has_own_frames() else log.messages()))


def look_ahead(logs: Sequence[Path], config: RunConfig) -> tuple[tuple[float, float] | None, int | None]:
    """Return the mean position, when the ensemble is to be placed there, and the first time used [ns, UTC], of the chosen time span.

    Messages of topics that come once are read although they are older than the span, as in a replay, but their positions do not count.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: The ensemble is to be placed at the log, and the log holds no position in the span.
    """
    settings = config.logs
    if config.forecast.place:
        place_at, first_ns = _mean_place(logs, config)
    else:
        place_at, first_ns = None, _first_time(logs, config)
    if first_ns is not None and settings.start_ns is not None:
        first_ns = max(first_ns, settings.start_ns)
    return place_at, first_ns


def _first_time(logs: Sequence[Path], config: RunConfig) -> int | None:
    firsts = (next(iter(reader.messages()), None) for reader in open_readers(logs, config))
    return min((message.time_ns for message in firsts if message is not None), default=None)


def _mean_place(logs: Sequence[Path], config: RunConfig) -> tuple[tuple[float, float], int | None]:
    """Return the mean of the positions that a replay would use, longitude and latitude, and the time of the first message it would."""
    settings, first_ns = config.logs, None
    state, positions = initial_state(settings.system), []
    for message in merge(open_readers(logs, config), settings.reorder_window, settings.start_ns, settings.end_ns):
        first_ns = message.time_ns if first_ns is None else first_ns
        state, events = interpret(state, message, config.measurements)
        if settings.start_ns is None or message.time_ns >= settings.start_ns:
            positions += [(event.longitude, event.latitude) for event in events if isinstance(event, VehicleState)]
    if not positions:
        between = f" between {settings.start or 'their start'} and {settings.end or 'their end'}" if settings.start or settings.end else ""
        raise MeasurementError(
            f"--place-ensemble moves the ensemble to the mean fix, but the logs hold no position{between}; "
            + ("widen --start and --end, or leave the option out" if between else "leave the option out")
        )
    longitude, latitude = np.array(positions).T
    turns = np.exp(1j * np.deg2rad(longitude))
    return (float(np.rad2deg(np.angle(turns.mean()))), float(latitude.mean())), first_ns


def open_truth(job: ReplayJob, config: RunConfig, near_ns: int | None, ensemble: Ensemble) -> Ensemble | None:
    """Return the truth of a job, or None.

    Args:
        job: The replay.
        config: Its settings; a truth need not have the forecast's leads or times.
        near_ns: Time of the logs' first message [ns, UTC].
        ensemble: The forecast, to whose place the truth is moved when the forecast was.

    Raises:
        ForecastError: It cannot be read.
    """
    if job.truth is None:
        return None
    centre = ensemble.grid.projection
    settings = config.forecast.model_copy(update={"lead": None, "reference_time": None, "time": None})
    place_at = (centre.longitude, centre.latitude) if config.forecast.place else None
    try:
        return read_truth(job.truth, config.forecast, near_ns=near_ns, place_at=place_at)
    except ForecastError:
        return read_truth(job.truth, settings, near_ns=near_ns, place_at=place_at)
