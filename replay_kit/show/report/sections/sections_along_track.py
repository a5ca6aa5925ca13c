"""Sections along the track: measured, estimated, their difference and the standard error; mean currents of dives."""

from typing import Any

import numpy as np

from replay_kit.core.colors import scale
from replay_kit.results.views.along_track import BinsAlongTrack
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.along_track import (
    COMPONENTS,
    SectionGrid,
    gridded,
    mean_current_chart,
)
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.page.section import Control, Figure, Section, column, pack, times

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


def along_track_section(contents: Contents) -> Section:
    """Return depth against time along the track, and the mean currents of the dives."""
    bins, missing, figures = contents.section, [], []
    if bins.time_ns.size:
        figures.append(_profiles(bins))
    if not contents.bins.time_ns.size:
        without = (
            "the section shows only the estimate along the track"
            if bins.time_ns.size
            else "there is no section"
        )
        missing.append(f"The result holds no profile of the current that was used: {without}.")
    if bins.time_ns.size and not np.isfinite(bins.estimated).any():
        missing.append(
            "Without an estimate, the section shows the difference only, which the result holds for each bin."
        )
    means = contents.mean_currents
    if means.time_ns.size:
        figures.append(figure_of(mean_current_chart(means)))
    else:
        missing.append("The result holds no mean current of a dive that was used.")
    dives, profiles = means.time_ns.size, contents.bins.profiles
    return Section(
        "section",
        "How does it change along the track, with depth and time?",
        figures=figures,
        missing=missing,
        menu="Section",
        answer=f"{profiles:,} profiles and {dives:,} mean currents of dives beside the estimate.",
    )


def _profiles(bins: BinsAlongTrack) -> Figure:
    grid = gridded(bins)
    hours = times(grid.time_ns)
    traces: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "height": 205 * len(grid.names),
        "annotations": [],
        "margin": {"l": 64, "r": 16, "t": 28, "b": 48},
    }
    height, axis = 1.0 / len(grid.shown), ""
    for place, quantity in enumerate(grid.shown):
        top = 1.0 - place * height
        bottom = top - height * 0.8
        axis = f"y{place + 1}" if place else "y"
        traces.append(
            {
                "x": hours,
                "y": column(grid.depths),
                "yaxis": axis,
                "colorbar": {
                    "len": 0.8 * height,
                    "y": 0.5 * (top + bottom),
                    "thickness": 12,
                    "title": {"text": "m/s", "side": "right"},
                },
                **_panel(grid, quantity),
            }
        )
        layout[f"yaxis{axis[1:]}"] = {
            "domain": [max(bottom, 0.0), top],
            "autorange": "reversed",
            "title": {"text": "depth [m]"},
            "showgrid": False,
        }
        layout["annotations"].append({**_LABEL, "text": grid.names[quantity], "y": top})
    layout["xaxis"] = {"title": {"text": "time (UTC)"}, "anchor": axis, "showgrid": False}
    table = {
        "field": "section",
        "axes": {"quantity": list(grid.names), "component": list(COMPONENTS)},
        "cells": {
            "time": hours * grid.depths.size,
            "depth_m": column(np.repeat(grid.depths, grid.time_ns.size)),
        },
        "names": ["velocity_m_s"],
    }
    shown = ", ".join(grid.names[quantity] for quantity in grid.shown)
    return Figure(
        "profiles",
        "Profiles along the track",
        _caption(bins),
        f"Depth against time along the track, of a velocity component, in {len(grid.shown)} panels: {shown}.",
        {"profiles": table},
        traces,
        layout,
        (Control("Component", "select", COMPONENTS),),
        # the script reads a table's fields by three indices, a panel and a component being two
        {"section": pack(grid.values, _STEP, 3)},
    )


def _panel(grid: SectionGrid, quantity: int) -> dict[str, Any]:
    """Return what a panel shows [m/s], and the ends of its colours."""
    colors, least, most = grid.colors(quantity)
    return {
        "type": "heatmap",
        "z": {"$field": "section", "at": [quantity, "c0"]},
        "xaxis": "x",
        "colorscale": scale(colors),
        "zmin": least,
        "zmax": most,
        "hovertemplate": f"%{{x}}, %{{y:.0f}} m: %{{z:.3f}} m/s<extra>{grid.names[quantity]}</extra>",
        "hoverongaps": False,
    }


def _caption(bins: BinsAlongTrack) -> str:
    error = "The standard error is that of the last estimate at these places."
    if not np.isfinite(bins.residual).any():
        return (
            "The estimate just after the last measurement before each time, along the local axes. It is based on the mean currents of "
            f"the dives; how it varies with depth comes from the ensemble only. {error}"
        )
    thinned = (
        f" {bins.profiles:,} of {bins.profiles + bins.left_out:,} profiles are shown, evenly spread."
        if bins.left_out
        else ""
    )
    smoothed = (
        " The result is smoothed: the estimate at each time also uses later measurements; the one before smoothing is that of the replay."
        if np.isfinite(bins.replayed).any()
        else ""
    )
    return (
        "Each bin and the estimate just after it was used, along the local axes, averaged over cells of time and depth. "
        "Look for structure in the difference; pure noise shows none. Stripes that follow the dives point to the "
        "instrument or the dead reckoning, layers to depths "
        f"that the estimate does not resolve. {error}{smoothed}{thinned}"
    )
