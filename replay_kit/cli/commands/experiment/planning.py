"""``experiment planning``: plans made on estimates, flown in truths that the estimates do not know."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.experiment.truths import (
    ESTIMATOR,
    FOLDER,
    OneTruth,
    folder,
    name_page,
    parts,
)
from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import EstimatorError
from replay_kit.core.paths import check_folder, check_paths

if TYPE_CHECKING:
    from replay_kit.studies.planning import PlanningJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Truths(OneTruth):
    """The ensemble and its truths."""

    leave_out: Annotated[
        str | None,
        option(
            "--leave-out",
            "Members that are withheld as truths. Default: 20 evenly spread.",
            metavar="K,K,...|all",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """What is planned, and how many of each."""

    study: Annotated[
        str | None,
        parts("glides, missions, odds"),
    ] = None
    pairs: Annotated[
        int,
        option(
            "--pairs",
            "Number of starts and goals of glides, missions and odds, over all truths.",
            least=1,
        ),
    ] = 100
    pings: Annotated[int, option("--pings", "Number of pings of each estimate.", least=1)] = 450
    legs: Annotated[int, option("--legs", "Number of dives of a mission.", least=1)] = 10
    fresh: Annotated[
        int, option("--fresh", "Number of fresh samples that odds are compared with.", least=1)
    ] = 500
    noise: Noise = 0.09
    seed: Annotated[int, option("--seed", "Seed of everything that is drawn.", least=0)] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path, folder("a page, report, tables and pictures"), FOLDER]


@takes_settings(*PART_OF_FORECAST, "estimator", without=ESTIMATOR)
def planning(
    *,
    truths: Annotated[Truths, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    sizes: Annotated[Sizes, TO_OPTIONS] = Sizes(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
) -> int:
    """Return 0.

    Raises:
        EstimatorError: Every part of the study failed.
    """
    read, out = [*truths.files, settings.file], outputs.out
    check_folder(out)
    check_paths(read, [outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.studies import planning as study
    from replay_kit.workflows.fleet.workers import calls_made_by

    chosen = tuple(study.STUDIES if sizes.study is None else sizes.study.split(","))
    check_paths(read, [*study.replaced_files(out, chosen), outputs.json_file], outputs.overwrite)
    job = _job(chosen, truths, sizes)
    # before anything is read or made
    job.check(study.STUDIES)
    members, withheld = truths.read(config.forecast)
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in study.run_planning(members, withheld, config.estimator, job, advance):
            # made before the first study, so that a folder that cannot be made is reported at once
            out.mkdir(exist_ok=True)
            if result.reports:
                study.write_planning(out, result)
    console = console_beside(outputs.json_file)
    study.print_planning(result, console)
    console.print(
        f"{out}: report.md, planning.json, tables as CSV, pictures as PNG", soft_wrap=True
    )
    name_page(console, out)
    write_json(outputs.json_file, study.to_json(result))
    if all(report.failed for report in result.reports):
        raise EstimatorError(
            f"experiment planning: every study failed, the first with {result.reports[0].failed}"
        )
    return 0


def _job(chosen: tuple[str, ...], truths: Truths, sizes: Sizes) -> "PlanningJob":
    """Return the job of some studies."""
    from replay_kit.studies import planning as study

    return study.PlanningJob(
        chosen,
        truths.leave_out,
        sizes.pairs,
        sizes.pings,
        sizes.noise,
        sizes.legs,
        fresh=sizes.fresh,
        seed=sizes.seed,
    )
