"""The map: the current at a depth and time, its standard error, the track, surfacings and plans."""

from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.text import time_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.record import bathymetry_name
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.show.colors import scale
from replay_kit.show.page.section import Control, Figure, Section, column, pack, times
from replay_kit.show.report.sections.map_frame import (
    Extent,
    coastline,
    dry_text,
    graticule,
    hatching,
)
from replay_kit.show.report.sections.map_hazards import area_marks, seabed_contours
from replay_kit.show.report.sections.map_marks import (
    DARK,
    POSITIONS,
    plan_marks,
    surfacing_marks,
    track_marks,
)

#: Arrows along a side.
_ARROWS = 24
#: Of one step of the packed current [m/s].
_STEP = 5e-4


def map_section(contents: Contents) -> Section:
    """Return the map of the current, of the track and of the plans."""
    slices, track = contents.slices, contents.track
    missing = []
    if slices is None:
        missing.append("The result holds no current: the map shows positions and plans alone.")
    if track.time_ns.size == 0:
        missing.append("The result holds no position of the vehicle.")
    tracks = contents.result.plan_tracks
    if slices is None and track.time_ns.size == 0 and not len(tracks):
        return Section("map", "Map", missing=missing)
    tables, traces = _field_traces(contents, slices)
    extent = _extent(contents, slices)
    bottom_table, contours, bottom = seabed_contours(contents)
    tables |= bottom_table
    traces += contours
    for more_tables, more_traces in (
        area_marks(contents),
        track_marks(contents),
        surfacing_marks(contents),
        plan_marks(contents),
    ):
        tables |= more_tables
        traces += more_traces
    lines, labels = graticule(contents.projection, extent)
    traces[1:1] = lines if slices is not None else []
    traces += [labels] if slices is not None else [*lines, labels]
    controls = [] if slices is None else _controls(slices, track.time_ns.size > 0)
    east, north = _ranges(contents, extent, slices)
    packed = {**_packed(slices), **bottom}
    layout = {
        "height": 800,
        "xaxis": {
            "title": {"text": "local east [km]"},
            "constrain": "domain",
            "range": east,
            "showgrid": False,
            "zeroline": False,
        },
        "yaxis": {
            "title": {"text": "local north [km]"},
            "scaleanchor": "x",
            "constrain": "domain",
            "range": north,
            "showgrid": False,
            "zeroline": False,
        },
        "shapes": [] if _outside(slices) is None else [hatching(extent)],
    }
    figure = Figure(
        "current-map",
        "The current, the track and the plans",
        _caption(contents, slices),
        _alternative(contents),
        tables,
        traces,
        layout,
        controls,
        packed,
    )
    return Section("map", "Map", figures=(figure,), missing=missing)


def _packed(slices: CurrentSlices | None) -> dict[str, Any]:
    """Return the current, and where the map leaves the forecast's grid."""
    if slices is None:
        return {}
    outside = _outside(slices)
    return {
        "current": pack(slices.fields, _STEP),
        **({} if outside is None else {"outside": pack(np.where(outside, 1.0, np.nan), 1.0)}),
    }


def _outside(slices: CurrentSlices | None) -> NDArray[np.bool_] | None:
    """Return the cells that are known to lie off the forecast's grid; None where there is none."""
    return (
        None
        if slices is None or slices.outside is None or not slices.outside.any()
        else slices.outside
    )


def _controls(slices: CurrentSlices, has_track: bool) -> list[Control]:
    return [
        Control("Show", "select", ("speed", "standard error")),
        Control("Depth", "range", [f"{depth:g} m" for depth in slices.depths]),
        Control(
            "Time",
            "range",
            [time_text(int(time))[:16] for time in slices.time_ns],
            len(slices.time_ns) - 1,
        ),
        *([Control("View", "select", ("region", "track"))] if has_track else []),
    ]


def _ranges(contents: Contents, extent: Extent, slices: CurrentSlices | None) -> tuple[Any, Any]:
    """Return the ranges of the axes [km]: of the region, and with a current and a track also of the track, as the control chooses."""
    whole = ([extent.west, extent.east], [extent.south, extent.north])
    track = contents.track
    if slices is None or track.time_ns.size == 0:
        return whole
    # two cells of the current around the track show where it leads
    beyond = 2.0 * float(slices.east[1] - slices.east[0]) / 1e3
    near = Extent.around(track.east / 1e3, track.north / 1e3)
    east, north = (
        [near.west - beyond, near.east + beyond],
        [near.south - beyond, near.north + beyond],
    )
    return {"$choose": 3, "of": [whole[0], east]}, {"$choose": 3, "of": [whole[1], north]}


def _extent(contents: Contents, slices: CurrentSlices | None) -> Extent:
    """Return what the map shows [km]: the grid, and track and plans where they leave it."""
    east, north = [contents.track.east], [contents.track.north]
    if slices is not None:
        east, north = [*east, slices.east], [*north, slices.north]
    if len(tracks := contents.result.plan_tracks):
        planned = to_local(contents.projection, tracks["longitude"], tracks["latitude"])
        east, north = [*east, planned[0]], [*north, planned[1]]
    return Extent.around(np.concatenate(east) / 1e3, np.concatenate(north) / 1e3)


def _field_traces(
    contents: Contents, slices: CurrentSlices | None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the coloured field, land, coastline and arrows."""
    if slices is None:
        return {}, []
    shore = coastline(slices)
    coast = {
        "type": "scatter",
        "mode": "lines",
        "name": "coast" if slices.outside is not None else "coast, or edge of the forecast",
        "x": shore[0],
        "y": shore[1],
        "line": {"color": DARK, "width": 1.5},
        "hoverinfo": "skip",
    }
    longitude, latitude = to_geographic(
        contents.projection, *np.meshgrid(slices.east, slices.north)
    )
    table = {
        "field": "current",
        "axes": {"depth_m": column(slices.depths), "time": times(slices.time_ns)},
        "cells": {"longitude": column(longitude, 8), "latitude": column(latitude, 8)},
        "names": ["u_m_s", "v_m_s", "u_standard_error_m_s", "v_standard_error_m_s"],
    }
    x, y = column(slices.east / 1e3), column(slices.north / 1e3)
    return {"current": table}, [
        *_heatmaps(slices, x, y),
        *([coast] if shore[0] else []),
        *_arrows(slices, x, y),
    ]


def _heatmaps(
    slices: CurrentSlices, x: list[float | None], y: list[float | None]
) -> list[dict[str, Any]]:
    """Return speed or standard error, the dry cells, and those off the forecast's grid."""
    u, v, eu, ev = ({"$field": "current", "at": ["c1", "c2", k]} for k in range(4))
    speed, error = _limits(slices)
    # beside missing cells there is nothing to interpolate with
    whole = [
        bool(np.isfinite(slices.fields[:, :, part]).all()) for part in (slice(0, 2), slice(2, 4))
    ]
    field = {
        "type": "heatmap",
        "x": x,
        "y": y,
        "z": {"$choose": 0, "of": [{"$op": "hypot", "of": [u, v]}, {"$op": "rms", "of": [eu, ev]}]},
        "colorscale": {"$choose": 0, "of": [scale("speed"), scale("amp")]},
        "zmin": 0.0,
        "zmax": {"$choose": 0, "of": [speed, error]},
        "colorbar": {
            "title": {
                "text": {"$choose": 0, "of": ["speed [m/s]", "standard error [m/s]"]},
                "side": "right",
            },
            "thickness": 14,
        },
        "hovertemplate": "%{x:.1f} km east, %{y:.1f} km north: %{z:.3f} m/s<extra></extra>",
        "hoverongaps": False,
        "zsmooth": {"$choose": 0, "of": ["best" if known else False for known in whole]},
    }
    outside = {"$field": "outside", "at": []}
    leaves = _outside(slices) is not None
    kinds: list[tuple[dict[str, Any], Any, str]] = [
        (
            {"$op": "dry", "of": [u, outside] if leaves else [u]},
            {"$color": "land"},
            dry_text(slices),
        ),
        # what is behind is seen: the hatching
        *([(outside, "rgba(0,0,0,0)", "outside the forecast")] if leaves else []),
    ]
    flat = {"type": "heatmap", "x": x, "y": y, "showscale": False, "hoverongaps": False}
    return [
        field,
        *(
            {
                **flat,
                "z": z,
                "colorscale": [[0, color], [1, color]],
                "hovertemplate": f"{text}<extra></extra>",
            }
            for z, color, text in kinds
        ),
    ]


def _arrows(
    slices: CurrentSlices, x: list[float | None], y: list[float | None]
) -> list[dict[str, Any]]:
    """Return the arrows of the current, dark on a light halo, to be seen on both ends of the colour scale."""
    u, v = ({"$field": "current", "at": ["c1", "c2", k]} for k in range(2))
    step = -(-max(slices.east.size, slices.north.size) // _ARROWS)
    cell = (
        step * float(min(slices.east[1] - slices.east[0], slices.north[1] - slices.north[0])) / 1e3
    )
    arrows = {
        "type": "arrows",
        "x": x,
        "y": y,
        "u": u,
        "v": v,
        "step": step,
        "length": 1.4 * cell / _limits(slices)[0],
        "showlegend": False,
    }
    return [
        {**arrows, "line": {"color": "rgba(255,255,255,0.7)", "width": 3.4}},
        {**arrows, "line": {"color": DARK, "width": 1.3}},
    ]


def _limits(slices: CurrentSlices) -> tuple[float, float]:
    """Return the ends of the colour scales of speed and standard error [m/s], the same for all depths and times."""
    out = []
    for first in (0, 2):
        values = np.hypot(slices.fields[:, :, first], slices.fields[:, :, first + 1])
        known = values[np.isfinite(values)]
        out.append(float(f"{known.max():.2g}") if known.size and known.max() > 0.0 else 1.0)
    return out[0], float(f"{out[1] / np.sqrt(2.0):.2g}")


def _caption(contents: Contents, slices: CurrentSlices | None) -> str:
    texts = []
    if slices is not None:
        texts.append(
            "Colours give the speed, or the standard error of a velocity component; arrows give the current, all drawn "
            "to one scale. Move the "
            f"sliders to another depth and time: the error shrinks along the track as measurements come in. Grey: {dry_text(slices)}."
        )
        if _outside(slices) is not None:
            texts.append("Hatched: outside the forecast.")
        if slices.left_out:
            texts.append(
                f"{slices.left_out} of {slices.left_out + slices.time_ns.size} published times are left out, evenly spread."
            )
    count = contents.track.time_ns.size
    if count:
        texts.append(
            "The track goes from dark (begin) to light (end); circles are fixes, the rest is dead reckoned."
        )
    if count > POSITIONS:
        texts.append(f"Of {count:,} positions {POSITIONS:,} are drawn, evenly spread.")
    if contents.seabed is not None:
        texts.append(
            f"Labelled lines are depths of the bottom, of {escape(bathymetry_name(contents.record))}."
        )
    texts.append(
        "Axes are kilometres along the local frame of the result; thin lines are meridians and parallels."
    )
    return " ".join(texts)


def _alternative(contents: Contents) -> str:
    track = contents.track
    start = "Map of the estimated current" if contents.slices is not None else "Map"
    if track.time_ns.size == 0:
        return f"{start}, without a track of the vehicle."
    return (
        f"{start} with the vehicle's track from {track.longitude[0]:.3f}, {track.latitude[0]:.3f} to {track.longitude[-1]:.3f}, "
        f"{track.latitude[-1]:.3f} degrees east and north, {track.distance[-1] / 1e3:.0f} km long."
    )
