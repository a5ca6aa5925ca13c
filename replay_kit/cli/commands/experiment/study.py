"""What the commands of all studies share: the truths, the output folder, and how a study is run and written."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol, TypeVar

from cyclopts import Parameter

from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import Answer, Ending, Ensemble, Processes, Truth, option
from replay_kit.config.run import ForecastConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_folder, check_paths, truth_path
from replay_kit.core.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.core.grid import Ensemble as Members

Result = TypeVar("Result")
_Written = TypeVar("_Written", contravariant=True)
# Settings that the estimators of these studies have; name and preset are those that a study compares.
ESTIMATOR = {"estimator.name", "estimator.preset"}


class StudyPage(Protocol[_Written]):
    """The module ``page`` of a study."""

    def write_study(self, out: Path, result: _Written) -> None:
        """Write a result, or the part of it that is done, into a folder that exists."""

    def print_study(self, result: _Written, console: "Console") -> None:
        """Print a result for people."""

    def to_json(self, result: _Written) -> dict[str, Any]:
        """Return a result as a JSON object."""


def parts(names: str) -> Parameter:
    """Return the option that chooses parts of a study."""
    return option(
        "--study",
        f"Parts of the study: {names}. Default: all that are possible.",
        metavar="S1,S2,...",
    )


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

    out: Annotated[Path, folder("a page, report, tables and figures"), Ending()]


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
            raise ConfigError(f"experiment {study}: expected one of --truth and --leave-out")

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
    page: StudyPage[Result],
    results: Callable[[Progress], Iterator[Result]],
    outputs: Outputs | Report,
    config: RunConfig,
    processes: Processes,
    notes: Sequence[str] = (),
    beside: str = "",
) -> Result:
    """Run a study, write what is done after each part, print the whole result and return it.

    Args:
        page: Writes it.
        results: Yields the results so far; takes what reports progress.
        outputs: Where it is written.
        config: Number of threads.
        processes: Who works.
        notes: On the inputs, printed first.
        beside: What is in the folder beside the page.
    """
    from replay_kit.workflows.fleet.workers import calls_made_by

    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in results(advance):
            if outputs.out is not None:
                outputs.out.mkdir(exist_ok=True)
                page.write_study(outputs.out, result)
            keep_json(outputs.json_file, page.to_json(result))
    console = console_beside(outputs.json_file)
    for note in notes:
        console.print(f"Note: {note}", soft_wrap=True)
    page.print_study(result, console)
    if beside:
        console.print(f"{outputs.out}: {beside}", soft_wrap=True)
    if outputs.out is not None:
        console.print(f"Page: {outputs.out / 'index.html'}; open it in a browser.", soft_wrap=True)
    write_json(outputs.json_file, page.to_json(result))
    return result
