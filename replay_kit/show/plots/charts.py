"""Figures whose panels are charts: mean currents of dives, trust, the series at a place, the section along the track."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.arrays import Array
from replay_kit.core.colors import PRINT
from replay_kit.core.text import place_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.history import Series, typical_depth
from replay_kit.show.figures.along_track import (
    COMPONENTS,
    gridded,
    mean_current_chart,
)
from replay_kit.show.figures.in_print import date_axis, drawing_of
from replay_kit.show.figures.trust import trust_charts
from replay_kit.show.figures.values import Axis, Chart, Mark
from replay_kit.show.figures.values import Panel as Drawn
from replay_kit.show.plots.panel import Chosen, Panel, Panels, colorbar, colormap, missing


def dive_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return the depth-averaged currents of the dives, measured, corrected and estimated, through time.

    Args:
        contents: Of the result.
        chosen: Not used: the currents are those of the dives.
    """
    means, notes = contents.mean_currents, list(contents.notes)
    if means.time_ns.size == 0:
        why = "The result holds no mean current of a dive: its vehicle does not dive, or the log has none that was used."
        return Panels([missing("Depth-averaged currents of dives", why)], 1, notes)
    chart = mean_current_chart(means)
    panels = [
        Panel(panel.title, drawing_of(chart, k), 0.55) for k, panel in enumerate(chart.panels)
    ]
    if not np.isfinite(means.estimated).any():
        notes.append(
            "The result holds no estimate: the figure shows measured minus estimated currents."
        )
    return Panels(panels, 2, notes)


# Panel of each chart that a paper needs.
_SHOWN = {"dives": 0, "innovations": 1, "calibration": 0, "error": 0}


def trust_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return what tells whether the estimate's stated errors hold.

    Args:
        contents: Of the result.
        chosen: Not used: all measurements count.
    """
    notes = list(contents.notes)
    if not contents.measured.count:
        why = "The result holds no measurement to compare the estimate with."
        return Panels([missing("Innovations", why)], 1, notes)
    charts, lacking = trust_charts(contents)
    shown = [(charts[key], number) for key, number in _SHOWN.items() if key in charts]
    panels = [
        Panel(chart.panels[number].title, drawing_of(chart, number), 0.6) for chart, number in shown
    ]
    return Panels(panels, 2, [*notes, *lacking])


_COMPONENTS = {"u": "eastward", "v": "northward"}


def series_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return both components of the current at a place through time.

    Args:
        contents: Of the result.
        chosen: The place; without one the last position, at a published depth that is typical of the measurements.
    """
    notes, track, slices = list(contents.notes), contents.track, contents.slices
    at = chosen.at
    if at is None and track.time_ns.size:
        depth = typical_depth(slices, contents.measured.innovations["depth"].to_numpy(np.float64))
        at = (float(track.longitude[-1]), float(track.latitude[-1]), depth)
    if slices is None or at is None:
        what = (
            "no published current" if slices is None else "no position, and no place was requested"
        )
        return Panels([missing("Current at a place", f"The result holds {what}.")], 1, notes)
    series = contents.series(at)
    assert series is not None  # with slices there is one
    if not np.isfinite(series.u).any():
        why = f"{place_text(at[0], at[1])} at {at[2]:g} m is on land, below the bottom, or outside the region of the estimate."
        return Panels([missing("Current at a place", why)], 1, notes)
    if series.depth != at[2]:
        notes.append(f"Requested depth: {at[2]:g} m; nearest published depth: {series.depth:g} m.")
    elif np.isnan(series.u_standard_error[:-1]).all() and series.time_ns.size > 1:
        depths = ", ".join(f"{depth:g}" for depth in slices.depths)
        notes.append(
            f"At {series.depth:g} m only the last standard error is known; through time it was published at {depths} m."
        )
    if series.time_ns.size == 1:
        notes.append("The current was published once: there is no series.")
    where = f"{place_text(at[0], at[1])}, {series.depth:g} m"
    chart = Chart(
        "", "", Axis("time (UTC)"), [_series_panel(series, key, where) for key in _COMPONENTS]
    )
    panels = [Panel(panel.title, drawing_of(chart, k), 0.5) for k, panel in enumerate(chart.panels)]
    return Panels(panels, 2, notes)


def _series_panel(series: Series, key: str, where: str) -> Drawn:
    times, values = series.time_ns.astype("datetime64[ns]"), getattr(series, key)
    errors = getattr(series, f"{key}_standard_error")
    marks = [Mark("joined", times, values, "estimate", size=4.5)]
    name = "one standard error"
    if np.isfinite(errors).sum() > 1:
        marks.append(Mark("area", times, values - errors, name, base=values + errors))
    elif np.isfinite(errors).any():
        marks.append(Mark("points", times[-1:], values[-1:], name, size=4.5, error=errors[-1:]))
    title = f"{_COMPONENTS[key]} current, {where}"
    return Drawn(title, Axis(f"${key}$", "m/s"), marks, level=0.0)


# The least width of a section [ns]: one profile has none.
_LEAST_NS = 600_000_000_000


def section_panels(contents: Contents, chosen: Chosen) -> Panels:
    """Return depth against time along the track, of both components.

    Args:
        contents: Of the result.
        chosen: Not used: a section follows the track.
    """
    bins, notes = contents.section, list(contents.notes)
    if bins.time_ns.size == 0:
        why = "The result holds no profile that was used, and no estimate along its track."
        return Panels([missing("Section along the track", why)], 1, notes)
    if not contents.bins.time_ns.size:
        notes.append(
            "No profile of the current was used: the section shows only the estimate along the track."
        )
    if not np.isfinite(bins.estimated).any():
        notes.append(
            "The result holds no estimate: the section shows only measured minus estimated, which it holds for each bin."
        )
    if bins.left_out:
        notes.append(
            f"{bins.left_out} of {bins.left_out + bins.profiles} profiles are omitted, evenly spread."
        )
    if np.isfinite(bins.replayed).any():
        notes.append(
            "The result is smoothed: the estimate at each time also uses later measurements."
        )
    grid = gridded(bins)
    edges = (
        _time_edges(grid.time_ns.size, int(bins.time_ns.min()), int(bins.time_ns.max())),
        np.linspace(0.0, grid.depths[-1] + grid.depths[0], grid.depths.size + 1),
    )
    panels = [
        Panel(
            f"{grid.names[quantity]}, {component}",
            partial(_section_panel, edges, grid.values[quantity, k], grid.colors(quantity)),
            0.42,
        )
        for quantity in grid.shown
        for k, component in enumerate(COMPONENTS)
    ]
    return Panels(panels, 2, notes)


def _section_panel(
    edges: tuple[Any, Array], values: Array, colors: tuple[str, float, float], axes: Axes
) -> None:
    name, least, most = colors
    axes.set_facecolor(PRINT["land"])
    look: Any = {"cmap": colormap(name), "vmin": least, "vmax": most, "rasterized": True}
    mesh = axes.pcolormesh(*edges, np.ma.masked_invalid(values), **look)
    colorbar(axes, mesh, "m s$^{-1}$", "both" if least else "max")
    axes.invert_yaxis()
    axes.set_ylabel("depth [m]")
    date_axis(axes)


def _time_edges(columns: int, first: int, last: int) -> Any:
    middle = 0.5 * (last - first)
    half = max(middle, 0.5 * _LEAST_NS)
    offsets = np.linspace(middle - half, middle + half, columns + 1)
    return (first + np.rint(offsets).astype(np.int64)).astype("datetime64[ns]")
