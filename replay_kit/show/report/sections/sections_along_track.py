"""Sections along the track: measured, estimated, their difference and the standard error; mean currents of dives."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.results.views.along_track import BinsAlongTrack
from replay_kit.results.views.contents import Contents
from replay_kit.show.colors import scale
from replay_kit.show.page.section import Control, Figure, Section, column, pack, times

#: Most columns and rows of the section, and profiles that a column averages where there are enough.
_COLUMNS, _ROWS, _PROFILES_A_COLUMN = 160, 40, 3
_STEP = 5e-4
#: Of a panel, at its upper left.
_LABEL = {
    "xref": "paper",
    "yref": "paper",
    "x": 0.0,
    "xanchor": "left",
    "yanchor": "bottom",
    "showarrow": False,
}
#: Quantities of ``gridded``, and those of a smoothed result.
QUANTITIES = ("measured", "estimated", "measured minus estimated", "standard error")
_SMOOTHED = (
    "measured",
    "estimated before smoothing",
    "smoothed",
    "measured minus before",
    "measured minus smoothed",
    "standard error",
)


def along_track_section(contents: Contents) -> Section:
    """Return depth against time along the track, and the mean currents of the dives."""
    bins, missing, figures = contents.section, [], []
    if bins.time_ns.size:
        figures.append(_profiles(bins))
    if not contents.bins.time_ns.size:
        without = (
            "the section shows the estimate along the track alone"
            if bins.time_ns.size
            else "there is no section"
        )
        missing.append(f"The result holds no profile of the current that was used: {without}.")
    if bins.time_ns.size and not np.isfinite(bins.estimated).any():
        missing.append(
            "Without an estimate, the section shows the difference to the estimate alone, which the result holds for each bin."
        )
    means = contents.mean_currents
    if means.time_ns.size:
        figures.append(_means(contents))
    else:
        missing.append("The result holds no mean current of a dive that was used by itself.")
    return Section("section", "Section along the track", figures=figures, missing=missing)


def quantities_of(bins: BinsAlongTrack) -> tuple[tuple[str, ...], Array]:
    """Return what sections show of bins, and its values [m/s], shape (quantities, n, 2), local east and north.

    Of a smoothed result the estimate before smoothing stands beside that after it.
    """
    measured = bins.estimated + bins.residual
    if not np.isfinite(bins.replayed).any():
        return QUANTITIES, np.stack([measured, bins.estimated, bins.residual, bins.standard_error])
    each = (
        measured,
        bins.replayed,
        bins.estimated,
        measured - bins.replayed,
        bins.residual,
        bins.standard_error,
    )
    return _SMOOTHED, np.stack(each)


def limits_of(names: Sequence[str], values: Array) -> list[float]:
    """Return the ends of the colours of quantities [m/s]: velocities share one scale, and so do differences.

    Args:
        names: Of ``quantities_of``.
        values: shape (quantities, ...) [m/s].
    """
    kinds = [_kind(name) for name in names]
    return [
        _limit(
            np.concatenate([values[k].ravel() for k, other in enumerate(kinds) if other == kind])
        )
        for kind in kinds
    ]


def _kind(name: str) -> str:
    return (
        "error" if name == "standard error" else "difference" if " minus " in name else "velocity"
    )


def gridded(bins: BinsAlongTrack) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the means over cells of time and depth.

    Args:
        bins: Along the track.

    Returns:
        Times of the columns [ns, UTC], depths of the rows [m], and values [m/s], shape (quantities, 2, rows, columns), those of
        ``quantities_of``; each east and north; NaN in empty cells.
    """
    first, last = int(bins.time_ns.min()), int(bins.time_ns.max())
    columns = min(
        _COLUMNS,
        max(1, bins.profiles // _PROFILES_A_COLUMN if bins.profiles > 60 else bins.profiles),
    )
    width = max(1.0, (last - first) / columns)
    deepest = max(float(bins.depth.max()), 1.0)
    rows = _rows(bins, deepest)
    at = np.minimum(((bins.time_ns - first) / width).astype(np.intp), columns - 1)
    row = np.clip((bins.depth / deepest * rows).astype(np.intp), 0, rows - 1)
    _, values = quantities_of(bins)
    out = np.full((len(values), 2, rows, columns), np.nan)
    cell = row * columns + at
    for panel in range(len(values)):
        for axis in range(2):
            known = np.isfinite(values[panel, :, axis])
            count = np.bincount(cell[known], minlength=rows * columns)
            total = np.bincount(
                cell[known], weights=values[panel, known, axis], minlength=rows * columns
            )
            mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
            out[panel, axis] = mean.reshape(rows, columns)
    time_ns = first + np.rint(width * (np.arange(columns) + 0.5)).astype(np.int64)
    return time_ns, deepest * (np.arange(rows) + 0.5) / rows, out


def _rows(bins: BinsAlongTrack, deepest: float) -> int:
    """Return the number of rows: none is thinner than the bins are apart, or some would be empty."""
    steps = np.diff(bins.depth)[np.diff(bins.time_ns) == 0]
    apart = float(np.median(np.abs(steps))) if steps.size else deepest
    return int(np.clip(deepest / max(apart, 1e-3), 1, _ROWS))


def _profiles(bins: BinsAlongTrack) -> Figure:
    time_ns, depths, values = gridded(bins)
    names, _ = quantities_of(bins)
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "height": 205 * len(names),
        "annotations": [],
        "margin": {"l": 64, "r": 16, "t": 28, "b": 48},
    }
    limits = limits_of(names, values)
    shown = [panel for panel in range(len(names)) if np.isfinite(values[panel]).any()]
    height = 1.0 / len(shown)
    for place, panel in enumerate(shown):
        top = 1.0 - place * height
        bottom = top - height * 0.8
        axis = "" if place == 0 else str(place + 1)
        bar = {
            "len": 0.8 * height,
            "y": 0.5 * (top + bottom),
            "thickness": 12,
            "title": {"text": "m/s", "side": "right"},
        }
        traces.append(
            {
                "x": times(time_ns),
                "y": column(depths),
                "yaxis": f"y{axis}",
                "colorbar": bar,
                **_panel(panel, names[panel], limits[panel]),
            }
        )
        layout[f"yaxis{axis}"] = {
            "domain": [max(bottom, 0.0), top],
            "autorange": "reversed",
            "title": {"text": "depth [m]"},
            "showgrid": False,
        }
        layout["annotations"].append({**_LABEL, "text": names[panel], "y": top})
    layout["xaxis"] = {
        "title": {"text": "time (UTC)"},
        "anchor": f"y{'' if len(shown) == 1 else len(shown)}",
        "showgrid": False,
    }
    table = {
        "field": "section",
        "axes": {"quantity": list(names), "component": ["eastward", "northward"]},
        "cells": {
            "time": [text for _ in depths for text in times(time_ns)],
            "depth_m": column(np.repeat(depths, time_ns.size)),
        },
        "names": ["velocity_m_s"],
    }
    # the script reads a table's fields by three indices, a panel and a component being two
    packed = {"section": pack(values, _STEP)}
    return Figure(
        "profiles",
        "Profiles along the track",
        _caption(bins),
        f"Depth against time along the track, of a velocity component, in {len(shown)} panels: {', '.join(names[k] for k in shown)}.",
        {"profiles": table},
        traces,
        layout,
        (Control("Component", "select", ("eastward", "northward")),),
        packed,
    )


def _panel(panel: int, name: str, limit: float) -> dict[str, Any]:
    """Return what a panel shows [m/s], and the ends of its colours."""
    is_error = _kind(name) == "error"
    return {
        "type": "heatmap",
        "z": {"$field": "section", "at": [panel, "c0"]},
        "xaxis": "x",
        "colorscale": scale("amp" if is_error else "balance"),
        "zmin": 0.0 if is_error else -limit,
        "zmax": limit,
        "hovertemplate": f"%{{x}}, %{{y:.0f}} m: %{{z:.3f}} m/s<extra>{name}</extra>",
        "hoverongaps": False,
    }


def _limit(values: Array) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(f"{max(np.quantile(known, 0.99), 1e-3):.2g}") if known.size else 1.0


def _caption(bins: BinsAlongTrack) -> str:
    if not np.isfinite(bins.residual).any():
        return (
            "The estimate just after the last measurement before each time, along the local axes; it rests on the mean currents of the "
            "dives. How it changes with depth is known from the ensemble only. The standard error "
            "is that of the last estimate at these places."
        )
    thinned = (
        f" Of {bins.profiles + bins.left_out:,} profiles {bins.profiles:,} are shown, evenly spread."
        if bins.left_out
        else ""
    )
    smoothed = (
        " The result is smoothed: its estimate knows the measurements after each time too; before smoothing it is that of the replay."
        if np.isfinite(bins.replayed).any()
        else ""
    )
    return (
        "Each bin beside the estimate just after it was used, along the local axes; means over cells of time and "
        "depth. Look for structure in the "
        "difference: noise alone leaves none. Stripes that follow the dives point to the instrument or the dead "
        "reckoning, layers to depths "
        f"that the estimate does not resolve. The standard error is that of the last estimate at these places.{smoothed}{thinned}"
    )


def _means(contents: Contents) -> Figure:
    means = contents.mean_currents
    known = bool(np.isfinite(means.estimated).any())
    base = means.estimated if known else np.zeros_like(means.residual)
    # without an estimate the difference to it is all that results before version 4 hold
    parts = {"measured": means.measured if known else means.residual, "corrected": means.corrected}
    shown = {name: values for name, values in parts.items() if np.isfinite(values).any()}
    table: dict[str, Any] = {"dive": means.dive.tolist(), "end": times(means.time_ns)}
    for k, name in enumerate(("eastward", "northward")):
        table |= {f"{part}_{name}_m_s": column(values[:, k]) for part, values in shown.items()}
        table |= {
            f"estimated_{name}_m_s": column(base[:, k]),
            f"standard_deviation_{name}_m_s": column(means.standard_error[:, k]),
        }
    traces = [trace for k in range(2) for trace in _mean_traces(k, list(shown), known)]
    layout = {
        "height": 480,
        "xaxis": {"title": {"text": "end of the dive (UTC)"}, "anchor": "y2"},
        "yaxis": {"title": {"text": "eastward [m/s]"}, "domain": [0.55, 1.0]},
        "yaxis2": {"title": {"text": "northward [m/s]"}, "domain": [0.0, 0.45]},
    }
    corrected = "Open circles: the same corrected for the flight model's error, which is what the estimate was given. "
    caption = (
        "Points: mean current measured over each dive, with one standard deviation of what was expected before it. "
        f"{corrected if 'corrected' in shown else ''}Lines: the estimate's mean "
        "over the positions of the dive, just after the update. Points that stay on one side of the line show a bias."
    )
    names = " and ".join([*shown, "estimated"]).capitalize()
    alternative = (
        f"{names} mean current of {means.time_ns.size} dives, eastward and northward, against time."
    )
    return Figure(
        "mean-currents",
        "Mean currents of the dives",
        caption,
        alternative,
        {"mean_currents": table},
        traces,
        layout,
    )


def _mean_traces(k: int, parts: Sequence[str], known: bool) -> list[dict[str, Any]]:
    """Return a component of the mean currents: parts as points, and the estimate, if it is known, as a line."""
    name, color, axis = (("eastward", "one", ""), ("northward", "two", "2"))[k]
    common = {
        "type": "scatter",
        "x": "$mean_currents.end",
        "yaxis": f"y{axis}",
        "text": "$mean_currents.dive",
    }
    points = [
        {
            **common,
            "mode": "markers",
            "name": f"{part}, {name}",
            "y": f"$mean_currents.{part}_{name}_m_s",
            "error_y": {
                "type": "data",
                "array": f"$mean_currents.standard_deviation_{name}_m_s",
                "thickness": 1,
            },
            "marker": {
                "color": {"$color": color},
                "size": 8,
                **({"symbol": "circle-open"} if part == "corrected" else {}),
            },
            "hovertemplate": f"dive %{{text}}: %{{y:.3f}} m/s<extra>{part}, {name}</extra>",
        }
        for part in parts
    ]
    line = {
        **common,
        "mode": "lines+markers",
        "name": f"estimated, {name}" if known else "no estimate",
        "y": f"$mean_currents.estimated_{name}_m_s",
        "line": {"color": {"$color": color}, "width": 1.5, "dash": "solid"},
        "marker": {"symbol": "line-ew-open", "size": 9, "color": {"$color": color}},
        "hovertemplate": f"dive %{{text}}: %{{y:.3f}} m/s<extra>estimated, {name}</extra>",
    }
    return [*points, line]
