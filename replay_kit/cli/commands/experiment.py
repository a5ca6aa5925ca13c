"""``experiment paper``: the study of the paper for any ensemble."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ending,
    Ensemble,
    Processes,
    Truth,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_folder, check_paths, truth_path

if TYPE_CHECKING:
    from replay_kit.core.grid import Ensemble as Members


@dataclass(frozen=True, slots=True, kw_only=True)
class Report(Answer):
    """Output folder of a study.

    Attributes:
        out: Folder for a page, report and tables; made if absent.
    """

    out: Annotated[Path, option("DIR", alias="-o"), Ending()]


@dataclass(frozen=True, slots=True, kw_only=True)
class OneTruth:
    """Ensemble with a separate truth or with withheld members.

    Attributes:
        leave_out: Members withheld as truths.
    """

    ensemble: Ensemble
    truth: Truth = None
    leave_out: Annotated[str | None, option("K,K,...|all|most-distant")] = None

    @property
    def files(self) -> list[Path | None]:
        """Files read."""
        return [*self.ensemble, truth_path(self.truth)]

    def check(self, study: str) -> None:
        """Raise ConfigError unless either a truth or withheld members are given."""
        if (self.truth is None) == (self.leave_out is None):
            raise ConfigError(f"{study}: expected one of --truth and --leave-out")

    def read(self, config: ForecastConfig) -> "tuple[Members, Members | None]":
        """Return the ensemble and the separate truth, if any."""
        from replay_kit.forecast import read_ensemble, read_truth

        return read_ensemble(self.ensemble, config), None if self.truth is None else read_truth(
            self.truth, config
        )


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
    truths: Annotated[OneTruth, TO_INPUTS],
    outputs: Annotated[Report, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    sizes: Annotated[PaperSizes, TO_OPTIONS] = PaperSizes(),
) -> int:
    """Return exit code 0."""
    truths.check("experiment paper")
    config = settings.load(estimator={"modes": sizes.modes})

    check_folder(outputs.out)

    from replay_kit.core.files.atomic import write_whole
    from replay_kit.show.text import print_table
    from replay_kit.studies.paper.page import FILES, PAGE, files_of, text_tables, to_json
    from replay_kit.studies.paper.run import PaperJob, run_paper
    from replay_kit.workflows.fleet.cluster import calls_made_by

    existing = [outputs.out / name for name in FILES if (outputs.out / name).exists()]
    check_paths(truths.files, [*existing, outputs.json_file], outputs.overwrite)
    most = None if sizes.modes is None else config.estimator.modes
    job = PaperJob(
        leave_out=truths.leave_out,
        most_modes=most,
        plan_modes=config.estimator.modes,
        pairs=sizes.pairs,
        seed=sizes.seed,
    )
    members, withheld = truths.read(config.forecast)
    # at once, so that a folder that cannot be made is reported before the work
    outputs.out.mkdir(exist_ok=True)
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads),
    ):
        for tables in run_paper(members, withheld, config.estimator, job):
            for name, text in files_of(tables).items():
                write_whole(outputs.out / name, text)
            keep_json(outputs.json_file, to_json(tables))
    console = console_beside(outputs.json_file)
    for title, rows in text_tables(tables):
        print_table(console, title, list(rows[0]), [list(row.values()) for row in rows])
    console.print(f"{outputs.out}: report.md, paper.json, tables as CSV")
    console.print(f"Page: {outputs.out / PAGE}; open it in a browser.")
    write_json(outputs.json_file, to_json(tables))
    return 0
