"""Plans and features of a result as GeoJSON, for channels, the page's map, printed maps, GeoJSON and KML; plans read back as values.

Each feature has a ``role`` for its style, a ``name``, ``time`` or, for several positions, ``coordTimes``, and a ``description``. Longitudes
are continuous across the antimeridian.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area, Odds, Place, Plan, plan_legs
from replay_kit.core.region import Feature, continuous_positions, feature
from replay_kit.core.surfacing import Ellipse, planned_ellipses
from replay_kit.results.innovations import thinned
from replay_kit.results.mcap.schemas import MESSAGES, attributes, decode, numbers
from replay_kit.results.reader import ResultReader

if TYPE_CHECKING:
    import pandas as pd

    from replay_kit.results.views.contents import Contents

#: Positions of a track, and of a plan; more are thinned.
POSITIONS, _PLANNED = 3000, 1000
# More fixes than these hide the track.
_FIXES = 150
#: The roles of features from the lowest on a map to the highest, with the table of an export whose rows they are of.
_TABLES = """
bottom- no_go-plans between-plans ellipse-plans past-surfacings track-track apart-surfacings fix-track begin-track predicted-surfacings
actual-surfacings plan-plans planned-plans start-plans vehicle-track goal-plans place-series
"""
ROLES = {role: table for role, _, table in (each.partition("-") for each in _TABLES.split())}
_ELLIPSE = [f"ellipse_{name}" for name in ("longitude", "latitude", "major", "minor", "bearing")]
# Figures of a plan, and whence they are.
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
    fields = MESSAGES["Plan"]
    same = [each.name for each in fields if not (each.repeated or each.type.startswith("."))]
    found: dict[str, Any] = {name: getattr(message, name) for name in same}
    # a field that a message of 0.3 does not have reads as 0
    found |= {name: found[name] or np.nan for name in ("energy", "battery")}
    lists = {
        each.name: numbers("Plan", message, each.name)
        for each in fields
        if each.type == "double" and each.repeated
    }
    bottom = lists["track_bottom"]
    statistics = {each.name: each.value for each in message.statistics}

    def part(kind: Callable[..., Any], held: Any) -> Any:
        return kind(*(getattr(held, each.name) for each in MESSAGES[kind.__name__]))

    return Plan(
        **found,
        start=part(Place, message.start),
        goal=part(Place, message.goal),
        via=tuple(part(Place, one) for one in message.via),
        odds=part(Odds, message.odds) if message.odds.n_samples else None,
        start_time_ns=message.timestamp.ToNanoseconds(),
        velocity_through_water=lists["velocity_through_water"],
        track_time=lists["track_time"],
        track=np.column_stack([lists[f"track_{axis}"] for axis in ("east", "north", "depth")]),
        statistics=statistics,
        legs=tuple(plan_legs(statistics)),
        areas=areas,
        bottom=bottom if np.isfinite(bottom).any() else None,
    )


def _areas(geojson: Mapping[str, Any]) -> tuple[Area, ...]:
    """Return the no-go areas of a plan's features; those of earlier versions have a kind for a role."""
    found = []
    for area in geojson["features"]:
        about, rings = area["properties"], area["geometry"]["coordinates"]
        if about.get("role", about.get("kind")) == "no_go":
            corners, *holes = (tuple((x, y) for x, y in ring[:-1]) for ring in rings)
            name = about.get("area", about["name"])
            found.append(Area(name, about["surface_only"], corners, tuple(holes)))
    return tuple(found)


def features_of(contents: "Contents") -> list[Feature]:
    """Return the features of a result, with names of several vehicles, in drawing order."""
    found = []
    for vehicle, of_vehicle in contents.each.items():
        plan = of_vehicle.last_plan
        planned = plan_features(plan, of_vehicle.projection) if plan is not None else ()
        for each in (*planned, *_track_features(of_vehicle), *_surfacing_features(of_vehicle)):
            about = each["properties"]
            about |= {"name": f"{vehicle} {about['name']}", "vehicle": vehicle} if vehicle else {}
            found.append(each)
    order = [*ROLES]
    return sorted(found, key=lambda item: order.index(item["properties"]["role"]))


def features_until(features: Sequence[Feature], time_ns: int | None) -> list[Feature]:
    """Return the features up to a time [ns, UTC]; all for None."""
    if time_ns is None:
        return [*features]
    end, kept = time_text(time_ns), []
    for item in features:
        about, shape = item["properties"], item["geometry"]
        # a plan is made at its time, also where it leads on
        if "time" in about or "coordTimes" not in about:
            kept += [item] if about.get("time", "") <= end else []
        elif count := sum(time <= end for time in about["coordTimes"]):
            shape = {**shape, "coordinates": shape["coordinates"][:count]}
            times = {"coordTimes": about["coordTimes"][:count]}
            kept.append({**item, "geometry": shape, "properties": {**about, **times}})
    return kept


def plan_features(plan: Plan, projection: Projection) -> Iterator[Feature]:
    """Yield track, areas, ellipses of surfacings, surfacings, start and goals of a plan."""
    made = {"time": time_text(plan.start_time_ns)}
    kept = thinned(len(plan.track), _PLANNED)
    times = plan.start_time_ns + np.rint(1e9 * plan.track_time[kept])
    at = line_of(plan.track[kept, :2], projection)
    about: dict[str, Any] = {**made, "status": plan.status, "message": plan.message}
    yield from _line(at, times, plan.track[kept, 2], "plan", "last plan", about | _numbers(plan))
    for area in plan.areas:
        closed = (np.array([*ring, ring[0]]) for ring in (area.corners, *area.holes))
        rings = [
            continuous_positions(ring[:, 0], ring[:, 1], projection.longitude) for ring in closed
        ]
        of_area: dict[str, Any] = {"area": area.name, "surface_only": area.surface_only}
        of_area |= {"description": "surface only"} if area.surface_only else {}
        role, what = ("fence", "fence") if area.fence else ("no_go", "no-go area")
        yield placed_feature("Polygon", rings, role, f"{what} {area.name}", of_area)
    ellipses = planned_ellipses(plan.legs)
    # a plan is of the time when it was made, its surfacings are at theirs
    ends = [time_text(plan.start_time_ns + round(1e9 * leg["surfacing_s"])) for leg in plan.legs]
    for number, ellipse in enumerate(ellipses, start=1):
        last = number == len(ellipses)
        role, name = "ellipse" if number == 1 or last else "between", f"planned surfacing {number}"
        about = {**made, "last": last, "surfaces": ends[number - 1]}
        yield _ring(ellipse, projection, role, f"90 % ellipse of {name}", about)
    for leg, end in zip(plan.legs[:-1], ends, strict=False):
        steer = f"{leg['heading_deg']:03.0f}° true, to {leg['depth_m']:.0f} m"
        words = f"{end[:16].replace('T', ' ')}, {steer}"
        about = {**made, "surfaces": end, "description": words}
        at_leg = point(leg["longitude"], leg["latitude"], projection)
        yield placed_feature("Point", at_leg, "planned", f"planned surfacing {leg['leg']}", about)
    goals = [*plan.via, plan.goal]
    for number, place in enumerate([plan.start, *goals]):
        role = "goal" if number else "start"
        name = f"goal {number}" if number and plan.via else role
        name += f", {place.depth:.0f} m" if number and np.isfinite(place.depth) else ""
        about = {**made, "depth_m": finite_or_none(place.depth)}
        yield placed_feature(
            "Point", point(place.longitude, place.latitude, projection), role, name, about
        )


def _numbers(plan: Plan) -> dict[str, float]:
    """Return the known numbers of a plan."""
    each = attributes(plan, _FIGURES)
    each |= attributes(plan.odds, "samples=n_samples reached_share=reached") if plan.odds else {}
    return {name: value for name, value in each.items() if np.isfinite(value)}


def place_features(series: "pd.DataFrame", projection: Projection) -> list[Feature]:
    """Return the last current at each position of a table of series."""
    found = []
    for number, rows in series.groupby("place") if len(series) else ():
        last = rows.iloc[-1]
        names = ("u", "v", "u_standard_error", "v_standard_error")
        about = {"time": time_text(last["time"]), "depth_m": float(last["depth"])}
        about |= {f"{key}_m_s": finite_or_none(last[key]) for key in names}
        at = point(last["longitude"], last["latitude"], projection)
        found.append(placed_feature("Point", at, "place", f"place {number}", about))
    return found


def _track_features(contents: "Contents") -> Iterator[Feature]:
    track = contents.track
    if track.time_ns.size == 0:
        return
    rows = thinned(track.time_ns.size, POSITIONS)
    at = continuous_positions(
        track.longitude[rows], track.latitude[rows], contents.projection.longitude
    )
    yield from _line(at, track.time_ns[rows], track.depth[rows], "track", "track", {})
    times, fixes = times_of(track.time_ns[rows]), np.flatnonzero(~track.dead_reckoned[rows])
    # of a vessel every position is a fix, and circles around all hide the track
    if 0 < fixes.size <= min(_FIXES, 0.5 * rows.size):
        about = {"coordTimes": [times[k] for k in fixes]}
        yield placed_feature("MultiPoint", [at[k] for k in fixes], "fix", "fixes", about)
    for role, k in (("begin", 0), ("vehicle", -1)):
        yield placed_feature("Point", at[k], role, role, {"time": times[k]})


def _surfacing_features(contents: "Contents") -> Iterator[Feature]:
    table, projection = contents.result.surfacings, contents.projection
    for row in table.reset_index().to_dict("records"):
        at = {
            kind: point(row[f"{kind}_longitude"], row[f"{kind}_latitude"], projection)
            for kind in ("predicted", "actual")
        }
        time, far = {"time": time_text(row["time"])}, row["distance"]
        about = {**time, "distance_m": finite_or_none(far), "description": f"{far:.0f} m apart"}
        # a line joins each predicted surfacing to the actual one
        yield placed_feature("LineString", [*at.values()], "apart", "surfacing, apart", about)
        for kind, place in at.items():
            yield placed_feature("Point", place, kind, f"surfacing, {kind}", about)
        ellipse = Ellipse(*(row[name] for name in _ELLIPSE))
        if np.isfinite(ellipse.major):
            past = {**time, "surfaces": time["time"]}
            yield _ring(ellipse, projection, "past", "90 % ellipse of a surfacing", past)


def _line(
    at: Sequence[Any],
    times_ns: ArrayLike,
    depth: Array,
    role: str,
    name: str,
    about: Mapping[str, Any],
) -> Iterator[Feature]:
    """Yield a line through positions with times and depths; a line of fewer than two positions is not GeoJSON."""
    if len(at) > 1:
        times, depths = times_of(times_ns), [finite_or_none(each) for each in np.round(depth, 1)]
        along = {"begin": times[0], "end": times[-1], "coordTimes": times, **about}
        yield placed_feature("LineString", at, role, name, {**along, "depth_m": depths})


def _ring(
    ellipse: Ellipse, projection: Projection, role: str, name: str, about: Mapping[str, Any]
) -> Feature:
    return placed_feature(
        "Polygon", [line_of(ellipse.outline(projection), projection)], role, name, about
    )


def placed_feature(
    kind: str, coordinates: Any, role: str, name: str, about: Mapping[str, Any]
) -> Feature:
    """Return a feature with a role and a name."""
    return feature(kind, coordinates, {"role": role, "name": name, **about})


def point(longitude: float, latitude: float, projection: Projection) -> list[float]:
    """Return the position of a point [degrees], near the centre of the frame."""
    return continuous_positions([longitude], [latitude], projection.longitude)[0]


def line_of(places: Array, projection: Projection) -> list[list[float]]:
    """Return points of the local frame [m], shape (n, 2), as positions [degrees]."""
    return continuous_positions(*to_geographic(projection, *places.T), projection.longitude)


def finite_or_none(value: float) -> float | None:
    """Return a number; None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def times_of(times_ns: ArrayLike) -> list[str]:
    """Return times [ns, UTC] as ISO 8601 to the second."""
    seconds = np.asarray(times_ns).astype("datetime64[ns]").astype("datetime64[s]")
    return [f"{text}Z" for text in np.datetime_as_string(seconds).tolist()]


def time_text(time_ns: Any) -> str:
    """Return a time [ns, UTC] as ISO 8601 to the second."""
    return times_of([time_ns])[0]
