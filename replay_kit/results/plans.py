"""Plans of a result: read back as values, and as map features for channels, files, pages and figures.

Each feature has a ``role`` for its style, a ``name``, ``time`` or, for several positions, ``coordTimes``, and a ``description``. Longitudes
are continuous across the antimeridian.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area, Odds, Place, Plan, plan_legs
from replay_kit.core.region import Feature, feature, positions
from replay_kit.core.surfacing import planned_ellipses
from replay_kit.results.mcap.schemas import MESSAGES, attributes, decode, numbers
from replay_kit.results.reader import ResultReader

# Positions of a plan; more are thinned. Its figures, and whence they are.
_PLANNED = 1000
_FIGURES = "heading_deg glide_angle_deg duration_s=duration closest_approach_m=closest_approach energy_j=energy battery_j=battery"


def last_plan(reader: ResultReader) -> Plan | None:
    """Return the last plan of a result, with its areas but fences; None without plans."""
    _, data = next(reader.messages("/plan/controls", newest=True), (0, None))
    if data is None:
        return None
    # an unfinished result has none, one of an earlier version that of each plan
    drawn = next(reader.decoded("/plan/geojson", newest=True), None)
    return plan_of(decode("Plan", data), _areas(json.loads(drawn[1].geojson)) if drawn else ())


def plan_of(message: Any, areas: tuple[Area, ...] = ()) -> Plan:
    """Return the plan in a decoded ``replay_kit.Plan``; energies that are not known are NaN.

    Args:
        message: The message.
        areas: Areas of the plan, which it does not hold.
    """
    same = {
        field.name: getattr(message, field.name)
        for field in MESSAGES["Plan"]
        if not field.repeated and not field.type.startswith(".")
    }
    # a field that a message of 0.3 does not have reads as 0
    same |= {name: same[name] or np.nan for name in ("energy", "battery")}
    time, east, north, depth, bottom, velocity = (
        numbers("Plan", message, name)
        for name in (
            *("track_time", "track_east", "track_north", "track_depth"),
            *("track_bottom", "velocity_through_water"),
        )
    )
    start, goal, odds = (
        [getattr(getattr(message, part), field.name) for field in MESSAGES[kind]]
        for part, kind in (("start", "Place"), ("goal", "Place"), ("odds", "Odds"))
    )
    statistics = {pair.name: pair.value for pair in message.statistics}
    return Plan(
        **same,
        start=Place(*start),
        goal=Place(*goal),
        start_time_ns=message.timestamp.ToNanoseconds(),
        velocity_through_water=velocity,
        track_time=time,
        track=np.column_stack([east, north, depth]),
        statistics=statistics,
        legs=tuple(plan_legs(statistics)),
        odds=Odds(*odds) if message.odds.n_samples else None,
        areas=areas,
        bottom=bottom if np.isfinite(bottom).any() else None,
    )


def _areas(geojson: Mapping[str, Any]) -> tuple[Area, ...]:
    """Return the no-go areas of a plan's features; those of earlier versions have a kind for a role."""
    found = []
    for one in geojson["features"]:
        about, rings = one["properties"], one["geometry"]["coordinates"]
        if about.get("role", about.get("kind")) == "no_go":
            corners, *holes = (tuple((x, y) for x, y in ring[:-1]) for ring in rings)
            name = about.get("area", about["name"])
            found.append(Area(name, about["surface_only"], corners, tuple(holes)))
    return tuple(found)


def plan_features(plan: Plan, projection: Projection) -> Iterator[Feature]:
    """Yield track, areas, ellipses of surfacings, surfacings, start and goal of a plan."""
    made = {"time": time_text(plan.start_time_ns)}
    # a line of fewer than two positions is not GeoJSON; a failed plan may have none
    if len(plan.track) > 1:
        kept = thinned(len(plan.track), _PLANNED)
        times = times_of(plan.start_time_ns + np.rint(1e9 * plan.track_time[kept]))
        along = {"begin": times[0], "end": times[-1], "coordTimes": times}
        depths = [known(depth) for depth in np.round(plan.track[kept, 2], 1)]
        line = line_of(plan.track[kept, :2], projection)
        about = along | made | _numbers(plan) | {"depth_m": depths}
        yield placed("LineString", line, "plan", "last plan", about)
    for area in plan.areas:
        closed = (np.array([*ring, ring[0]]) for ring in (area.corners, *area.holes))
        rings = [positions(ring[:, 0], ring[:, 1], projection.longitude) for ring in closed]
        of_area: dict[str, Any] = {"area": area.name, "surface_only": area.surface_only}
        of_area |= {"description": "surface only"} if area.surface_only else {}
        role, what = ("fence", "fence") if area.fence else ("no_go", "no-go area")
        yield placed("Polygon", rings, role, f"{what} {area.name}", of_area)
    ellipses = planned_ellipses(plan.legs)
    for number, ellipse in enumerate(ellipses, start=1):
        name, last = f"90 % ellipse of planned surfacing {number}", number == len(ellipses)
        role = "ellipse" if number == 1 or last else "between"
        rings = [line_of(ellipse.outline(projection), projection)]
        yield placed("Polygon", rings, role, name, {**made, "last": last})
    for leg in plan.legs[:-1]:
        surfaces = time_text(plan.start_time_ns + round(1e9 * leg["surfacing_s"]))[:16]
        steer = f"{leg['heading_deg']:03.0f}° true, to {leg['depth_m']:.0f} m"
        about = {**made, "description": f"{surfaces.replace('T', ' ')}, {steer}"}
        at = point(leg["longitude"], leg["latitude"], projection)
        yield placed("Point", at, "planned", f"planned surfacing {leg['leg']}", about)
    for role, place in (("start", plan.start), ("goal", plan.goal)):
        deep = role == "goal" and np.isfinite(place.depth)
        name = f"goal, {place.depth:.0f} m" if deep else role
        about = {**made, "depth_m": known(place.depth)}
        yield placed("Point", point(place.longitude, place.latitude, projection), role, name, about)


def _numbers(plan: Plan) -> dict[str, Any]:
    """Return the known numbers of a plan, with its status and message."""
    each = attributes(plan, _FIGURES)
    each |= attributes(plan.odds, "samples=n_samples reached_share=reached") if plan.odds else {}
    found = {name: value for name, value in each.items() if np.isfinite(value)}
    return {"status": plan.status, "message": plan.message, **found}


def placed(kind: str, coordinates: Any, role: str, name: str, about: Mapping[str, Any]) -> Feature:
    """Return a feature with a role and a name."""
    return feature(kind, coordinates, {"role": role, "name": name, **about})


def point(longitude: float, latitude: float, projection: Projection) -> list[float]:
    """Return the position of a point [degrees], near the centre of the frame."""
    return positions([longitude], [latitude], projection.longitude)[0]


def line_of(places: Array, projection: Projection) -> list[list[float]]:
    """Return points of the local frame [m], shape (n, 2), as positions [degrees]."""
    return positions(*to_geographic(projection, *places.T), projection.longitude)


def known(value: float) -> float | None:
    """Return a number; None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def times_of(times_ns: ArrayLike) -> list[str]:
    """Return times [ns, UTC] as ISO 8601 to the second."""
    seconds = np.asarray(times_ns).astype("datetime64[ns]").astype("datetime64[s]")
    return [f"{text}Z" for text in np.datetime_as_string(seconds).tolist()]


def time_text(time_ns: Any) -> str:
    """Return a time [ns, UTC] as ISO 8601 to the second."""
    return times_of([time_ns])[0]


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of ``count`` indices, evenly spread, including the first and the last."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.intp))
