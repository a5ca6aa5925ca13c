"""The map: the current at a depth and time, its standard error, the track, surfacings and plans."""

from html import escape
from typing import Any

import numpy as np

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Seabed
from replay_kit.core.text import time_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.record import bathymetry_name
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.show.colors import ON_FIELD, scale
from replay_kit.show.figures.map_layers import (
    POSITIONS,
    coast_layer,
    contour_step,
    contrast,
    dry_text,
    hazard_layer,
    plan_layer,
    position_layer,
    surfacing_layer,
    track_layer,
)
from replay_kit.show.figures.on_page import color_of, tables_of, traces_of
from replay_kit.show.page.section import Control, Figure, Section, column, pack, times
from replay_kit.show.report.sections.map_frame import (
    Extent,
    arrows,
    graticule,
    hatching,
    map_layout,
)

#: Of one step of the packed current [m/s] and of the packed depth of the bottom [m].
_STEP, _DEPTH_STEP = 5e-4, 0.5


def map_section(contents: Contents) -> Section:
    """Return the map of the current, of the track and of the plans."""
    slices, track = contents.slices, contents.track
    missing = []
    if slices is None:
        missing.append("The result holds no current: the map shows only positions and plans.")
    if track.time_ns.size == 0:
        missing.append("The result holds no position of the vehicle.")
    if slices is None and track.time_ns.size == 0 and not len(contents.result.plan_tracks):
        return Section("map", "Map", missing=missing)
    tables, traces, packed = ({}, [], {}) if slices is None else _field(contents, slices)
    extent = _extent(contents, slices)
    lines, labels = graticule(contents.projection, extent)
    traces[1:1] = lines
    if contents.seabed is not None:
        traces.append(_seabed_contours(contents, contents.seabed, tables, packed))
    track_marks = track_layer(contents)
    for layer in (
        hazard_layer(contents),
        track_marks,
        position_layer(track_marks),
        surfacing_layer(contents),
        plan_layer(contents),
    ):
        tables |= tables_of(layer.tables)
        traces += [trace for mark in layer.marks for trace in traces_of(mark)]
    shapes = [hatching(extent)] if "outside" in packed else []
    figure = Figure(
        "current-map",
        "The current, the track and the plans",
        _caption(contents, slices),
        _alternative(contents),
        tables,
        [*traces, labels],
        {**map_layout(*_ranges(contents, extent, slices)), "height": 800, "shapes": shapes},
        [] if slices is None else _controls(slices, track.time_ns.size > 0),
        packed,
    )
    return Section("map", "Map", figures=(figure,), missing=missing)


def _leaves_forecast(slices: CurrentSlices) -> bool:
    """Return whether cells are known to lie off the forecast's grid."""
    return slices.outside is not None and bool(slices.outside.any())


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


def _field(
    contents: Contents, slices: CurrentSlices
) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Any]]:
    """Return the tables, traces and packed arrays of the coloured field, land, coastline and arrows."""
    packed = {"current": pack(slices.fields, _STEP)}
    if slices.outside is not None and slices.outside.any():
        packed["outside"] = pack(np.where(slices.outside, 1.0, np.nan), 1.0)
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
    traces = [
        *_heatmaps(slices, x, y),
        *(trace for mark in coast_layer(slices).marks for trace in traces_of(mark)),
        # dark on a light halo, to be seen on both ends of the colour scale
        *(
            arrows("current", (slices.east, slices.north), 1.4 / _limits(slices)[0], "c1", "c2")
            | {"line": {"color": color, "width": width}}
            for color, width in (("rgba(255,255,255,0.7)", 3.4), (ON_FIELD, 1.3))
        ),
    ]
    return {"current": table}, traces, packed


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
    leaves = _leaves_forecast(slices)
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


def _limits(slices: CurrentSlices) -> tuple[float, float]:
    """Return the ends of the colour scales of speed and standard error [m/s], the same for all depths and times."""
    out = []
    for first in (0, 2):
        values = np.hypot(slices.fields[:, :, first], slices.fields[:, :, first + 1])
        known = values[np.isfinite(values)]
        out.append(float(f"{known.max():.2g}") if known.size and known.max() > 0.0 else 1.0)
    return out[0], float(f"{out[1] / np.sqrt(2.0):.2g}")


def _seabed_contours(
    contents: Contents, seabed: Seabed, tables: dict[str, Any], packed: dict[str, Any]
) -> dict[str, Any]:
    """Return the contours of the depth of the bottom, and add it to the tables and the packed arrays."""
    color = color_of(contrast(contents))
    longitude, latitude = to_geographic(
        contents.projection, *np.meshgrid(seabed.east, seabed.north)
    )
    tables["seabed"] = {
        "field": "seabed",
        "axes": {"quantity": ["bottom"], "unit": ["m"]},
        "cells": {"longitude": column(longitude, 8), "latitude": column(latitude, 8)},
        "names": ["depth_m"],
    }
    known = seabed.depth[np.isfinite(seabed.depth)]
    step = contour_step(float(known.max()) if known.size else 0.0)
    packed["seabed"] = pack(seabed.depth[None, None], _DEPTH_STEP)
    return {
        "type": "contour",
        "name": "depth of the bottom [m]",
        "x": column(seabed.east / 1e3),
        "y": column(seabed.north / 1e3),
        "z": {"$field": "seabed", "at": [0, 0]},
        "contours": {
            "coloring": "none",
            "start": step,
            "end": float(known.max()) if known.size else step,
            "size": step,
            "showlabels": True,
            "labelfont": {"size": 10, "color": color},
        },
        "line": {"color": color, "width": 0.8},
        "showscale": False,
        "showlegend": True,
        "hoverinfo": "skip",
    }


def _caption(contents: Contents, slices: CurrentSlices | None) -> str:
    texts = []
    if slices is not None:
        texts.append(
            "Colours: speed, or standard error of a velocity component. Arrows: current, all to one scale. The sliders choose depth "
            f"and time; the error decreases along the track as measurements come in. Grey: {dry_text(slices)}."
        )
        if _leaves_forecast(slices):
            texts.append("Hatched: outside the forecast.")
        if slices.left_out:
            texts.append(
                f"{slices.left_out} of {slices.left_out + slices.time_ns.size} published times are omitted, evenly spread."
            )
    count = contents.track.time_ns.size
    if count:
        texts.append(
            "Positions go from dark (begin) to light (end); circles are fixes, the others are dead-reckoned."
        )
    if count > POSITIONS:
        texts.append(f"Of {count:,} positions {POSITIONS:,} are drawn, evenly spread.")
    if contents.seabed is not None:
        texts.append(
            f"Labelled lines: depth of the bottom, from {escape(bathymetry_name(contents.record))}."
        )
    texts.append(
        "Axes: kilometres in the local frame of the result; dotted lines: meridians and parallels."
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
