"""Map features as GeoJSON with Mapbox's simplestyle 1.1, and as KML 2.2 with times."""

from collections.abc import Mapping, Sequence
from typing import Any
from xml.sax.saxutils import escape

from replay_kit.core.region import Feature, collection_text
from replay_kit.core.words.colors import LIGHT
from replay_kit.show.figures.style import ON_MAP

# What KML has in elements of its own, or only a drawing needs.
_OWN = frozenset({"name", "description", "coordTimes", "depth_m", "role", "last"})


def styled(one: Feature) -> Feature:
    """Return a feature with colours and widths as simplestyle properties."""
    look = ON_MAP.get(one["properties"]["role"], {"kind": "points", "color": "three"})
    color = LIGHT.get(look["color"], look["color"])
    if look["kind"] == "points":
        style: dict[str, Any] = {"marker-color": color, "marker-size": "small"}
    else:
        style = {"stroke": color, "stroke-width": look.get("width", 3), "stroke-opacity": 1.0}
        style |= {"fill": color, "fill-opacity": 0.15} if look["kind"] == "ring" else {}
    return {**one, "properties": {**one["properties"], **style}}


def geojson_text(features: Sequence[Feature]) -> str:
    """Return features as GeoJSON."""
    return collection_text([*map(styled, features)], indent=1) + "\n"


def kml_text(features: Sequence[Feature]) -> str:
    """Return features as KML with times for the slider of Google Earth; tracks use its extension."""
    places = "".join(map(_placemark, features))
    names = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml {names}><Document>\n{places}</Document></kml>\n'


def _placemark(one: Feature) -> str:
    about, kind = one["properties"], one["geometry"]["type"]
    style = {key: value for key, value in styled(one)["properties"].items() if key not in about}
    data = "".join(
        f'<Data name="{escape(key)}"><value>{escape(str(value))}</value></Data>'
        for key, value in about.items()
        if key not in _OWN
    )
    said = f"<description>{escape(about.get('description', ''))}</description>"
    when = about.get("time", "") if kind == "Point" else ""
    time = f"<TimeStamp><when>{when}</when></TimeStamp>" if when else ""
    head = f"<name>{escape(about['name'])}</name>{said if 'description' in about else ''}"
    head += f"{time}{_style(style)}"
    shape = _shape(kind, one["geometry"]["coordinates"], about.get("coordTimes", ()))
    return f"<Placemark>{head}<ExtendedData>{data}</ExtendedData>{shape}</Placemark>\n"


def _shape(kind: str, at: Any, times: Sequence[str]) -> str:
    """Return a KML geometry, with longitudes wrapped to 180 degrees."""
    if kind == "MultiPoint":
        return f"<MultiGeometry>{''.join(_shape('Point', one, ()) for one in at)}</MultiGeometry>"
    if kind == "Polygon":
        sides = zip(("outer", *["inner"] * len(at)), at, strict=False)
        rings = ((f"{side}BoundaryIs", _shape("LinearRing", ring, ())) for side, ring in sides)
        return f"<Polygon>{''.join(f'<{side}>{ring}</{side}>' for side, ring in rings)}</Polygon>"
    points = [at] if kind == "Point" else at
    places = [((longitude + 180.0) % 360.0 - 180.0, latitude) for longitude, latitude in points]
    if times:
        when = "".join(f"<when>{time}</when>" for time in times)
        each = (f"<gx:coord>{x:.7f} {y:.7f} 0</gx:coord>" for x, y in places)
        return f"<gx:Track>{when}{''.join(each)}</gx:Track>"
    text = f"<coordinates>{' '.join(f'{x:.7f},{y:.7f}' for x, y in places)}</coordinates>"
    return f"<{kind}>{text}</{kind}>"


def _style(style: Mapping[str, Any]) -> str:
    """Return a KML style; colours are in the order opacity, blue, green, red."""

    def color(name: str, opacity: float) -> str:
        red, green, blue = (style[name][k : k + 2] for k in (1, 3, 5))
        return f"<color>{round(255 * opacity):02x}{blue}{green}{red}</color>"

    if "marker-color" in style:
        return f"<Style><IconStyle>{color('marker-color', 1.0)}</IconStyle></Style>"
    line = f"<LineStyle>{color('stroke', 1.0)}<width>{style['stroke-width']}</width></LineStyle>"
    filled = (
        f"<PolyStyle>{color('fill', style.get('fill-opacity', 1.0))}</PolyStyle>"
        if "fill" in style
        else ""
    )
    return f"<Style>{line}{filled}</Style>"
