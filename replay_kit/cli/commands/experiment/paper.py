"""``experiment paper``: the study of Kong et al. (IROS 2021) on an ensemble."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.experiment.truths import FOLDER, OneTruth, existing, folder, name_page
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_folder, check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path, folder("a page, tables, figures and report"), FOLDER]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """How much is computed."""

    modes: Annotated[
        str | None,
        option(
            "--modes",
            "Most modes per level anywhere. Default: tables to the full rank, plans on 300; all: plans on it too.",
            metavar="N|all",
        ),
    ] = None
    pairs: Annotated[
        int, option("--pairs", "Number of starts and targets of the glides.", least=1)
    ] = 100
    seed: Annotated[
        int, option("--seed", "Seed of places, noise, starts and targets.", least=0)
    ] = 0


@takes_settings(*PART_OF_FORECAST, file=False)
def paper(
    *,
    truths: Annotated[OneTruth, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    sizes: Annotated[Sizes, TO_OPTIONS] = Sizes(),
) -> int:
    """Return 0."""
    truths.check("paper")
    out = outputs.out
    check_folder(out)
    check_paths(truths.files, [outputs.json_file], outputs.overwrite)
    config = settings.load(estimator={"modes": sizes.modes})

    from replay_kit.studies.paper import (
        FILES,
        PaperJob,
        print_paper,
        run_paper,
        to_json,
        write_paper,
    )
    from replay_kit.workflows.fleet.workers import calls_made_by

    check_paths(truths.files, [*existing(out, FILES), outputs.json_file], outputs.overwrite)
    most = None if sizes.modes is None else config.estimator.modes
    job = PaperJob(
        leave_out=truths.leave_out,
        most_modes=most,
        plan_modes=config.estimator.modes,
        pairs=sizes.pairs,
        seed=sizes.seed,
    )
    members, withheld = truths.read(config.forecast)
    # made before the work, so that a folder that cannot be made is reported at once
    out.mkdir(exist_ok=True)
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for tables, shown in run_paper(members, withheld, config.estimator, job, advance):
            write_paper(out, tables, shown)
            keep_json(outputs.json_file, to_json(tables))
    console = console_beside(outputs.json_file)
    print_paper(tables, console)
    console.print(
        f"{out}: report.md, paper.json, tables as CSV, figures as PNG and SVG", soft_wrap=True
    )
    name_page(console, out)
    write_json(outputs.json_file, to_json(tables))
    return 0
