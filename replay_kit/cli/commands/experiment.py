"""``experiment paper``: the study of the paper for any ensemble."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import keep_json, progress
from replay_kit.cli.options import (
    INPUTS,
    PART_OF_FORECAST,
    TO_OPTIONS,
    Answer,
    Ending,
    Ensemble,
    Processes,
    Truth,
    option,
    output,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_folder, truth_path


@TO_OPTIONS
@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSizes:
    """Sizes of the study.

    Attributes:
        modes: Most modes per level anywhere. Default: tables to the full rank, plans on 300; all: plans on it too.
        pairs: Number of starts and targets of the glides.
        seed: Seed of places, noise, starts and targets.
    """

    modes: Annotated[str | None, option("N|all")] = None
    pairs: Annotated[int, option(least=1)] = 100
    seed: Annotated[int, option(least=0)] = 0


@takes_settings(*PART_OF_FORECAST, file=False)
def paper(
    *,
    ensemble: Ensemble,
    truth: Truth = None,
    leave_out: Annotated[str | None, option("K,K,...|all|most-distant", group=INPUTS)] = None,
    out: Annotated[Path, output("DIR"), Ending()],
    answer: Answer = Answer(),
    settings: Settings,
    processes: Processes = Processes(),
    sizes: PaperSizes = PaperSizes(),
) -> int:
    """Return exit code 0.

    Args:
        leave_out: Members withheld as truths.
        out: Folder for a page, report and tables; made if absent.
    """
    if (truth is None) == (leave_out is None):
        raise ConfigError("experiment paper: expected one of --truth and --leave-out")
    config = settings.load(estimator={"modes": sizes.modes})

    check_folder(out)

    from replay_kit.core.files.atomic import write_whole
    from replay_kit.forecast import read_ensemble, read_truth
    from replay_kit.show.text import print_table
    from replay_kit.studies.paper.page import FILES, PAGE, files_of, text_tables, to_json
    from replay_kit.studies.paper.run import PaperJob, run_paper
    from replay_kit.workflows.fleet.cluster import calls_made_by

    answer.check(
        [*ensemble, truth_path(truth)], *(out / name for name in FILES if (out / name).exists())
    )
    most = None if sizes.modes is None else config.estimator.modes
    job = PaperJob(
        leave_out=leave_out,
        most_modes=most,
        plan_modes=config.estimator.modes,
        pairs=sizes.pairs,
        seed=sizes.seed,
    )
    members = read_ensemble(ensemble, config.forecast)
    withheld = None if truth is None else read_truth(truth, config.forecast)
    # at once, so that a folder that cannot be made is reported before the work
    out.mkdir(exist_ok=True)
    with calls_made_by(processes.scheduler, processes.workers), progress(config.output.threads):
        for tables in run_paper(members, withheld, config.estimator, job):
            for name, text in files_of(tables).items():
                write_whole(out / name, text)
            keep_json(answer.json_file, to_json(tables))
    console = answer.console()
    for title, rows in text_tables(tables):
        print_table(console, title, list(rows[0]), [list(row.values()) for row in rows])
    console.print(f"{out}: report.md, paper.json, tables as CSV")
    console.print(f"Page: {out / PAGE}; open it in a browser.")
    answer.write(to_json(tables))
    return 0
