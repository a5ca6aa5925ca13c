"""What a replay reads and writes: checked, opened, and scanned for where and when it begins."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError, MeasurementError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import inside_grid, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.core.observation import Observation, VehicleState
from replay_kit.core.paths import check_paths, truth_path
from replay_kit.core.plan import Place
from replay_kit.core.progress import Progress
from replay_kit.core.unchanged import Stamp, stamps_of
from replay_kit.forecast import ensemble_files, read_truth
from replay_kit.logs import merge, open_logs
from replay_kit.logs.folders import logs_in
from replay_kit.logs.reader import LogFile
from replay_kit.measurements import MAVLINK_NAMES, initial_state, interpret
from replay_kit.results import ResultWriter
from replay_kit.results.losses import iso_time
from replay_kit.workflows.replay.build import Forecasts, read_forecasts
from replay_kit.workflows.replay.planner import Planner

# Messages between two looks at how much is read.
_LOOK = 64


@dataclass(frozen=True, slots=True)
class Following:
    """What a replay of logs that may grow adds to one of finished logs.

    Attributes:
        states: Folder of its states, from which the next one goes on.
        record: What is to be said of the inputs in the result, by key.
        goals: From when on [ns, UTC] the goal is another one than the job's, in order.
    """

    states: Path
    record: Mapping[str, str] = field(default_factory=dict)
    goals: tuple[tuple[int, Place], ...] = ()


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """The files that a replay reads and writes, and the goal that it plans for.

    Attributes:
        logs: Log files.
        ensemble: Ensemble file or store, or several, folders and patterns; those in a tuple of their own belong together.
        out: Result MCAP; None computes without writing.
        goal: Where the vehicle should go; None plans nothing.
        netcdf: Gridded estimate, CF NetCDF.
        save_estimate: Lossless estimate, NetCDF.
        truth: ``PATH`` or ``PATH#MEMBER`` to score against.
        truth_radius_km: Score only grid points this near to a profile used; None scores all.
        checkpoint: File from which an interrupted run continues; written during the run, and deleted at its end.
        overwrite: Whether existing outputs are replaced.
        include_inputs: Whether the logs' messages are copied into the result.
        following: For logs that may grow, without a checkpoint; None for finished ones.
    """

    logs: tuple[Path, ...]
    ensemble: Path | tuple[Path | tuple[Path, ...], ...]
    out: Path | None = None
    goal: Place | None = None
    netcdf: Path | None = None
    save_estimate: Path | None = None
    truth: str | None = None
    truth_radius_km: float | None = None
    checkpoint: Path | None = None
    overwrite: bool = False
    include_inputs: bool = False
    following: Following | None = None


def check_outputs(job: ReplayJob, also_read: Iterable[Path | None] = (), also_written: Iterable[Path | None] = ()) -> None:
    """Raise ConfigError when an output of a replay is an input, or exists and may not be replaced, or has no folder.

    Args:
        job: The replay.
        also_read: Inputs that are not in the job, such as the configuration file.
        also_written: Outputs that are not in the job, such as the JSON summary.
    """
    inputs = (*job.logs, *ensemble_files(job.ensemble), truth_path(job.truth), *also_read)
    check_paths(inputs, (job.out, job.netcdf, job.save_estimate, *also_written), job.overwrite, checkpoint_files(job.checkpoint))


def checkpoint_files(path: Path | None) -> tuple[Path, ...]:
    """Return the files of a checkpoint: the checkpoint itself, and the journal beside it."""
    return () if path is None else (path, path.with_name(path.name + ".journal"))


def input_stamps(job: ReplayJob) -> dict[Path, Stamp]:
    """Return what tells each file that a replay reads, those in folders of logs too, from a changed one.

    Raises:
        LogError: A folder holds no log.
    """
    logs = [file for path in job.logs for file in logs_in(Path(path))]
    return stamps_of([*logs, *ensemble_files(job.ensemble), *filter(None, [truth_path(job.truth)])])


def open_readers(logs: Sequence[Path], config: RunConfig) -> list[LogReader]:
    """Return the opened logs; of MAVLink and DataFlash only the messages that the estimator uses, and mapped topics, are decoded.

    Raises:
        LogError: A file is missing or is not a log.
    """
    mapped = [entry.topic.split("/") for entry in config.measurements.map]
    # a schema of DataFlash has its format's name before that of the record
    wanted = MAVLINK_NAMES | {".".join(parts) if parts[0] == "dataflash" else parts[-1] for parts in mapped}
    return list(open_logs(logs, config.logs, wanted))


def reading(logs: Sequence[LogReader | LogFile], progress: Progress, what: str) -> Callable[[], None]:
    """Return a function that is called with each message and reports how much of the logs is read."""
    files, count = [log for log in logs if isinstance(log, LogFile)], 0

    def advance() -> None:
        nonlocal count
        count += 1
        if count % _LOOK == 0:
            progress(sum(log.share_read() for log in files), len(files), what)

    return advance


def copy_inputs(writer: ResultWriter, job: ReplayJob, config: LogConfig) -> None:
    """Copy the logs' messages unchanged into the result, if the job asks for it: of a telemetry log its frames."""
    if job.include_inputs:
        logs = open_logs(job.logs, config)
        writer.copy(message for log in logs for message in (log.frames() if log.has_own_frames else log.raw_messages()))


def look_ahead(logs: Sequence[Path], config: RunConfig) -> tuple[tuple[float, float] | None, int | None]:
    """Return the mean position, when the ensemble is to be placed there, and the first time used [ns, UTC], of the chosen time span.

    Messages of topics that come once are read although they are older than the span, as in a replay, but their positions do not count.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: The ensemble is to be placed at the log, and the log holds no position in the span.
    """
    start_ns = config.logs.start_ns
    place_at, first_ns = _mean_place(logs, config) if config.forecast.place else (None, _first_time(logs, config))
    if first_ns is not None and start_ns is not None:
        first_ns = max(first_ns, start_ns)
    return place_at, first_ns


def forecasts_of(job: ReplayJob, config: RunConfig) -> Forecasts:
    """Return the forecast of a job, at the time of its logs, and where it is asked for at their place.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: The ensemble is to be placed at the log, and the log holds no position in the span.
        ForecastError: The ensemble cannot be used.
        ConfigError: An estimator that knows no time is asked for what needs it.
    """
    place_at, near_ns = look_ahead(job.logs, config)
    return read_forecasts(job.ensemble, config, near_ns, place_at)


def with_planner_kind(job: ReplayJob, readers: Sequence[LogReader], config: RunConfig, deepest: float) -> RunConfig:
    """Return the settings with what a replay with a goal plans: for a glider's logs a mission, where no kind is chosen.

    Args:
        job: Without a goal, nothing changes.
        readers: Its opened logs.
        config: The settings.
        deepest: Level of the forecast [m].
    """
    if job.goal is None or config.planner.kind != "auto":
        return config
    gliders = any(isinstance(log, LogFile) and log.is_gliders() for log in readers)
    return config.model_copy(update={"planner": config.planner.resolved(gliders, job.goal.depth, deepest)})


def _first_time(logs: Sequence[Path], config: RunConfig) -> int | None:
    firsts = (next(iter(merge([reader], config.logs.reorder_window)), None) for reader in open_readers(logs, config))
    return min((message.time_ns for message in firsts if message is not None), default=None)


def _positions(logs: Sequence[Path], config: RunConfig) -> tuple[list[tuple[float, float]], int | None]:
    """Return the longitudes and latitudes that a replay would use, and the time of its first message."""
    settings, first_ns = config.logs, None
    state, positions, placed = initial_state(settings.system), [], []
    for message in merge(open_readers(logs, config), settings.reorder_window, settings.start_ns, settings.end_ns):
        first_ns = message.time_ns if first_ns is None else first_ns
        state, events = interpret(state, message, config.measurements)
        if settings.start_ns is None or message.time_ns >= settings.start_ns:
            positions += [(event.longitude, event.latitude) for event in events if isinstance(event, VehicleState)]
            placed += [(event.longitude, event.latitude) for event in events if isinstance(event, Observation)]
    # measurements with places of their own do not say where the vehicle is, but where to place the ensemble
    return positions or placed, first_ns


def check_goal(planner: Planner, flow: FlowEstimate, job: ReplayJob, config: RunConfig) -> None:
    """Raise PlanError when the goal is outside the region or on land, and say so when the whole log is outside the region too."""
    assert job.goal is not None
    try:
        planner.check(flow, job.goal)
    except PlanError as error:
        positions, _ = _positions(job.logs, config)
        local = to_local(flow.grid.projection, *np.array(positions).T) if positions else (np.empty(0), np.empty(0))
        if not positions or np.any(inside_grid(flow.grid, *local)):
            raise
        (west, south), (east, north) = np.min(positions, axis=0), np.max(positions, axis=0)
        raise PlanError(
            f"{error}. The whole log lies outside it too, in {west:.4f}..{east:.4f} E, {south:.4f}..{north:.4f} N: "
            "use an ensemble of that place, or --place-ensemble for a study"
        ) from error


def check_span(logs: Sequence[Path], config: RunConfig, last_ns: int | None) -> None:
    """Raise ConfigError when the logs have messages, and none of them lies in the time span that is asked for.

    Args:
        logs: The logs.
        config: With the span.
        last_ns: Time of the last message read [ns, UTC]; those of topics that come once may be older than the span. None without one.
    """
    settings = config.logs
    asked = [f"--{name} {text}" for name, text in (("start", settings.start), ("end", settings.end)) if text is not None]
    if not asked or (last_ns is not None and last_ns >= (settings.start_ns or 0)):
        return
    times = [message.time_ns for reader in open_readers(logs, config) for message in reader.messages()]
    if times:
        raise ConfigError(
            f"{' and '.join(asked)}: no message lies there; the log spans {iso_time(min(times), 's')} to {iso_time(max(times), 's')}"
        )


def _mean_place(logs: Sequence[Path], config: RunConfig) -> tuple[tuple[float, float], int | None]:
    """Return the mean longitude and latitude of the positions that a replay would use, and the time of its first message."""
    settings = config.logs
    positions, first_ns = _positions(logs, config)
    if not positions:
        between = f" between {settings.start or 'their start'} and {settings.end or 'their end'}" if settings.start or settings.end else ""
        raise MeasurementError(
            f"--place-ensemble moves the ensemble to the mean fix, but the logs hold no position{between}; "
            + ("widen --start and --end, or leave the option out" if between else "leave the option out")
            + f"; replay-kit info {logs[0]} says what is in a log, and --suggest map.toml beside it maps topics of unknown types"
        )
    longitude, latitude = np.array(positions).T
    # on the unit circle, because longitudes may lie on both sides of the antimeridian
    directions = np.exp(1j * np.deg2rad(longitude))
    return (float(np.rad2deg(np.angle(directions.mean()))), float(latitude.mean())), first_ns


def open_truth(job: ReplayJob, config: RunConfig, near_ns: int | None, ensemble: Ensemble) -> Ensemble | None:
    """Return the truth of a job; None without one.

    Args:
        job: The replay.
        config: Its settings; a truth need not have the forecast's leads or times.
        near_ns: Time of the logs' first message [ns, UTC].
        ensemble: The forecast; if it was moved, the truth is moved to the same place.

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
