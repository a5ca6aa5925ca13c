"""Results in notebooks: estimate, tables, figures, and the parts of several vehicles."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from itertools import chain
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING

from replay_kit.results.innovations import Columns
from replay_kit.results.mcap.topics import OpenResult
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import check_result
from replay_kit.results.result import ResultFile

if TYPE_CHECKING:
    import pandas as pd

    from replay_kit.show.figures.kinds import Plots


class Result(ResultFile):
    """Result of a replay: estimate and tables (see ``ResultFile``), and figures."""

    @cached_property
    def vehicles(self) -> Mapping[str, "Result"]:
        """Results by name of several vehicles that share the estimate; empty for a single vehicle."""
        made, file = self.made, self.reader.file
        return {
            one.name: Result(self.path, made and made.vehicles.get(one.name), one.name, file)
            for one in self.reader.vehicles
            if not one.why_not
        }

    @cached_property
    def plot(self) -> "Plots":
        """Figures for papers: methods ``map``, ``section``, ``series``, ``dac``, ``trust`` and ``plan``."""
        # here, because matplotlib takes half a second to load
        from replay_kit.show.figures.kinds import Plots

        return Plots(self)


def read_result(
    path: Path, made: Outcome | None = None, opened: OpenResult | None = None
) -> Result:
    """Return a result written by ``replay``; tables are read on first access.

    The arguments are described in ``ResultFile``.

    Raises:
        LogError: The file is missing or not a complete result.
    """
    result = Result(path, made, opened=opened)
    check_result(result.reader)
    return as_pooled(result)


def as_pooled(result: Result) -> Result:
    """Return a result; for several vehicles with pooled tables."""
    if not result.reader.vehicles:
        return result
    return Pooled(result.path, result.made, opened=result.reader.file)


class Pooled(Result):
    """Pooled result of several vehicles: common estimate, and tables with a column ``vehicle``."""

    def joined(self, name: str) -> "pd.DataFrame":
        """Return a table of all vehicles; dives are numbered by vehicle."""
        import pandas as pd

        tables = [
            getattr(one, name).assign(vehicle=vehicle) for vehicle, one in self.vehicles.items()
        ]
        held = [table for table in tables if len(table)]
        return pd.concat(held) if held else tables[0]

    def blocks(self) -> Iterator[Columns]:
        """Yield the blocks of each vehicle in order."""
        return chain.from_iterable(one.blocks() for one in self.vehicles.values())


for _name in (
    *("fixes", "observations", "innovations", "dives"),
    *("plans", "plan_tracks", "surfacings", "events"),
):
    setattr(Pooled, _name, property(methodcaller("joined", _name)))
