"""The first screen: the map with everything that lies on it, and beside it the answer as a card."""

from html import escape
from typing import Any

import numpy as np

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.text import time_text
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.record import bathymetry_name
from replay_kit.results.views.slices import CurrentSlices
from replay_kit.show.figures.map_layers import (
    POSITIONS,
    contour_step,
    drawn_layers,
    dry_text,
)
from replay_kit.show.figures.on_canvas import Extent, frame_of, marks_of, scales_of
from replay_kit.show.figures.on_page import tables_of
from replay_kit.show.page.section import Control, Figure, Section, column, pack, times
from replay_kit.show.report.card import card_html

#: Of one step of the packed current [m/s] and of the packed depth of the bottom [m].
_STEP, _DEPTH_STEP = 5e-4, 1.0
#: Share of the cells that the colours tell apart.
_MOST = 0.98


def map_section(contents: Contents) -> Section:
    """Return the map of the current, of the track and of the plans, beside the answer."""
    return map_beside(contents, card_html(contents))


def map_beside(contents: Contents, card: str) -> Section:
    """Return the map of a result with all its vehicles, beside an answer.

    Args:
        contents: Of the result.
        card: The answer, as HTML.
    """
    slices, track = contents.slices, contents.track
    missing = []
    if slices is None:
        missing.append("The result holds no current: the map shows only positions and plans.")
    if track.time_ns.size == 0:
        missing.append("The result holds no position of the vehicle.")
    if slices is None and track.time_ns.size == 0 and not len(contents.result.plan_tracks):
        return Section("map", "Map", missing=missing, beside=card, menu="Map")
    tables, packed, drawn = ({}, {}, {}) if slices is None else _field(contents, slices)
    if (seabed := contents.seabed) is not None:
        packed["seabed"] = pack(seabed.depth, _DEPTH_STEP)
        known = seabed.depth[np.isfinite(seabed.depth)]
        drawn["seabed"] = {
            "east": column(seabed.east / 1e3),
            "north": column(seabed.north / 1e3),
            "step": contour_step(float(known.max()) if known.size else 0.0),
        }
    layers = drawn_layers(contents, positions=True)
    for vehicle, layer in layers:
        held = tables_of(layer.tables)
        tables |= {f"{vehicle} {key}".strip(): table for key, table in held.items()}
    views = _views(contents, slices)
    drawn |= {
        "frame": frame_of(contents.projection, views["region"]),
        "views": {name: view.ends for name, view in views.items()},
        "marks": marks_of([layer for _, layer in layers]),
    }
    figure = Figure(
        "current-map",
        "The current, the track and the plan",
        _caption(contents, slices),
        _alternative(contents),
        tables,
        (),
        {},
        [] if slices is None else _controls(contents, slices),
        packed,
        map=drawn,
    )
    return Section("map", "Map", figures=(figure,), missing=missing, beside=card, menu="Map")


def _controls(contents: Contents, slices: CurrentSlices) -> list[Control]:
    depths = [f"mean to {contents.dive_depth:.0f} m", *(f"{d:g} m" for d in slices.depths)]
    shown = [time_text(int(time))[:16] for time in slices.time_ns]
    return [
        Control("Show", "select", ("speed", "standard error")),
        Control("Depth", "range", depths),
        Control("Time", "range", shown, len(shown) - 1),
    ]


def _views(contents: Contents, slices: CurrentSlices | None) -> dict[str, Extent]:
    """Return what can be looked at: vehicle, plan and goal, if there is a plan; the track; all of it."""
    track, plan, views = contents.track, contents.last_plan, {}
    whole = [np.column_stack([track.east, track.north])]
    plans = [one.last_plan for name, one in contents.each.items() if name]
    ways = [np.vstack([one.goal, np.column_stack([one.east, one.north])]) for one in plans if one]
    if plan is not None:
        vehicle = whole[0][-1:]
        way = np.vstack([np.column_stack([plan.east, plan.north]), plan.start, plan.goal, vehicle])
        views["plan"] = Extent.around(way[:, 0] / 1e3, way[:, 1] / 1e3, 0.14)
        whole.append(way)
    if track.time_ns.size:
        shown = np.vstack([*whole[:1], *ways]) / 1e3
        views["track"] = Extent.around(shown[:, 0], shown[:, 1], 0.14)
    if slices is not None:
        whole.append(
            np.array([[slices.east[k], slices.north[k]] for k in (0, -1)], dtype=np.float64)
        )
    if len(tracks := contents.result.plan_tracks):
        places = to_local(contents.projection, tracks["longitude"], tracks["latitude"])
        whole.append(np.column_stack(places))
    everything = np.vstack(whole) / 1e3
    views["region"] = Extent.around(everything[:, 0], everything[:, 1])
    return views


def _field(
    contents: Contents, slices: CurrentSlices
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the table, the packed arrays and the axes of the coloured field: of the mean over a dive, then of each depth."""
    mean = contents.dive_mean
    assert mean is not None
    fields = np.concatenate([mean[None], slices.fields])
    packed = {"current": pack(fields, _STEP, 1)}
    if slices.outside is not None and slices.outside.any():
        packed["outside"] = pack(np.where(slices.outside, 1.0, np.nan), 1.0)
    longitude, latitude = to_geographic(
        contents.projection, *np.meshgrid(slices.east, slices.north)
    )
    table = {
        "field": "current",
        "axes": {
            "depth_m": [f"mean to {contents.dive_depth:.0f}", *column(slices.depths)],
            "time": times(slices.time_ns),
        },
        "cells": {"longitude": column(longitude, 8), "latitude": column(latitude, 8)},
        "names": ["u_m_s", "v_m_s", "u_standard_error_m_s", "v_standard_error_m_s"],
    }
    drawn = {
        "east": column(slices.east / 1e3, 7),
        "north": column(slices.north / 1e3, 7),
        "times": (slices.time_ns // 1_000_000).tolist(),
        "scales": scales_of(limits_of(slices)),
        "dry": dry_text(slices),
    }
    return {"current": table}, packed, drawn


def limits_of(slices: CurrentSlices) -> tuple[float, float]:
    """Return the ends of the colour scales of speed and standard error [m/s], the same for all depths and times."""
    out = []
    for first in (0, 2):
        values = np.hypot(slices.fields[:, :, first], slices.fields[:, :, first + 1])
        known = values[np.isfinite(values)]
        most = float(np.quantile(known, _MOST)) if known.size else 0.0
        out.append(float(f"{most:.2g}") if most > 0.0 else 1.0)
    return out[0], float(f"{out[1] / np.sqrt(2.0):.2g}")


def _caption(contents: Contents, slices: CurrentSlices | None) -> str:
    texts = []
    if slices is not None:
        texts.append(
            "Colours: speed, or standard error of a velocity component; they fade where the error exceeds the current. Moving lines: "
            "where water drifts. The mean over depth is over that of the vehicle's dives; its error is at most the one shown. "
            f"Grey: {dry_text(slices)}."
        )
        if slices.outside is not None and slices.outside.any():
            texts.append("Hatched: outside the forecast.")
        if slices.left_out:
            texts.append(
                f"{slices.left_out} of {slices.left_out + slices.time_ns.size} published times are omitted, evenly spread."
            )
    count = contents.track.time_ns.size
    if count > POSITIONS:
        texts.append(f"Of {count:,} positions {POSITIONS:,} are drawn, evenly spread.")
    if contents.seabed is not None:
        texts.append(
            f"Labelled lines: depth of the bottom, from {escape(bathymetry_name(contents.metadata))}."
        )
    texts.append(
        "Ellipses hold 90 % of the predicted surfacings; a line joins each predicted surfacing to the actual one. Land is from Natural "
        "Earth, for orientation: plans avoid what the forecast and the bathymetry hold, not this coast."
    )
    return " ".join(texts)


def _alternative(contents: Contents) -> str:
    track = contents.track
    start = "Map of the estimated current" if contents.slices is not None else "Map"
    keys = "Arrow keys move it, plus and minus change its scale."
    if track.time_ns.size == 0:
        return f"{start}, without a track of the vehicle. {keys}"
    return (
        f"{start} with the vehicle's track from {track.longitude[0]:.3f}, {track.latitude[0]:.3f} to {track.longitude[-1]:.3f}, "
        f"{track.latitude[-1]:.3f} degrees east and north, {track.distance[-1] / 1e3:.0f} km long. {keys}"
    )
