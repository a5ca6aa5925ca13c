"""The section along the track: measured, estimated, difference and standard error, depth against time."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.arrays import Array
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.in_print import date_axis
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing
from replay_kit.show.plots.style import LAND, colorbar, colormap
from replay_kit.show.report.sections.sections_along_track import (
    gridded,
    limits_of,
    quantities_of,
)

_COMPONENTS = ("eastward", "northward")
# The least width of a section [ns]: one profile has none.
_LEAST_NS = 600_000_000_000


def section_panels(contents: Contents, at: At | None) -> Panels:
    """Return depth against time along the track, of both components.

    Args:
        contents: Of the result.
        at: Not used: a section follows the track.
    """
    bins, notes = contents.section, list(contents.notes)
    if bins.time_ns.size == 0:
        why = "The result holds no profile that was used, and no estimate along its track."
        return Panels([missing("Section along the track", why)], 1, notes)
    if not contents.bins.time_ns.size:
        notes.append(
            "No profile of the current was used: the section shows the estimate along the track alone."
        )
    time_ns, depths, values = gridded(bins)
    if not np.isfinite(bins.estimated).any():
        notes.append(
            "The result holds no estimate: the section shows measured minus estimated alone, which it holds for each bin."
        )
    if bins.left_out:
        notes.append(
            f"{bins.left_out} of {bins.left_out + bins.profiles} profiles are left out, evenly spread."
        )
    edges = (
        _time_edges(time_ns.size, int(bins.time_ns.min()), int(bins.time_ns.max())),
        _depth_edges(depths),
    )
    names, _ = quantities_of(bins)
    if np.isfinite(bins.replayed).any():
        notes.append(
            "The result is smoothed: its estimate knows the measurements after each time too."
        )
    limits = limits_of(names, values)
    panels = [
        Panel(
            f"{row}, {_COMPONENTS[component]}",
            partial(_panel, edges, values[k, component], limits[k], row == "standard error"),
            0.42,
        )
        for k, row in enumerate(names)
        if np.isfinite(values[k]).any()
        for component in range(2)
    ]
    return Panels(panels, 2, notes)


def _panel(
    edges: tuple[Any, Array], values: Array, limit: float, is_error: bool, axes: Axes
) -> None:
    axes.set_facecolor(LAND)
    mesh = axes.pcolormesh(
        edges[0],
        edges[1],
        np.ma.masked_invalid(values),
        cmap=colormap("amp" if is_error else "balance"),
        vmin=0.0 if is_error else -limit,
        vmax=limit,
        rasterized=True,
    )
    colorbar(axes, mesh, "m s$^{-1}$", "max" if is_error else "both")
    axes.invert_yaxis()
    axes.set_ylabel("depth [m]")
    date_axis(axes)


def _time_edges(columns: int, first: int, last: int) -> Any:
    middle = 0.5 * (last - first)
    half = max(middle, 0.5 * _LEAST_NS)
    offsets = np.linspace(middle - half, middle + half, columns + 1)
    return (first + np.rint(offsets).astype(np.int64)).astype("datetime64[ns]")


def _depth_edges(depths: Array) -> Array:
    return np.linspace(0.0, depths[-1] + depths[0], depths.size + 1)
