"""Track, places, surfacings and plans as GeoJSON and KML, for maps and globes."""

import json
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pandas as pd

from replay_kit.core.geodesy import to_geographic, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.results.views.surfacings import outlines_of
from replay_kit.results.views.track import thinned

#: Tables that have places on a map.
FEATURES = ("series", "track", "surfacings", "plans")
_POINTS = 20_000
_DIGITS = 7


def features_of(tables: Mapping[str, pd.DataFrame], projection: Projection, plan: LastPlan | None = None) -> list[dict[str, Any]]:
    """Return features after RFC 7946: the track, the last current at each place, surfacings with their ellipses, the last plan.

    With the last plan come the ellipses of its surfacings and the areas that it keeps out of. Longitudes are continuous across the
    antimeridian, as those of ``/plan/geojson``.

    Args:
        tables: Those of ``FEATURES`` that are wanted.
        projection: The local frame.
        plan: The last plan; None without.
    """
    features: list[dict[str, Any]] = []
    for name, label in (("track", "track"), ("plans", "last plan")):
        rows = tables.get(name, pd.DataFrame())
        rows = rows[rows["plan"] == rows["plan"].max()] if name == "plans" and len(rows) else rows
        if len(rows):
            kept = rows.iloc[thinned(len(rows), _POINTS)]
            about: dict[str, Any] = {"name": label, "begin": _time(rows["time"].iloc[0]), "end": _time(rows["time"].iloc[-1])}
            about |= _outcome(plan) if name == "plans" and plan is not None else {}
            features.append(_feature("LineString", _line(kept["longitude"], kept["latitude"], projection), about))
    features += _around_plan(plan, projection) if plan is not None and "plans" in tables else []
    series = tables.get("series", pd.DataFrame())
    for number, rows in series.groupby("place") if len(series) else ():
        last = rows.iloc[-1]
        about = {"name": f"place {number}", "time": _time(last["time"]), "depth_m": float(last["depth"])}
        about |= {f"{key}_m_s": _number(last[key]) for key in ("u", "v", "u_standard_error", "v_standard_error")}
        features.append(_feature("Point", _line([last["longitude"]], [last["latitude"]], projection)[0], about))
    surfacings = tables.get("surfacings", pd.DataFrame())
    for row in surfacings.itertuples() if len(surfacings) else ():
        for kind in ("predicted", "actual"):
            at = _line([getattr(row, f"{kind}_longitude")], [getattr(row, f"{kind}_latitude")], projection)[0]
            features.append(
                _feature("Point", at, {"name": f"surfacing, {kind}", "time": _time(row.time), "distance_m": _number(row.distance)})
            )
    for outline in outlines_of(surfacings, projection):
        ring = _line(*to_geographic(projection, outline[:, 0], outline[:, 1]), projection)
        features.append(_feature("Polygon", [ring], {"name": "90 % ellipse of a surfacing"}))
    return features


def _outcome(plan: LastPlan) -> dict[str, Any]:
    """Return the figures of a plan; those that the result does not hold are left out."""
    odds = plan.odds or {}
    known = {"energy_j": plan.energy, "battery_j": plan.battery, "samples": odds.get("n_samples"), "reached_share": odds.get("reached")}
    return {"status": str(plan.row["status"]), **{name: value for name, value in known.items() if value is not None}}


def _around_plan(plan: LastPlan, projection: Projection) -> list[dict[str, Any]]:
    features = []
    for number, outline in enumerate(plan.ellipses, start=1):
        ring = _line(*to_geographic(projection, outline[:, 0], outline[:, 1]), projection)
        features.append(_feature("Polygon", [ring], {"name": f"90 % ellipse of planned surfacing {number}"}))
    for area in plan.areas:
        longitude, latitude = np.array([*area.corners, area.corners[0]]).T
        ring = _line(longitude, latitude, projection)
        features.append(_feature("Polygon", [ring], {"name": f"no-go area {area.name}", "surface_only": area.surface_only}))
    return features


def geojson_text(features: list[dict[str, Any]]) -> str:
    """Return features as GeoJSON."""
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1, allow_nan=False) + "\n"


def kml_text(features: list[dict[str, Any]]) -> str:
    """Return features as KML 2.2."""
    places = "".join(_placemark(feature) for feature in features)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n{places}</Document></kml>\n'


def _placemark(feature: dict[str, Any]) -> str:
    kind, at = feature["geometry"]["type"], feature["geometry"]["coordinates"]
    about = feature["properties"]
    data = "".join(
        f'<Data name="{escape(key)}"><value>{escape(str(value))}</value></Data>' for key, value in about.items() if key != "name"
    )
    points = [at] if kind == "Point" else at[0] if kind == "Polygon" else at
    # KML has no longitudes beyond 180
    text = " ".join(f"{(longitude + 180.0) % 360.0 - 180.0:.7f},{latitude:.7f}" for longitude, latitude in points)
    shape = f"<coordinates>{text}</coordinates>"
    shape = f"<outerBoundaryIs><LinearRing>{shape}</LinearRing></outerBoundaryIs>" if kind == "Polygon" else shape
    head = f"<name>{escape(about['name'])}</name><ExtendedData>{data}</ExtendedData>"
    return f"<Placemark>{head}<{kind}>{shape}</{kind}></Placemark>\n"


def _feature(kind: str, coordinates: Any, about: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": about}


def _line(longitude: Any, latitude: Any, projection: Projection) -> list[list[float]]:
    continuous = unwrap_longitude(np.asarray(longitude, dtype=np.float64), projection.longitude)
    points = np.column_stack([continuous, np.asarray(latitude, dtype=np.float64)]).round(_DIGITS)
    return [[longitude, latitude] for longitude, latitude in points.tolist()]


def _time(value: Any) -> str:
    return f"{pd.Timestamp(value).isoformat()}Z"


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
