"""The figures of a result by their names, for scripts and for the command line."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from replay_kit.core.errors import ConfigError
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.show.plots.charts import dive_panels, section_panels, series_panels, trust_panels
from replay_kit.show.plots.current_map import At, map_panels
from replay_kit.show.plots.panel import Panels, compose
from replay_kit.show.plots.plan import plan_panels
from replay_kit.show.plots.style import WIDTHS

#: Each figure by its name.
KINDS: Mapping[str, Callable[[Contents, At | None], Panels]] = MappingProxyType(
    {
        "map": map_panels,
        "section": section_panels,
        "series": series_panels,
        "dac": dive_panels,
        "trust": trust_panels,
        "plan": plan_panels,
    }
)


def drawn(contents: Contents, kind: str, at: At | None = None, columns: int = 2) -> Figure:
    """Return a figure of a result.

    Args:
        contents: Of the result.
        kind: One of ``KINDS``.
        at: Longitude, latitude [degrees] and depth [m] of ``map``, ``series`` and ``plan``; None chooses them.
        columns: 1 or 2, of a page, for the figure's width.

    Raises:
        ConfigError: The figure is not known, or the number of columns is another.
    """
    if kind not in KINDS:
        raise ConfigError(f"figure: expected one of {', '.join(KINDS)}, got '{kind}'")
    if columns not in WIDTHS:
        raise ConfigError(f"columns: expected 1 or 2, got {columns!r}")
    return compose(KINDS[kind](contents, at), columns)


class Plots:
    """The figures of a result; each returns a matplotlib figure.

    Each takes ``ax``, axes of your own into which one panel is drawn (``panel`` counts from 0), ``at``, longitude, latitude [degrees] and
    depth [m], and ``columns``, 1 or 2, for the width of a journal's column or of two.
    """

    def __init__(self, result: ResultFile) -> None:
        """Prepare the figures of a result; nothing is read yet."""
        self._contents = Contents(result)

    def map(
        self, ax: Axes | None = None, *, panel: int = 0, at: At | None = None, columns: int = 2
    ) -> Figure:
        """Return the current and its standard error at a depth, with the track."""
        return self._figure("map", ax, panel, at, columns)

    def section(self, ax: Axes | None = None, *, panel: int = 0, columns: int = 2) -> Figure:
        """Return measured, estimated, difference and standard error along the track, each eastward and northward."""
        return self._figure("section", ax, panel, None, columns)

    def series(
        self, ax: Axes | None = None, *, panel: int = 0, at: At | None = None, columns: int = 2
    ) -> Figure:
        """Return both components of the current at a place through time."""
        return self._figure("series", ax, panel, at, columns)

    def dac(self, ax: Axes | None = None, *, panel: int = 0, columns: int = 2) -> Figure:
        """Return the depth-averaged currents of the dives beside the estimate's."""
        return self._figure("dac", ax, panel, None, columns)

    def trust(self, ax: Axes | None = None, *, panel: int = 0, columns: int = 2) -> Figure:
        """Return the innovations against their stated errors."""
        return self._figure("trust", ax, panel, None, columns)

    def plan(
        self, ax: Axes | None = None, *, panel: int = 0, at: At | None = None, columns: int = 2
    ) -> Figure:
        """Return the last plan on a map, and its depth."""
        return self._figure("plan", ax, panel, at, columns)

    def _figure(
        self, kind: str, ax: Axes | None, panel: int, at: At | None, columns: int
    ) -> Figure:
        if ax is None:
            return drawn(self._contents, kind, at, columns)
        panels = KINDS[kind](self._contents, at).panels
        if not 0 <= panel < len(panels):
            raise ConfigError(
                f"panel: expected 0 to {len(panels) - 1}, got {panel}; {kind} has {len(panels)} here"
            )
        panels[panel].draw_into(ax)
        figure = ax.get_figure(root=True)
        assert figure is not None  # axes belong to a figure
        return figure
