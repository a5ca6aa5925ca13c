"""A result as a notebook holds it: its estimate, its tables, and its figures, which are drawn of these."""

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.result import ResultFile, result_path
from replay_kit.results.views.record import outcome_of_result, read_record

if TYPE_CHECKING:
    from replay_kit.show.plots import Plots


class Result(ResultFile):
    """What a replay found: its estimate and tables (see ``ResultFile``), and its figures."""

    @cached_property
    def outcome(self) -> Outcome:
        """What the run found and how far to trust it: counts, fit, verdict, plan, surfacings, contradictions, losses."""
        return outcome_of_result(self, read_record(self.path))

    @cached_property
    def plot(self) -> "Plots":
        """Figures for a paper: ``map``, ``section``, ``series``, ``dac``, ``trust`` and ``plan``, each a function."""
        # here, because matplotlib takes half a second to load
        from replay_kit.show.plots import Plots

        return Plots(self)


def open_result(path: str | Path) -> Result:
    """Return a result that ``replay`` wrote, with its estimate and tables; they are read when first asked for.

    Raises:
        LogError: The file is missing, or is no complete result.
        ConfigError: The path is neither text nor a ``Path``.
    """
    return Result(result_path(path))
