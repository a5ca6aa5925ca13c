"""``experiment paper``, the paper's study on any ensemble; and what commands of studies share: truths, folder, how one is run."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from cyclopts import Parameter

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
from replay_kit.config.run import ForecastConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_folder, check_paths, truth_path
from replay_kit.core.progress import Progress

if TYPE_CHECKING:
    from replay_kit.core.grid import Ensemble as Members
    from replay_kit.studies.reports.page import StudyReport


Result = TypeVar("Result")
# Settings that the estimators of these studies have; name and preset are those that a study compares.
ESTIMATOR = {"estimator.name", "estimator.preset"}


def folder(what: str) -> Parameter:
    """Return the option of the folder that a study writes."""
    return option("--out -o", f"Folder for {what}; made if absent.", metavar="DIR")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path | None, folder("a page, CSV and JSON"), Ending()] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Report(Answer):
    """What is written, a folder at least."""

    out: Annotated[Path, folder("a page, report and tables"), Ending()]


@dataclass(frozen=True, slots=True, kw_only=True)
class OneTruth:
    """The ensemble, and one truth of its own or members withheld."""

    ensemble: Ensemble
    truth: Truth = None
    leave_out: Annotated[
        str | None,
        option(
            "--leave-out",
            "Members that are withheld as truths.",
            metavar="K,K,...|all|most-distant",
        ),
    ] = None

    @property
    def files(self) -> list[Path | None]:
        """The files that are read."""
        return [*self.ensemble, truth_path(self.truth)]

    def check(self, study: str) -> None:
        """Raise ConfigError unless one of the two is given."""
        if (self.truth is None) == (self.leave_out is None):
            raise ConfigError(f"{study}: expected one of --truth and --leave-out")

    def read(self, config: ForecastConfig) -> "tuple[Members, Members | None]":
        """Return the ensemble, and the truth where it is one of its own."""
        from replay_kit.forecast import read_ensemble, read_truth

        return read_ensemble(self.ensemble, config), None if self.truth is None else read_truth(
            self.truth, config
        )


def check_outputs(
    read: Sequence[Path | None], outputs: Outputs | Report, written: Sequence[str]
) -> None:
    """Raise ConfigError where what a study writes cannot be written, or exists and may not be replaced.

    Args:
        read: Its inputs.
        outputs: What is asked for.
        written: Patterns of the names of the files in its folder.
    """
    out, existing = outputs.out, list[Path]()
    if out is not None:
        check_folder(out)
        existing = [path for pattern in written for path in sorted(out.glob(pattern))]
    check_paths(read, [*existing, outputs.json_file], outputs.overwrite)


def run_study(
    report_of: Callable[[Result], "StudyReport"],
    results: Callable[[Progress], Iterator[Result]],
    outputs: Outputs | Report,
    config: RunConfig,
    processes: Processes,
    notes: Sequence[str] = (),
) -> Result:
    """Run a study, write what is done after each part, print the whole result and return it.

    Args:
        report_of: Returns what a result says.
        results: Yields the results so far; takes what reports progress.
        outputs: Where it is written.
        config: Number of threads.
        processes: Who works.
        notes: On the inputs, printed first.
    """
    from replay_kit.workflows.fleet.workers import calls_made_by

    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in results(advance):
            report = report_of(result)
            if outputs.out is not None:
                outputs.out.mkdir(exist_ok=True)
                report.write(outputs.out)
            keep_json(outputs.json_file, report.answer)
    console = console_beside(outputs.json_file)
    for note in notes:
        console.print(f"Note: {note}")
    report.print(console)
    if outputs.out is not None:
        if report.beside:
            console.print(f"{outputs.out}: {report.beside}")
        console.print(f"Page: {outputs.out / 'index.html'}; open it in a browser.")
    write_json(outputs.json_file, report.answer)
    return result


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperSizes:
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
    outputs: Annotated[Report, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    sizes: Annotated[PaperSizes, TO_OPTIONS] = PaperSizes(),
) -> int:
    """Return 0."""
    truths.check("experiment paper")
    config = settings.load(estimator={"modes": sizes.modes})

    from replay_kit.studies.paper.page import FILES, report_of
    from replay_kit.studies.paper.run import PaperJob, run_paper

    check_outputs(truths.files, outputs, FILES)
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
    run_study(
        report_of,
        lambda advance: run_paper(members, withheld, config.estimator, job, advance),
        outputs,
        config,
        processes,
    )
    return 0
