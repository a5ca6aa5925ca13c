"""The current at a place through time, with its standard error."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from replay_kit.core.text import place_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.series import Series, series_of, typical_depth
from replay_kit.show.figures.in_print import date_axis
from replay_kit.show.plots.current_map import At
from replay_kit.show.plots.panel import Panel, Panels, missing
from replay_kit.show.plots.style import FIRST, SOFT


def series_panels(contents: Contents, at: At | None) -> Panels:
    """Return both components of the current at a place through time.

    Args:
        contents: Of the result.
        at: The place; None for the last position, at a published depth that is typical of the measurements.
    """
    notes, track, slices = list(contents.notes), contents.track, contents.slices
    if at is None and track.time_ns.size:
        depth = typical_depth(slices, contents.result.innovations["depth"].to_numpy(np.float64))
        at = (float(track.longitude[-1]), float(track.latitude[-1]), depth)
    if slices is None or at is None:
        what = (
            "no published current" if slices is None else "no position, and no place was asked for"
        )
        return Panels([missing("Current at a place", f"The result holds {what}.")], 1, notes)
    series = series_of(contents, at)
    assert series is not None  # with slices there is one
    if not np.isfinite(series.u).any():
        why = f"{place_text(at[0], at[1])} at {at[2]:g} m is on land, below the bottom, or outside the region of the estimate."
        return Panels([missing("Current at a place", why)], 1, notes)
    if series.depth != at[2]:
        notes.append(
            f"The depth asked for is {at[2]:g} m; the nearest published one is {series.depth:g} m."
        )
    elif np.isnan(series.u_standard_error[:-1]).all() and series.time_ns.size > 1:
        depths = ", ".join(f"{depth:g}" for depth in slices.depths)
        notes.append(
            f"At {series.depth:g} m the standard error of the last estimate alone is known; through time it was published at {depths} m."
        )
    where = f"{place_text(at[0], at[1])}, {series.depth:g} m"
    panels = [
        Panel(
            f"{name} current, {where}",
            partial(_panel, series, key, f"{letter} [m s$^{{-1}}$]"),
            0.5,
        )
        for name, key, letter in (("eastward", "u", "$u$"), ("northward", "v", "$v$"))
    ]
    if series.time_ns.size == 1:
        notes.append("The current was published once: there is no series.")
    return Panels(panels, 2, notes)


def _panel(series: Series, key: str, label: str, axes: Axes) -> None:
    times, values = series.time_ns.astype("datetime64[ns]"), getattr(series, key)
    errors = getattr(series, f"{key}_standard_error")
    if np.isfinite(errors).sum() > 1:
        axes.fill_between(
            times,
            values - errors,
            values + errors,
            color=FIRST,
            alpha=0.22,
            linewidth=0.0,
            label="one standard error",
        )
    elif np.isfinite(errors).any():
        axes.errorbar(
            times[-1:],
            values[-1:],
            errors[-1:],
            color=FIRST,
            capsize=3.0,
            label="one standard error",
        )
    axes.plot(times, values, "o-", color=FIRST, markersize=2.5, label="estimate")
    axes.axhline(0.0, color=SOFT, linewidth=0.5)
    axes.set_ylabel(label)
    date_axis(axes)
    axes.legend(loc="best")
