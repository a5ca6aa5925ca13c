"""Figures of a result by name, for scripts and the command line."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partialmethod
from types import MappingProxyType
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from replay_kit.core.errors import ConfigError
from replay_kit.core.words.quantities import parse_time
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.draw import compose, drawn_into
from replay_kit.show.figures.figure import WIDTHS, Figure
from replay_kit.show.figures.map import Chosen, map_figure, plan_figure
from replay_kit.show.figures.section import dives_figure, section_figure, series_figure
from replay_kit.show.figures.trust import trust_figure

#: Each figure by its name.
KINDS: Mapping[str, Callable[[Contents, Chosen], Figure]] = MappingProxyType(
    {
        "map": map_figure,
        "section": lambda contents, _: section_figure(contents),
        "series": lambda contents, chosen: series_figure(contents, chosen.at),
        "dac": lambda contents, _: dives_figure(contents),
        "trust": lambda contents, _: trust_figure(contents),
        "plan": plan_figure,
    }
)


_FREE = Chosen()
# The figures that have a place, a depth, a time of the current.
_HAVE = {"at": ("map", "series", "plan"), "depth": ("map", "plan"), "time": ("map",)}


def figure_data(contents: Contents, kind: str, chosen: Chosen = _FREE) -> Figure:
    """Return a figure of a result as data, with the notes on its opening.

    Args:
        contents: Contents of the result.
        kind: Name of a figure, one of ``KINDS``.
        chosen: Position, depth and time.

    Raises:
        ConfigError: Unknown figure, or an option that does not apply to it.
    """
    if kind not in KINDS:
        raise ConfigError(f"figure: expected one of {', '.join(KINDS)}, got '{kind}'")
    _check_chosen(kind, chosen)
    figure = KINDS[kind](contents, chosen)
    return replace(figure, notes=(*contents.notes, *figure.notes))


def drawn_figure(contents: Contents, kind: str, chosen: Chosen = _FREE, columns: int = 2) -> Canvas:
    """Return a figure of a result for a paper.

    Args:
        contents: See ``figure_data``.
        kind: See ``figure_data``.
        chosen: See ``figure_data``.
        columns: Width in columns of a page, 1 or 2.

    Raises:
        ConfigError: See ``figure_data``; or an unknown number of columns.
    """
    if columns not in WIDTHS:
        raise ConfigError(f"columns: expected 1 or 2, got {columns!r}")
    return compose(figure_data(contents, kind, chosen), columns)


def _check_chosen(kind: str, chosen: Chosen) -> None:
    """Raise ConfigError for a position, depth or time that does not apply to a figure."""
    for name, value in (("at", chosen.at), ("depth", chosen.depth), ("time", chosen.time_ns)):
        if value is not None and kind not in _HAVE[name]:
            raise ConfigError(f"--{name}: applies to {', '.join(_HAVE[name])}, not to {kind}")
    if chosen.at is not None and chosen.depth is not None:
        raise ConfigError("--depth: --at states a depth already; leave one of them out")


class Plots:
    """Figures of a result, each a method that returns a matplotlib figure.

    Common arguments: ``columns``, the width in journal columns (1 or 2); ``ax``, existing axes for panel number ``panel``, from 0.
    ``map``, ``series`` and ``plan`` accept ``at``: longitude, latitude [degrees] and depth [m]. ``map`` and ``plan`` accept ``depth`` [m].
    ``map`` accepts ``time``, ISO 8601: later data are not shown.
    """

    def __init__(self, result: ResultFile) -> None:
        """Prepare the figures of a result without reading data."""
        self._contents = Contents(result)

    def _figure(
        self,
        kind: str,
        ax: Axes | None = None,
        *,
        panel: int = 0,
        columns: int = 2,
        time: str | None = None,
        **place: Any,
    ) -> Canvas:
        chosen = Chosen(**place, time_ns=None if time is None else parse_time(time))
        if ax is None:
            return drawn_figure(self._contents, kind, chosen, columns)
        figure = figure_data(self._contents, kind, chosen)
        if not 0 <= panel < (count := len(figure.panels)):
            raise ConfigError(
                f"panel: expected 0 to {count - 1}, got {panel}; {kind} has {count} here"
            )
        drawn_into(ax, figure, panel)
        canvas = ax.get_figure(root=True)
        assert canvas is not None  # axes belong to a figure
        return canvas

    map = partialmethod(_figure, "map")
    section = partialmethod(_figure, "section")
    series = partialmethod(_figure, "series")
    dac = partialmethod(_figure, "dac")
    trust = partialmethod(_figure, "trust")
    plan = partialmethod(_figure, "plan")
