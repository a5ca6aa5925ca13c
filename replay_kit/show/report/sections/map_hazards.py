"""What a plan keeps clear of, on the map: the bottom as contours, areas, and the ellipses of its own surfacings."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.results.views.contents import Contents
from replay_kit.show.page.section import column, pack
from replay_kit.show.report.sections.map_marks import mark_color

#: Of one step of the packed depth [m]; contours of the bottom there are about.
_STEP, _CONTOURS = 0.5, 7


def seabed_contours(
    contents: Contents,
) -> tuple[dict[str, Any], list[dict[str, Any]], dict[str, Any]]:
    """Return the table, the contours and the packed depth of the bottom; nothing without a bathymetry."""
    seabed = contents.seabed
    if seabed is None:
        return {}, [], {}
    longitude, latitude = to_geographic(
        contents.projection, *np.meshgrid(seabed.east, seabed.north)
    )
    table = {
        "field": "seabed",
        "axes": {"quantity": ["bottom"], "unit": ["m"]},
        "cells": {"longitude": column(longitude, 8), "latitude": column(latitude, 8)},
        "names": ["depth_m"],
    }
    known = seabed.depth[np.isfinite(seabed.depth)]
    step = contour_step(float(known.max()) if known.size else 0.0)
    contours = {
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
            "labelfont": {"size": 10, "color": mark_color(contents)},
        },
        "line": {"color": mark_color(contents), "width": 0.8},
        "showscale": False,
        "showlegend": True,
        "hoverinfo": "skip",
    }
    return {"seabed": table}, [contours], {"seabed": pack(seabed.depth[None, None], _STEP)}


def contour_step(span: float) -> float:
    """Return the step between contours over a span of depths [m]: 1, 2 or 5 times a power of ten, at most seven contours."""
    span = max(span, 10.0)
    power = 10.0 ** np.floor(np.log10(span / _CONTOURS))
    return float(
        power
        * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power * _CONTOURS >= span)
    )


def area_marks(contents: Contents) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the areas that the last plan keeps out of, and the ellipses of its surfacings."""
    plan = contents.last_plan
    if plan is None:
        return {}, []
    tables: dict[str, Any] = {}
    traces = []
    names, corners = [], []
    for area in plan.areas:
        ring = np.array([*area.corners, area.corners[0]])
        corners.append(np.column_stack([*to_local(contents.projection, *ring.T), ring]))
        names += [f"{area.name} (surface only)" if area.surface_only else area.name] * len(ring)
    if corners:
        _, _, longitude, latitude = np.concatenate(corners).T
        tables["no_go_areas"] = {
            "area": names,
            "longitude": column(longitude, 9),
            "latitude": column(latitude, 9),
        }
        look = {
            "fill": "toself",
            "fillcolor": "rgba(190,60,40,0.18)",
            "line": {"color": "rgb(170,40,25)", "width": 2},
        }
        traces.append(
            {
                **_rings([ring[:, :2] for ring in corners]),
                **look,
                "name": "no-go area",
                "text": _gapped(names, corners),
            }
        )
    if plan.ellipses:
        look = {"line": {"color": {"$color": "two"}, "width": 1.2}, "hoverinfo": "skip"}
        traces.append({**_rings(plan.ellipses), **look, "name": "90 % of planned surfacings"})
    return tables, traces


def _rings(rings: Any) -> dict[str, Any]:
    """Return closed lines [m] as one trace with gaps."""
    points = [point for ring in rings for point in [*(ring / 1e3).round(4).tolist(), [None, None]]]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": [point[0] for point in points],
        "y": [point[1] for point in points],
    }


def _gapped(names: list[str], rings: list[Array]) -> list[str]:
    """Return the names of the points of rings, with one more for the gap after each."""
    ends = np.cumsum([len(ring) for ring in rings])
    return [
        name
        for end, ring in zip(ends, rings, strict=True)
        for name in [*names[end - len(ring) : end], ""]
    ]
