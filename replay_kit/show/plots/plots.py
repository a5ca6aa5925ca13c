"""The figures of a result by their names, for scripts and for the command line."""

from collections.abc import Callable, Mapping
from functools import partial, partialmethod
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from replay_kit.core.errors import ConfigError
from replay_kit.core.plan import ORIGIN
from replay_kit.core.quantities import parse_time
from replay_kit.results.result import ResultFile
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.results.views.track import LastPlan
from replay_kit.show.figures.in_print import drawing_of
from replay_kit.show.figures.map_layers import hazard_layer, plan_layer, surfacing_layer
from replay_kit.show.figures.on_canvas import Extent
from replay_kit.show.figures.plan import profile_chart
from replay_kit.show.plots.charts import dive_panels, section_panels, series_panels, trust_panels
from replay_kit.show.plots.current_map import (
    ABOVE_KEY,
    draw_layers,
    draw_seabed,
    draw_speed,
    frame,
    map_panels,
    show_extent,
    slices_at,
    without_current,
)
from replay_kit.show.plots.panel import WIDTHS, Chosen, Panel, Panels, compose, missing
from replay_kit.show.sentences import energy_sentence, odds_sentence


def plan_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return the last plan on a map, and its depth along its way.

    Args:
        contents: Of the result.
        chosen: Depth of the map's current.
    """
    plan, notes = contents.last_plan, list(contents.notes)
    if plan is None:
        why = (contents.outcome.plan or {}).get("message", "no goal was given, or none was due")
        return Panels(
            [
                missing(
                    "Plan",
                    f"The result holds no plan: {why}; replay-kit plan makes one on this estimate.",
                )
            ],
            1,
            notes,
        )
    if not len(plan.track):
        notes.append(f"The last plan has no track: {plan.row['message']}.")
    else:
        notes.append(_in_words(plan.row))
        notes += _figures_in_words(plan)
    slices, around = slices_at(contents, chosen), _around(plan)
    east, north = 1e3 * np.array(around.ends).reshape(2, 2)
    notes += [] if slices is None else without_current(slices, (east, north))
    panels = [
        Panel(
            f"last plan: {plan.row['status']}",
            partial(_map, contents, slices, around),
            0.85,
            True,
            ABOVE_KEY,
        )
    ]
    if len(plan.track):
        draw = drawing_of(profile_chart(contents, plan), 0)
        panels.append(Panel("depth along the plan", draw, 0.85, True, ABOVE_KEY))
    return Panels(panels, 2, notes)


def _figures_in_words(plan: LastPlan) -> list[str]:
    """Return how the vehicle dives where that was not stated, energy and odds of a plan, as far as the result holds them."""
    out = [f"Dives {plan.statistics[ORIGIN]}."] if ORIGIN in plan.statistics else []
    if plan.energy is not None:
        out.append(f"Energy {energy_sentence(plan.energy, plan.battery)}.")
    if plan.odds is not None:
        out.append(f"{odds_sentence(plan.odds)}.")
    return out


def _in_words(plan: Any) -> str:
    if not np.isfinite(plan["heading_deg"]):
        return f"{str(plan.name)[:16]} UTC: nothing to steer: {plan['message']}."
    steer = f"heading {plan['heading_deg']:.0f}° true, glide angle {plan['glide_angle_deg']:.1f}°, {plan['duration'] / 3600.0:.1f} h"
    return (
        f"{str(plan.name)[:16]} UTC: {steer}, misses the goal by {plan['closest_approach']:.0f} m."
    )


def _around(plan: LastPlan) -> Extent:
    """Return the extent around a plan."""
    places = np.vstack([np.column_stack([plan.east, plan.north]), plan.start, plan.goal]) / 1e3
    return Extent.around(places[:, 0], places[:, 1], 0.15)


def _map(contents: Contents, slices: CurrentSlices | None, around: Extent, axes: Axes) -> None:
    if slices is not None:
        draw_speed(contents, slices, axes, 1e3 * (around.east - around.west))
    show_extent(contents, axes, around)
    limits = {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
    draw_seabed(contents, axes)
    draw_layers(
        contents, axes, hazard_layer(contents), plan_layer(contents), surfacing_layer(contents)
    )
    axes.set(**limits)
    frame(axes)


#: Each figure by its name.
KINDS: Mapping[str, Callable[[Contents, Chosen], Panels]] = MappingProxyType(
    {
        "map": map_panels,
        "section": section_panels,
        "series": series_panels,
        "dac": dive_panels,
        "trust": trust_panels,
        "plan": plan_panels,
    }
)


_FREE = Chosen()
# The figures that have a place, a depth, a time of the current.
_HAVE = {"at": ("map", "series", "plan"), "depth": ("map", "plan"), "time": ("map",)}


def drawn(contents: Contents, kind: str, chosen: Chosen = _FREE, columns: int = 2) -> Figure:
    """Return a figure of a result.

    Args:
        contents: Of the result.
        kind: One of ``KINDS``.
        chosen: Place, depth and time.
        columns: 1 or 2, of a page, for the figure's width.

    Raises:
        ConfigError: The figure is not known, or has no such place, depth or time, or the number of columns is another.
    """
    if kind not in KINDS:
        raise ConfigError(f"figure: expected one of {', '.join(KINDS)}, got '{kind}'")
    if columns not in WIDTHS:
        raise ConfigError(f"columns: expected 1 or 2, got {columns!r}")
    check_chosen(kind, chosen)
    return compose(KINDS[kind](contents, chosen), columns)


def check_chosen(kind: str, chosen: Chosen) -> None:
    """Raise ConfigError for a place, a depth or a time that a figure does not have."""
    for name, value in (("at", chosen.at), ("depth", chosen.depth), ("time", chosen.time_ns)):
        if value is not None and kind not in _HAVE[name]:
            raise ConfigError(
                f"--{name}: the figure {kind} has none; {', '.join(_HAVE[name])} would obey it"
            )
    if chosen.at is not None and chosen.depth is not None:
        raise ConfigError("--depth: --at states a depth already; leave one of them out")


class Plots:
    """The figures of a result; each returns a matplotlib figure.

    Each takes ``ax``, axes of your own into which one panel is drawn (``panel`` counts from 0), and ``columns``, 1 or 2, for the width of a
    journal's column or of two; ``map``, ``series`` and ``plan`` also ``at``, longitude, latitude [degrees] and depth [m], ``map`` and
    ``plan`` ``depth`` [m], and ``map`` ``time``, ISO 8601, after which nothing is shown.
    """

    def __init__(self, result: ResultFile) -> None:
        """Prepare the figures of a result; nothing is read yet."""
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
    ) -> Figure:
        chosen = Chosen(**place, time_ns=None if time is None else parse_time(time))
        check_chosen(kind, chosen)
        if ax is None:
            return drawn(self._contents, kind, chosen, columns)
        panels = KINDS[kind](self._contents, chosen).panels
        if not 0 <= panel < len(panels):
            raise ConfigError(
                f"panel: expected 0 to {len(panels) - 1}, got {panel}; {kind} has {len(panels)} here"
            )
        panels[panel].draw_into(ax)
        figure = ax.get_figure(root=True)
        assert figure is not None  # axes belong to a figure
        return figure

    map = partialmethod(_figure, "map")
    section = partialmethod(_figure, "section")
    series = partialmethod(_figure, "series")
    dac = partialmethod(_figure, "dac")
    trust = partialmethod(_figure, "trust")
    plan = partialmethod(_figure, "plan")
