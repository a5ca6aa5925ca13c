"""Sections of profiles along the track, DACs of dives, and time series at a position."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.words.text import place_text
from replay_kit.results.views.along_track import BinsAlongTrack, MeanCurrents
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.history import Series, typical_depth
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel, missing

#: Most columns and rows of the section, and profiles that a column averages where there are enough.
_COLUMNS, _ROWS, _PROFILES_A_COLUMN = 160, 40, 3
# The least width of a section [ns]: one profile has none.
_LEAST_NS = 600_000_000_000
COMPONENTS = {"u": "eastward", "v": "northward"}
_TIME = Axis("time (UTC)")
#: Quantities of a section, and those of a smoothed result.
QUANTITIES = ("measured", "estimated", "measured minus estimated", "standard error")
_SMOOTHED = (
    "measured",
    "estimated before smoothing",
    "smoothed",
    "measured minus before",
    "measured minus smoothed",
    "standard error",
)


def quantities_of(bins: BinsAlongTrack) -> tuple[tuple[str, ...], Array]:
    """Return the names of a section's quantities and their values, shape (quantities, n, 2) [m/s], local east and north.

    Smoothed results add the estimate before smoothing.
    """
    measured, error = bins.estimated + bins.residual, bins.standard_error
    if not np.isfinite(bins.replayed).any():
        return QUANTITIES, np.stack([measured, bins.estimated, bins.residual, error])
    before = measured - bins.replayed
    each = measured, bins.replayed, bins.estimated, before, bins.residual, error
    return _SMOOTHED, np.stack(each)


def limits_of(names: Sequence[str], values: Array) -> list[float]:
    """Return the colour limits of quantities [m/s], common to velocities and to differences.

    Args:
        names: Names from ``quantities_of``.
        values: Values, shape (quantities, ...) [m/s].
    """
    kinds = np.array([_kind(name) for name in names])
    limits = []
    for kind in kinds:
        alike = np.abs(values[kinds == kind])
        known = alike[np.isfinite(alike)]
        most = max(np.quantile(known, 0.99), 1e-3) if known.size else 1.0
        limits.append(float(f"{most:.2g}"))
    return limits


def _kind(name: str) -> str:
    difference = "difference" if " minus " in name else "velocity"
    return "error" if name == "standard error" else difference


def gridded(bins: BinsAlongTrack, values: Array) -> tuple[Any, Array, Array]:
    """Return quantities averaged over cells of time and depth along the track.

    Args:
        bins: Bins of the section.
        values: Quantities of the bins, shape (quantities, n, 2) [m/s].

    Returns:
        Edges of the columns (times) and rows [m], and means, shape (quantities, 2, rows, columns); NaN in empty cells.
    """
    first, last = int(bins.time_ns.min()), int(bins.time_ns.max())
    fewer = bins.profiles // _PROFILES_A_COLUMN if bins.profiles > 60 else bins.profiles
    columns = min(_COLUMNS, max(1, fewer))
    deepest = max(float(bins.depth.max()), 1.0)
    # each row at least as thick as the bins
    steps = np.abs(np.diff(bins.depth)[np.diff(bins.time_ns) == 0])
    apart = float(np.median(steps)) if steps.size else deepest
    rows = int(np.clip(deepest / max(apart, 1e-3), 1, _ROWS))
    at = ((bins.time_ns - first) / max(1.0, (last - first) / columns)).astype(np.intp)
    row = np.clip((bins.depth / deepest * rows).astype(np.intp), 0, rows - 1)
    cell, size = row * columns + np.minimum(at, columns - 1), rows * columns
    means = np.full((len(values), 2, size), np.nan)
    for panel, axis in np.ndindex(len(values), 2):
        known = np.isfinite(values[panel, :, axis])
        count = np.bincount(cell[known], minlength=size)
        total = np.bincount(cell[known], values[panel, known, axis], minlength=size)
        np.divide(total, count, out=means[panel, axis], where=count > 0)
    middle, half = 0.5 * (last - first), 0.5 * max(last - first, _LEAST_NS)
    edges = first + np.rint(np.linspace(middle - half, middle + half, columns + 1)).astype(np.int64)
    depths = np.linspace(0.0, deepest, rows + 1)
    return edges.astype("datetime64[ns]"), depths, means.reshape(len(values), 2, rows, columns)


def section_figure(contents: Contents) -> Figure:
    """Return the section of both components along the track."""
    bins, title = contents.section, "Profiles along the track"
    if bins.time_ns.size == 0:
        why = "The result holds no profile that was used, and no estimate along its track."
        return Figure("profiles", title, [missing("Section along the track", why)])
    notes = list[str]()
    if not contents.bins.time_ns.size:
        notes.append(
            "No profile of the current was used: the section shows only the estimate along the track."
        )
    if not np.isfinite(bins.estimated).any():
        notes.append(
            "The result holds no estimate: the section shows only measured minus estimated, which it holds for each bin."
        )
    if bins.left_out:
        every = bins.left_out + bins.profiles
        notes.append(f"{bins.left_out} of {every} profiles are omitted, evenly spread.")
    if np.isfinite(bins.replayed).any():
        notes.append(
            "The result is smoothed: the estimate at each time also uses later measurements."
        )
    names, values = quantities_of(bins)
    times, depths, means = gridded(bins, values)
    limits, panels, shown = limits_of(names, means), [], []
    axes = Axis("time (UTC)", ends=(times[0], times[-1])), Axis("depth", "m", (depths[-1], 0.0))
    for name, pair, most in zip(names, means, limits, strict=True):
        if not np.isfinite(pair).any():
            continue
        shown.append(name)
        error = _kind(name) == "error"
        scale = ("amp", 0.0, most, "m/s") if error else ("balance", -most, most, "m/s")
        for component, cells in zip(COMPONENTS.values(), pair, strict=True):
            rounded = np.round(cells, 4 if error else 3)
            mark = Mark("mesh", times, depths, name, z=rounded, scale=scale)
            panels.append(Panel(f"{name}, {component}", *axes, [mark], 0.42))
    words = f"Depth against time along the track, both velocity components, in {len(shown)} rows: {', '.join(shown)}."
    return Figure("profiles", title, panels, _caption(bins), words, notes=notes)


def _caption(bins: BinsAlongTrack) -> str:
    error = "The standard error is that of the last estimate at these places."
    if not np.isfinite(bins.residual).any():
        return (
            "The estimate just after the last measurement before each time, along the local axes. It is based on the mean currents of "
            f"the dives; how it varies with depth comes from the ensemble only. {error}"
        )
    return (
        "Each bin and the estimate just after it was used, along the local axes, averaged over cells of time and depth. "
        "Look for structure in the difference. Stripes along the dives point to the "
        "instrument or the dead reckoning, layers to depths "
        f"that the estimate does not resolve. {error}"
    )


def dives_figure(contents: Contents) -> Figure:
    """Return measured, corrected and estimated DACs against time, with a panel for each component."""
    means, title = contents.mean_currents, "Mean currents of the dives"
    if means.time_ns.size == 0:
        why = "The result holds no mean current of a dive: its vehicle does not dive, or the log has none that was used."
        return Figure("mean-currents", title, [missing("Depth-averaged currents of dives", why)])
    lacking = "The result holds no estimate: the figure shows measured minus estimated currents."
    corrected = np.isfinite(means.corrected).any()
    parts = ("measured", *(("corrected",) if corrected else ()), "estimated")
    panels = [
        Panel(
            f"dives' mean current, {component}",
            Axis("end of the dive (UTC)"),
            Axis(component, "m/s"),
            [_mean_mark(means, part, axis) for part in parts],
            0.55,
            level=0.0,
        )
        for axis, component in enumerate(COMPONENTS.values())
    ]
    circles = "Open circles: corrected for the flight model's error, as the estimate uses them. "
    caption = (
        "Points: mean current measured over each dive; bars: one standard deviation. "
        f"{circles if corrected else ''}Line: mean of the estimate "
        "over the positions of the dive, just after the update. Points that stay on one side of the line show a bias."
    )
    names = " and ".join(parts).capitalize()
    words = (
        f"{names} mean current of {means.time_ns.size} dives, eastward and northward, against time."
    )
    notes = [] if np.isfinite(means.estimated).any() else [lacking]
    return Figure("mean-currents", title, panels, caption, words, notes=notes)


def _mean_mark(means: MeanCurrents, part: str, axis: int) -> Mark:
    at = means.time_ns.astype("datetime64[ns]"), getattr(means, part)[:, axis], part
    if part == "estimated":
        return Mark("joined", *at, "one", "square", size=4.0, text=means.dive)
    symbol = "circle-open" if part == "corrected" else "circle"
    error = means.standard_error[:, axis]
    return Mark("points", *at, "two", symbol, text=means.dive, error=error, size=7.0)


def series_figure(contents: Contents, at: tuple[float, float, float] | None) -> Figure:
    """Return the time series of both components at a position.

    Args:
        contents: Contents of the result.
        at: Position; None for the last one, at the published depth most typical of the measurements.
    """
    track, slices, title = contents.track, contents.slices, "Current at a place"
    if at is None and track.time_ns.size:
        depth = typical_depth(slices, contents.measured.innovations["depth"].to_numpy(np.float64))
        at = (float(track.longitude[-1]), float(track.latitude[-1]), depth)
    series = None if at is None else contents.series(at)
    if slices is None or at is None or series is None:
        what = (
            "no published current" if slices is None else "no position, and no place was requested"
        )
        return Figure("series", title, [missing(title, f"The result holds {what}.")])
    if not np.isfinite(series.u).any():
        lacking = f"{place_text(at[0], at[1])} at {at[2]:g} m is on land, below the bottom, or outside the region of the estimate."
        return Figure("series", title, [missing(title, lacking)])
    notes = list[str]()
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
    panels = [_series_panel(series, key, where) for key in COMPONENTS]
    return Figure("series", title, panels, notes=notes)


def _series_panel(series: Series, key: str, where: str) -> Panel:
    times, values = series.time_ns.astype("datetime64[ns]"), getattr(series, key)
    errors = getattr(series, f"{key}_standard_error")
    marks = [Mark("joined", times, values, "estimate", size=4.5)]
    name = "one standard error"
    if np.isfinite(errors).sum() > 1:
        both = np.append(values - errors, (values + errors)[::-1])
        marks.append(Mark("band", np.append(times, times[::-1]), both, name))
    elif np.isfinite(errors).any():
        marks.append(Mark("points", times[-1:], values[-1:], name, size=4.5, error=errors[-1:]))
    title = f"{COMPONENTS[key]} current, {where}"
    return Panel(title, _TIME, Axis(f"${key}$", "m/s"), marks, 0.5, level=0.0)
