"""Track, places, surfacings and plans as GeoJSON and KML, for maps and globes."""

from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.core.colors import LIGHT, SYMBOLS
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.region import Feature, collection_text, feature, positions
from replay_kit.results.views.track import LastPlan, outlines_of, thinned

#: Tables that have places on a map.
FEATURES = ("series", "track", "surfacings", "plans")
_POINTS = 20_000
# Simplestyle 1.1, in the colours of maps.
_ROLES = ("track", "plan", "predicted", "actual", "no_go")
_TRACK, _PLAN, _PREDICTED, _ACTUAL, _NO_GO = (
    LIGHT.get(color, color) for color, _ in (SYMBOLS[role] for role in _ROLES)
)
_STYLES: Mapping[str, Mapping[str, Any]] = {
    "track": {"stroke": _TRACK, "stroke-width": 3, "stroke-opacity": 1.0},
    "plans": {"stroke": _PLAN, "stroke-width": 3, "stroke-opacity": 1.0},
    "place": {"marker-color": LIGHT["three"], "marker-size": "small"},
    "predicted": {"marker-color": _PREDICTED, "marker-size": "small"},
    "actual": {"marker-color": _ACTUAL, "marker-size": "small"},
    "ellipse": {
        **{"stroke": _PREDICTED, "stroke-width": 1, "stroke-opacity": 1.0},
        **{"fill": _PREDICTED, "fill-opacity": 0.15},
    },
    "no_go": {
        **{"stroke": _NO_GO, "stroke-width": 2, "stroke-opacity": 1.0},
        **{"fill": _NO_GO, "fill-opacity": 0.25},
    },
}
_STYLE_KEYS = frozenset(key for style in _STYLES.values() for key in style)


def features_of(
    tables: Mapping[str, pd.DataFrame], projection: Projection, plan: LastPlan | None = None
) -> list[Feature]:
    """Return features after RFC 7946: the track, the last current at each place, surfacings with their ellipses, the last plan.

    With the last plan come the ellipses of its surfacings and the areas that it keeps out of. Longitudes are continuous across the
    antimeridian, as those of ``/plan/geojson``.

    Args:
        tables: Those of ``FEATURES`` that are wanted.
        projection: The local frame.
        plan: The last plan; None without.
    """
    features: list[Feature] = []
    for name, label in (("track", "track"), ("plans", "last plan")):
        rows = tables.get(name, pd.DataFrame())
        rows = rows[rows["plan"] == rows["plan"].max()] if name == "plans" and len(rows) else rows
        if len(rows):
            kept = rows.iloc[thinned(len(rows), _POINTS)]
            about: dict[str, Any] = {
                "name": label,
                "begin": _time(rows["time"].iloc[0]),
                "end": _time(rows["time"].iloc[-1]),
            }
            about |= _outcome(plan) if name == "plans" and plan is not None else {}
            line = _feature(
                "LineString",
                _line(kept["longitude"], kept["latitude"], projection),
                about,
                _STYLES[name],
            )
            features.append({**line, "when": [_time(time) for time in kept["time"]]})
    features += _around_plan(plan, projection) if plan is not None and "plans" in tables else []
    series = tables.get("series", pd.DataFrame())
    for number, rows in series.groupby("place") if len(series) else ():
        last = rows.iloc[-1]
        about = {
            "name": f"place {number}",
            "time": _time(last["time"]),
            "depth_m": float(last["depth"]),
        }
        about |= {
            f"{key}_m_s": _number(last[key])
            for key in ("u", "v", "u_standard_error", "v_standard_error")
        }
        features.append(
            _feature(
                "Point",
                _line([last["longitude"]], [last["latitude"]], projection)[0],
                about,
                _STYLES["place"],
            )
        )
    surfacings = tables.get("surfacings", pd.DataFrame())
    for row in surfacings.itertuples() if len(surfacings) else ():
        for kind in ("predicted", "actual"):
            at = _line(
                [getattr(row, f"{kind}_longitude")], [getattr(row, f"{kind}_latitude")], projection
            )[0]
            about = {
                "name": f"surfacing, {kind}",
                "time": _time(row.time),
                "distance_m": _number(row.distance),
            }
            features.append(_feature("Point", at, about, _STYLES[kind]))
    ellipses = outlines_of(surfacings, projection)
    return features + [_ellipse(each, "a surfacing", projection) for each in ellipses]


def _outcome(plan: LastPlan) -> dict[str, Any]:
    """Return the figures of a plan; those that the result does not hold are left out."""
    odds = plan.odds or {}
    known = {
        "energy_j": plan.energy,
        "battery_j": plan.battery,
        "samples": odds.get("n_samples"),
        "reached_share": odds.get("reached"),
    }
    return {
        "status": str(plan.row["status"]),
        **{name: value for name, value in known.items() if value is not None},
    }


def _around_plan(plan: LastPlan, projection: Projection) -> list[Feature]:
    features = [
        _ellipse(outline, f"planned surfacing {number}", projection)
        for number, outline in enumerate(plan.ellipses, start=1)
    ]
    for area in plan.areas:
        longitude, latitude = np.array([*area.corners, area.corners[0]]).T
        ring = _line(longitude, latitude, projection)
        about = {"name": f"no-go area {area.name}", "surface_only": area.surface_only}
        features.append(_feature("Polygon", [ring], about, _STYLES["no_go"]))
    return features


def _ellipse(outline: Array, of: str, projection: Projection) -> Feature:
    ring = _line(*to_geographic(projection, *outline.T), projection)
    return _feature("Polygon", [ring], {"name": f"90 % ellipse of {of}"}, _STYLES["ellipse"])


def geojson_text(features: list[Feature]) -> str:
    """Return features as GeoJSON, with colours and widths in the properties of Mapbox's simplestyle 1.1."""
    plain = [{key: value for key, value in one.items() if key != "when"} for one in features]
    return collection_text(plain, indent=1) + "\n"


def kml_text(features: list[Feature]) -> str:
    """Return features as KML 2.2 with times, for the slider of Google Earth; ways are tracks of its extension."""
    places = "".join(_placemark(one) for one in features)
    names = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml {names}><Document>\n{places}</Document></kml>\n'


def _placemark(feature: Feature) -> str:
    kind, at = feature["geometry"]["type"], feature["geometry"]["coordinates"]
    about = feature["properties"]
    data = "".join(
        f'<Data name="{escape(key)}"><value>{escape(str(value))}</value></Data>'
        for key, value in about.items()
        if key != "name" and key not in _STYLE_KEYS
    )
    points = [at] if kind == "Point" else at[0] if kind == "Polygon" else at
    # KML has no longitudes beyond 180
    places = [((longitude + 180.0) % 360.0 - 180.0, latitude) for longitude, latitude in points]
    head = f"<name>{escape(about['name'])}</name>{_time_kml(about)}{_style_kml(about)}<ExtendedData>{data}</ExtendedData>"
    if "when" in feature:
        track = "".join(f"<when>{time}</when>" for time in feature["when"])
        track += "".join(
            f"<gx:coord>{longitude:.7f} {latitude:.7f} 0</gx:coord>"
            for longitude, latitude in places
        )
        return f"<Placemark>{head}<gx:Track>{track}</gx:Track></Placemark>\n"
    shape = f"<coordinates>{' '.join(f'{longitude:.7f},{latitude:.7f}' for longitude, latitude in places)}</coordinates>"
    shape = (
        f"<outerBoundaryIs><LinearRing>{shape}</LinearRing></outerBoundaryIs>"
        if kind == "Polygon"
        else shape
    )
    return f"<Placemark>{head}<{kind}>{shape}</{kind}></Placemark>\n"


def _time_kml(about: Mapping[str, Any]) -> str:
    """Return the time of a feature; a way has those of its points."""
    return f"<TimeStamp><when>{about['time']}</when></TimeStamp>" if "time" in about else ""


def _style_kml(about: Mapping[str, Any]) -> str:
    """Return a style: KML's colours are opacity, blue, green, red."""

    def color(name: str, opacity: float) -> str:
        red, green, blue = (about[name][k : k + 2] for k in (1, 3, 5))
        return f"<color>{round(255 * opacity):02x}{blue}{green}{red}</color>"

    if "marker-color" in about:
        return f"<Style><IconStyle>{color('marker-color', 1.0)}</IconStyle></Style>"
    line = f"<LineStyle>{color('stroke', 1.0)}<width>{about['stroke-width']}</width></LineStyle>"
    fill = (
        f"<PolyStyle>{color('fill', about['fill-opacity'])}</PolyStyle>" if "fill" in about else ""
    )
    return f"<Style>{line}{fill}</Style>"


def named(found: Feature, vehicle: str) -> Feature:
    """Return a feature as one of several vehicles', with its name before the feature's."""
    about = found["properties"]
    return {
        **found,
        "properties": {**about, "name": f"{vehicle} {about['name']}", "vehicle": vehicle},
    }


def _feature(
    kind: str, coordinates: Any, about: dict[str, Any], style: Mapping[str, Any]
) -> Feature:
    return feature(kind, coordinates, {**about, **style})


def _line(longitude: Any, latitude: Any, projection: Projection) -> list[list[float]]:
    return positions(longitude, latitude, projection.longitude)


def _time(value: Any) -> str:
    return f"{pd.Timestamp(value).isoformat()}Z"


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
