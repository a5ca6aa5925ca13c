"""What a replay has read before its first message."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import LogReader
from replay_kit.core.region import Region
from replay_kit.forecast import read_truth
from replay_kit.logs import open_logs
from replay_kit.results import ResultWriter
from replay_kit.workflows.replay.inputs.forecast import Forecasts, read_forecasts
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.region import find_region, recorded_region
from replay_kit.workflows.replay.inputs.scan import look_ahead, open_readers


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """What a replay has read before its first message.

    Attributes:
        job: Inputs and outputs.
        by_vehicle: The opened logs of each vehicle.
        forecasts: The forecast that the estimator is built from.
        prior_flow: The estimate before any observation.
        truth: What the estimate is scored against; None without.
        metadata: Records of the result: inputs, options, versions, region.
    """

    job: ReplayJob
    by_vehicle: Sequence[Sequence[LogReader]]
    forecasts: Forecasts
    prior_flow: FlowEstimate
    truth: Ensemble | None
    metadata: Mapping[str, Mapping[str, str]]

    @property
    def readers(self) -> list[LogReader]:
        """The opened logs."""
        return flat(self.by_vehicle)

    @property
    def owners(self) -> list[int]:
        """Of each log the number of its vehicle."""
        return [number for number, logs in enumerate(self.by_vehicle) for _ in logs]


def open_each(job: ReplayJob, config: RunConfig) -> list[list[LogReader]]:
    """Return the opened logs of each vehicle of a job, numbered through; as ``open_readers``."""
    each, number = list[list[LogReader]](), 0
    for vehicle in job.each_vehicle:
        each.append(open_readers(vehicle.logs, config))
        for log in each[-1]:
            log.input, number = number, number + 1
    return each


def flat(each: Sequence[Sequence[LogReader]]) -> list[LogReader]:
    """Return the logs of all vehicles."""
    return [log for logs in each for log in logs]


def copy_inputs(writer: ResultWriter, job: ReplayJob, config: LogConfig) -> None:
    """Copy the logs' messages unchanged into the result, if the job asks for it: of a telemetry log its frames."""
    if job.include_inputs:
        logs = open_logs(job.logs, config)
        writer.copy(
            message
            for log in logs
            for message in (log.frames() if log.has_own_frames else log.raw_messages())
        )


def forecasts_of(job: ReplayJob, config: RunConfig) -> Forecasts:
    """Return the part of a forecast that a job needs, at the time of its logs, and where it is asked for at their place.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: The ensemble is to be placed at the log, and the log holds no position in the span.
        ForecastError: The ensemble cannot be used.
        ConfigError: An estimator that knows no time is asked for what needs it.
    """
    place_at, near_ns = look_ahead(job.logs, config)
    region = (
        job.region
        or recorded_region(job.checkpoint)
        or find_region(job.logs, job.ensemble, config, near_ns, job.goals, not job.vehicles)
    )
    return read_forecasts(job.ensemble, config, near_ns, place_at, region)


def open_truth(
    job: ReplayJob,
    config: RunConfig,
    near_ns: int | None,
    ensemble: Ensemble,
    region: Region | None = None,
) -> Ensemble | None:
    """Return the truth of a job; None without one.

    Args:
        job: The replay.
        config: Its settings; a truth need not have the forecast's leads or times.
        near_ns: Time of the logs' first message [ns, UTC].
        ensemble: The forecast; if it was moved, the truth is moved to the same place.
        region: The part of it that is read; None for what the settings state.

    Raises:
        ForecastError: It cannot be read.
    """
    if job.truth is None:
        return None
    centre = ensemble.grid.projection
    part = (
        config.forecast if region is None else config.forecast.model_copy(update={"region": region})
    )
    settings = part.model_copy(update={"lead": None, "reference_time": None, "time": None})
    place_at = (centre.longitude, centre.latitude) if config.forecast.place else None
    try:
        return read_truth(job.truth, part, near_ns=near_ns, place_at=place_at)
    except ForecastError:
        return read_truth(job.truth, settings, near_ns=near_ns, place_at=place_at)
