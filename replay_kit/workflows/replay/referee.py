"""The forecast referee: the same log under other forecasts, with the same settings; what it was likely under each."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.paths import Paths
from replay_kit.forecast import ensemble_files
from replay_kit.results.outcome.run import ReplaySummary, Rival
from replay_kit.workflows.replay.inputs.job import Against, ReplayJob

#: Begin the keys of the rivals' files among the inputs.
RIVAL = "against"


def check_against(job: ReplayJob) -> None:
    """Check that other forecasts can be compared.

    Raises:
        ConfigError: The logs are followed, or two forecasts are the same files.
        ForecastError: A file is missing.
    """
    if job.against and job.following is not None:
        raise ConfigError(
            "--against: expected a finished log, got one that is followed; compare forecasts when it has ended"
        )
    seen = {tuple(sorted(path.resolve() for path in ensemble_files(job.ensemble)))}
    for each in job.against:
        if missing := [path for path in ensemble_files(each) if not path.exists()]:
            raise ForecastError(f"{missing[0]}: file not found; check --against")
        files = tuple(sorted(path.resolve() for path in ensemble_files(each)))
        if files in seen:
            raise ConfigError(
                f"--against: expected another ensemble each time, got {name_of(each)} again; give each once"
            )
        seen.add(files)


def rivals(job: ReplayJob, run: Callable[[ReplayJob], ReplaySummary]) -> Iterator[Rival]:
    """Yield the evidence of a job's log under each of the other forecasts.

    Args:
        job: The run that they are compared with.
        run: Replays a job.

    Raises:
        ForecastError: The estimate from one states no density of the measurements.
    """
    for each in job.against:
        name = name_of(each)
        alone = replace(
            job,
            ensemble=each,
            out=None,
            goal=None,
            netcdf=None,
            save_estimate=None,
            truth=None,
            checkpoint=None,
            region=None,
            against=(),
        )
        evidence = run(alone).evidence
        if evidence is None:
            raise ForecastError(
                f"{name}: this estimator states no density of the measurements, so there is no evidence to compare"
            )
        yield Rival(name, evidence)


def name_of(ensemble: Paths) -> str:
    """Return the name of an ensemble's file, without its folder; of several the first one's and their number."""
    files = ensemble_files(ensemble)
    return files[0].name if len(files) == 1 else f"{files[0].name} and {len(files) - 1} more"


def rival_inputs(against: Sequence[Against]) -> dict[str, Path]:
    """Return the files of other forecasts by the keys of a result's inputs: ``against0``, or ``against0_1`` of several."""
    out: dict[str, Path] = {}
    for number, each in enumerate(against):
        files = ensemble_files(each)
        out |= {
            f"{RIVAL}{number}" if len(files) == 1 else f"{RIVAL}{number}_{i}": path
            for i, path in enumerate(files)
        }
    return out
