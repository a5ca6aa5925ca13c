"""``smooth``: the estimate at each time from the measurements before and after it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.fetch import with_local_forecast
from replay_kit.cli.console import console_beside, part_named, progress, write_json
from replay_kit.cli.options import MCAP, TO_INPUTS, TO_OUTPUTS, Answer, Ensemble, Log, option
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """What is smoothed."""

    ensemble: Ensemble


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path,
        option(
            "--out -o", "Result, for any MCAP viewer, plot, export and report.", metavar="OUT.mcap"
        ),
        MCAP,
    ]


@takes_settings("logs", "measurements", "forecast", "estimator", "time", "gating", "output")
def smooth(
    *logs: Log,
    inputs: Annotated[Inputs, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    settings: Settings,
) -> int:
    """Return the exit code of the summary."""
    check_paths(
        (*logs, *inputs.ensemble, settings.file),
        (outputs.out, outputs.json_file),
        outputs.overwrite,
    )
    config = settings.load()

    from replay_kit.results.outcome.from_run import outcome_of
    from replay_kit.show.summary import print_summary
    from replay_kit.workflows.replay.inputs.job import ReplayJob, check_outputs
    from replay_kit.workflows.smooth import smooth as smooth_logs

    job = ReplayJob(logs, inputs.ensemble, outputs.out, overwrite=outputs.overwrite)
    job = with_local_forecast(job, config)
    check_outputs(job, also_read=[settings.file], also_written=[outputs.json_file])
    with part_named(outputs.out), progress() as advance:
        summary = smooth_logs(job, config, advance)
    outcome = outcome_of(summary)
    print_summary(outcome, console_beside(outputs.json_file), outputs.verbose)
    write_json(outputs.json_file, outcome.to_json())
    return summary.exit_code
