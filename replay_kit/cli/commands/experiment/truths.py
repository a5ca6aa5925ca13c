"""Options that studies share: the truths, the folder of the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from replay_kit.cli.options import Ending, Ensemble, Truth, option
from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import truth_path

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.core.grid import Ensemble as Members

FOLDER = Ending()


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


def existing(out: Path | None, names: Sequence[str]) -> list[Path]:
    """Return those files of a study that its folder has already."""
    return [] if out is None else [path for path in map(out.joinpath, names) if path.exists()]


def name_page(console: "Console", out: Path | None) -> None:
    """Name the page of a study, where a folder is written."""
    if out is not None:
        console.print(f"Page: {out / 'index.html'}; open it in a browser.", soft_wrap=True)


# Settings that the estimators of these studies have; name and preset are those that a study compares.
ESTIMATOR = {"estimator.name", "estimator.preset"}


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
