"""``verify`` and ``smooth``: a result made again, and one that uses later measurements too."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.ensemble import local_forecasts
from replay_kit.cli.console import console_beside, part_named, progress, write_json
from replay_kit.cli.options import (
    INPUTS,
    MCAP,
    TO_INPUTS,
    TO_OUTPUTS,
    Answer,
    Ensemble,
    Log,
    argument,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths


def verify(
    result: Annotated[Path, argument("OUT.mcap", "A result of replay or plan.")],
    /,
    *,
    inputs: Annotated[
        list[Path] | None,
        option(
            "--inputs",
            "Folder of the inputs; may be repeated. Default: the result's folder, then the current one.",
            metavar="DIR",
            group=INPUTS,
        ),
    ] = None,
    answer: Annotated[Answer, TO_OUTPUTS] = Answer(),
) -> int:
    """Return 0, 4 when part of the result was lost, or 5 when it could not be made again."""
    check_paths([result, *(inputs or ())], [answer.json_file], answer.overwrite)

    from replay_kit.workflows.planning.adapters import planner_of
    from replay_kit.workflows.planning.again import plan_again
    from replay_kit.workflows.sound import sound_result
    from replay_kit.workflows.verify import print_verdict, verdict_json
    from replay_kit.workflows.verify import verify as verify_result

    with progress() as advance, sound_result(result) as sound:
        folders = [*(inputs or ()), result.parent]
        verdict = verify_result(sound.path, folders, planner_of, advance, plan_again)
    verdict = replace(verdict, result=result, notes=(*sound.lines, *verdict.notes))
    print_verdict(verdict, console_beside(answer.json_file))
    write_json(answer.json_file, verdict_json(verdict))
    return sound.exit_code or (0 if verdict.same else 5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """What is smoothed."""

    ensemble: Ensemble


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothed(Answer):
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
    inputs: Annotated[Replayed, TO_INPUTS],
    outputs: Annotated[Smoothed, TO_OUTPUTS],
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
    (job,) = local_forecasts([(job, config)])
    check_outputs(job, also_read=[settings.file], also_written=[outputs.json_file])
    with part_named(outputs.out), progress() as advance:
        summary = smooth_logs(job, config, advance)
    outcome = outcome_of(summary)
    print_summary(outcome, console_beside(outputs.json_file), outputs.verbose)
    write_json(outputs.json_file, outcome.to_json())
    return summary.exit_code
