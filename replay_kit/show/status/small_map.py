"""A small map of a status, as SVG."""

from collections.abc import Mapping, Sequence

from replay_kit.core.colors import SYMBOLS

_WIDE, _HIGH, _EDGE = 360.0, 240.0, 22.0
Points = Sequence[tuple[float, float]]


def small_map(places: Mapping[str, Points]) -> str:
    """Return a map of the vehicle's way, the plan, its goal and the ellipse of the next surfacing; empty without two places.

    Args:
        places: Points (east, north) [m] of ``track``, ``plan``, ``goal`` and ``ellipse``, those that are known.
    """
    every = [point for points in places.values() for point in points]
    if len(set(every)) < 2:
        return ""
    west, east = (end(point[0] for point in every) for end in (min, max))
    south, north = (end(point[1] for point in every) for end in (min, max))
    scale = min(
        (_WIDE - 2.0 * _EDGE) / max(east - west, 1.0),
        (_HIGH - 2.0 * _EDGE) / max(north - south, 1.0),
    )

    def at(point: tuple[float, float]) -> tuple[float, float]:
        x = 0.5 * _WIDE + scale * (point[0] - 0.5 * (west + east))
        return x, 0.5 * _HIGH - scale * (point[1] - 0.5 * (south + north))

    def line(points: Points) -> str:
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))

    ink, plan = (f"var(--{SYMBOLS[name][0]})" for name in ("track", "plan"))
    track, legs = places.get("track", ()), places.get("plan", ())
    out = []
    if "ellipse" in places:
        out.append(f'<polygon points="{line(places["ellipse"])}" fill="{plan}" opacity=".25"/>')
    # of the way only some fixes are known here
    out.append(
        f'<polyline points="{line(track)}" fill="none" stroke="{ink}" stroke-width="2" stroke-dasharray="2 4"/>'
    )
    way = [*track[-1:], *legs]
    out.append(f'<polyline points="{line(way)}" fill="none" stroke="{plan}" stroke-width="2"/>')
    out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{plan}"/>' for x, y in map(at, legs)]
    for x, y in map(at, track[-1:]):
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="{ink}"/>')
    for x, y in map(at, places.get("goal", ())):
        arms = f"M{x - 11:.1f} {y:.1f}h22M{x:.1f} {y - 11:.1f}v22"
        out.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="{plan}" stroke-width="2"/>'
        )
        out.append(f'<path d="{arms}" stroke="{plan}" stroke-width="2"/>')
    km = next(
        each
        for each in (500, 200, 100, 50, 20, 10, 5, 2, 1, 0.5, 0.1)
        if each * 1e3 * scale < 130 or each == 0.1
    )
    out.append(
        f'<path d="M12 {_HIGH - 12}h{1e3 * km * scale:.1f}" stroke="{ink}" stroke-width="2"/>'
    )
    out.append(f'<text x="12" y="{_HIGH - 17}" fill="{ink}" font-size="12">{km:g} km</text>')
    what = f"Map, north up, {(east - west) / 1e3:.0f} by {(north - south) / 1e3:.0f} km: {', '.join(places)}"
    return f'<svg class="map" viewBox="0 0 {_WIDE:g} {_HIGH:g}" role="img" aria-label="{what}">{"".join(out)}</svg>'
