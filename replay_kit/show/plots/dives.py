"""Mean currents of dives beside the estimate's."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.arrays import Array
from replay_kit.results.views.along_track import MeanCurrents
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.in_print import date_axis
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing
from replay_kit.show.plots.style import FIRST, INK, SECOND, SOFT

_COMPONENTS = ("eastward", "northward")


def dive_panels(contents: Contents, at: At | None) -> Panels:
    """Return the depth-averaged currents of the dives, measured, corrected and estimated, through time and against each other.

    Args:
        contents: Of the result.
        at: Not used: the currents are those of the dives.
    """
    means, notes = contents.mean_currents, list(contents.notes)
    if means.time_ns.size == 0:
        why = "The result holds no mean current of a dive: its vehicle does not dive, or the log has none that was used."
        return Panels([missing("Depth-averaged currents of dives", why)], 1, notes)
    if not np.isfinite(means.estimated).any():
        notes.append(
            "The result holds no estimate: measured minus estimated is shown, which it holds for each dive."
        )
        titles = [f"measured minus estimated, {name}" for name in _COMPONENTS]
        return Panels(
            [Panel(title, partial(_differences, means, k), 0.55) for k, title in enumerate(titles)],
            2,
            notes,
        )
    panels = [
        Panel(f"dives' mean current, {name}", partial(_through_time, means, k), 0.85)
        for k, name in enumerate(_COMPONENTS)
    ]
    return Panels([*panels, Panel("all dives", partial(_scatter, means), 0.85)], 3, notes)


def _given(means: MeanCurrents) -> list[tuple[str, Array, dict[str, Any]]]:
    """Return name, values and look of what the result holds beside the estimate: measured filled, corrected open."""
    filled, opened = {"markersize": 2.5}, {"markersize": 3.5, "markerfacecolor": "none"}
    parts = ("measured", means.measured, filled), ("corrected", means.corrected, opened)
    return [part for part in parts if np.isfinite(part[1]).any()]


def _through_time(means: MeanCurrents, k: int, axes: Axes) -> None:
    times = means.time_ns.astype("datetime64[ns]")
    for name, values, look in _given(means):
        axes.errorbar(
            times,
            values[:, k],
            means.standard_error[:, k],
            fmt="o",
            **look,
            color=SECOND,
            elinewidth=0.6,
            label=name,
        )
    axes.plot(times, means.estimated[:, k], "s-", color=FIRST, markersize=2.0, label="estimated")
    axes.axhline(0.0, color=SOFT, linewidth=0.5)
    axes.set_ylabel("m s$^{-1}$", labelpad=1.0)
    date_axis(axes, 4)
    axes.legend(loc="best")


def _differences(means: MeanCurrents, k: int, axes: Axes) -> None:
    axes.plot(
        means.time_ns.astype("datetime64[ns]"),
        means.residual[:, k],
        "o",
        color=SECOND,
        markersize=2.5,
    )
    axes.axhline(0.0, color=SOFT, linewidth=0.5)
    axes.set_ylabel("m s$^{-1}$", labelpad=1.0)
    date_axis(axes, 4)


def _scatter(means: MeanCurrents, axes: Axes) -> None:
    given = _given(means)
    for k, marker, color in ((0, "o", FIRST), (1, "^", SECOND)):
        for (_, values, look), label in zip(given, (_COMPONENTS[k], None), strict=False):
            axes.plot(
                means.estimated[:, k],
                values[:, k],
                marker,
                **look,
                color=color,
                alpha=0.8,
                label=label,
            )
    both = np.concatenate([means.estimated, *(values for _, values, _ in given)])
    ends = (float(np.nanmin(both)), float(np.nanmax(both)))
    axes.plot(ends, ends, color=INK, linewidth=0.6, label="1 : 1")
    axes.set(
        xlabel="estimated [m s$^{-1}$]",
        ylabel=f"{', '.join(name for name, _, _ in given)} [m s$^{{-1}}$]",
        xlim=axes.get_ylim(),
    )
    axes.set_box_aspect(1.0)
    axes.legend(loc="best")
