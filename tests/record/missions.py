"""Missions of every kind, what a planner says of each, and what other code meets that flies its commands.

The sets are those of ``SETS``. A set's seeds are part of its definition: a mission's number in it is its name.
"""

from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import Geod
from scipy.interpolate import RegularGridInterpolator

import replay_kit as rk
from planners import (
    Bathymetry,
    Glider,
    Line,
    MissionPlan,
    MissionRequest,
    MissionSettings,
    Mooring,
    NoGo,
    plan_line,
    plan_mission,
    plan_mooring,
)
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.plan import Place
from tests.planners.hazardous import random_mission
from tests.reference.vehicle import Sea, fly_commands

_FLOW = Path(__file__).parent / "files" / "missions_flow.nc"
# Corners of three areas between a start and a goal [degrees].
_AREAS = (
    "152.564 -40.2281 152.5367 -40.1947 152.5281 -40.1953 152.507 -40.2346 152.4586 -40.2524 152.5487 -40.2906",
    "152.5188 -40.2169 152.4796 -40.2163 152.4502 -40.2408 152.5048 -40.2386 152.5064 -40.2545 152.6152 -40.2442",
    "152.5585 -40.2178 152.5113 -40.1714 152.5036 -40.1958 152.5117 -40.294 152.5671 -40.2938 152.5705 -40.3116",
)
# Longest step of the flights [s]; points at which the bottom is looked at are so far apart at most [m].
_STEP, _APART = 120.0, 2.0
_GEOD = Geod(ellps="WGS84")
_LOW, _HIGH = (151.8, -40.3), (153.2, -39.7)
_SIX_HOURS_NS = 6 * 3600 * 10**9
# Seconds a leg of the random missions drifts at the surface.
_DRIFT = 600.0

Planning = Callable[[Any, MissionRequest], MissionPlan]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A mission to plan.

    Attributes:
        flow: The current, or one at each of some times.
        request: What is asked.
        planned: What answers it.
    """

    flow: Sequence[FlowEstimate]
    request: MissionRequest
    planned: Planning = plan_mission


@cache
def _sea() -> FlowEstimate:
    """Return the estimate of the sample survey by three levels, 60 modes, without its uncertainty."""
    return rk.open_estimate(_FLOW)


def _times(scale: float) -> list[FlowEstimate]:
    """Return that current with its speeds scaled."""
    return [replace(_sea(), latent=scale * _sea().latent)]


def _asked(
    start: Any, goals: Any, speed: float, no_go: Any = (), bottom: Any = None, **how: Any
) -> MissionRequest:
    """Return a request from a place to others: longitude, latitude and, below the surface, depth."""
    first, *others = (Place(*at, *[0.0] * (3 - len(at))) for at in (start, *goals))
    settings = MissionSettings(**how)
    return MissionRequest(first, tuple(others), Glider(speed=speed), settings, tuple(no_go), bottom)


def _pair(rng: np.random.Generator, least: float, most: float) -> list[tuple[float, float]]:
    """Return two random places that are some distance apart [km]."""
    while True:
        ends = [
            (float(rng.uniform(_LOW[0], _HIGH[0])), float(rng.uniform(_LOW[1], _HIGH[1])))
            for _ in range(2)
        ]
        way = np.subtract(*ends) * [85.0, 111.0]
        if least < np.hypot(*way) < most:
            return ends


def _free(seed: int, count: int) -> Iterator[Case]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        scale, (a, b) = float(rng.choice([0.4, 0.7, 1.0])), _pair(rng, 10, 70)
        speed, depth, drift = (
            float(rng.choice(of)) for of in ([0.2, 0.25, 0.3, 0.35], [150, 300, 450], [0.0, _DRIFT])
        )
        yield Case(_times(scale), _asked(a, [b], speed, depth=depth, surface_time=drift))


def _among_areas(seed: int, count: int) -> Iterator[Case]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        scale, (a, b), areas = float(rng.choice([0.3, 0.5, 0.8])), _pair(rng, 20, 60), []
        for number in range(rng.integers(2, 5)):
            centre = _between(rng, a, b, (0.05, 0.04))
            angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 6))
            radii = rng.uniform(0.01, 0.09, 6)
            ring = centre + radii[:, None] * np.column_stack([np.cos(angles) * 1.3, np.sin(angles)])
            areas.append(NoGo(tuple(map(tuple, ring.tolist())), f"area {number}"))
        depth = float(rng.choice([200, 300, 450]))
        yield Case(_times(scale), _asked(a, [b], 0.3, areas, depth=depth, surface_time=_DRIFT))


def _between(rng: np.random.Generator, a: Any, b: Any, spread: tuple[float, float]) -> Array:
    """Return a random place near to the straight way from one to another [degrees]."""
    share = rng.uniform(0.2, 0.8)
    return np.array([a[k] + share * (b[k] - a[k]) + rng.normal(0.0, spread[k]) for k in (0, 1)])


def _over_bottom(seed: int, count: int) -> Iterator[Case]:
    rng = np.random.default_rng(seed)
    axes = np.arange(151.5, 153.51, 0.02), np.arange(-40.55, -39.44, 0.02)
    longitude, latitude = np.meshgrid(*axes)
    for number in range(count):
        scale, (a, b) = float(rng.choice([0.3, 0.5, 0.8])), _pair(rng, 15, 50)
        depth = np.full(longitude.shape, 600.0)
        for _ in range(rng.integers(2, 6)):
            x, y = _between(rng, a, b, (0.08, 0.06))
            radius, top = rng.uniform(0.05, 0.2), rng.uniform(30.0, 300.0)
            away = ((longitude - x) ** 2 * 0.59 + (latitude - y) ** 2) / radius**2
            depth = np.minimum(depth, top + (600.0 - top) * np.minimum(away, 1.0))
        if number % 3 == 2:  # a shelf
            depth = np.minimum(depth, np.interp(latitude, [-40.4, -39.7], [80.0, 500.0]))
        deep, drift = (float(rng.choice(of)) for of in ([200, 300, 450], [0.0, _DRIFT]))
        bottom = Bathymetry(longitude, latitude, depth)
        asked = _asked(a, [b], 0.3, (), bottom, depth=deep, surface_time=drift)
        yield Case(_times(scale), asked)


def _strong(seed: int, count: int) -> Iterator[Case]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        scale, (a, b) = float(rng.choice([1.0, 1.5, 2.0])), _pair(rng, 10, 60)
        speed, depth, drift = (
            float(rng.choice(of)) for of in ([0.1, 0.15, 0.2, 0.25], [200, 450], [0.0, _DRIFT])
        )
        yield Case(_times(scale), _asked(a, [b], speed, depth=depth, surface_time=drift))


def _three() -> Iterator[Case]:
    rings = [np.array(corners.split(), dtype=np.float64).reshape(-1, 2) for corners in _AREAS]
    areas = [NoGo(tuple(map(tuple, ring)), f"area {k}") for k, ring in enumerate(rings)]
    for scale in (1.0, 0.8, 0.5):
        ends = (152.7567, -40.2136), [(152.4509, -40.2704)]
        yield Case(_times(scale), _asked(*ends, 0.3, areas, depth=450.0, surface_time=_DRIFT))


def _near_edges() -> Iterator[Case]:
    """Yield missions among polygons of three to six corners, two of which a planner passed too closely."""
    rng = np.random.default_rng(2)
    rng.random((50, 3))
    grid = _sea().grid
    axes = (grid.longitude, (0.25, 0.1)), (grid.latitude, (0.15, 0.1))
    for _ in range(4):
        speed, depth, drift = (
            float(rng.choice(of))
            for of in ([0.08, 0.12, 0.2, 0.25, 0.3, 0.35], [150, 300, 450], [0, 600])
        )
        start = [rng.uniform(axis.min() + off, axis.max() - off) for axis, (off, _) in axes]
        towards, far = rng.uniform(0.0, 360.0), rng.uniform(8e3, 45e3)
        goals = [_GEOD.fwd(*start, towards + turned, far)[:2] for turned in (0.0, 180.0)]
        inside = [
            goal
            for goal in goals
            if all(
                axis.min() + off < at < axis.max() - off
                for at, (axis, (_, off)) in zip(goal, axes, strict=True)
            )
        ]
        if inside:
            areas = list(_polygons(rng, start, inside[0]))
            asked = _asked(start, inside[:1], speed, areas, depth=depth, surface_time=drift)
            yield Case(_times(0.4), asked)


def _polygons(rng: np.random.Generator, start: Any, goal: Any) -> Iterator[NoGo]:
    ends = shapely.MultiPoint([start, goal])
    for number in range(rng.integers(0, 4)):
        share = rng.uniform(0.3, 0.7)
        centre = [start[k] + share * (goal[k] - start[k]) + rng.normal(0.0, 0.03) for k in (0, 1)]
        radius, corners = rng.uniform(1e3, 4e3), int(rng.integers(3, 7))
        ring = [
            _GEOD.fwd(*centre, angle, radius * rng.uniform(0.5, 1.0))[:2]
            for angle in np.sort(rng.uniform(0.0, 360.0, corners))
        ]
        polygon = shapely.Polygon(ring)
        if polygon.is_valid and polygon.distance(ends) > 0.012:
            yield NoGo(tuple(ring), f"area {number}")


def _kinds() -> Iterator[Case]:
    """Yield a mission of each kind: goals in order, at depth; dives a leg; energy; depths chosen; a line; moorings; changing currents."""
    a, b, c, d = (152.0, -40.1), (152.6, -39.9), (152.35, -40.25), (152.4, -39.8)
    usual = {"depth": 300.0, "surface_time": _DRIFT}
    for asked in (
        _asked(a, [c, b, d], 0.3, **usual),
        _asked(a, [b, a], 0.3, depth=450.0),
        _asked(a, [(*b, 200.0)], 0.3, **usual),
        _asked(a, [(*c, 150.0), b], 0.3, **usual),
        _asked((*a, 100.0), [b], 0.3, **usual),
        _asked(a, [b], 0.3, depth=100.0, yos=3, surface_time=_DRIFT),
        _asked(a, [b], 0.3, objective="energy", **usual),
    ):
        yield Case(_times(0.6), asked)
    deep = {"depth": 450.0, "depths": (100.0, 450.0)}
    across = (152.9, -40.2), [(152.3, -39.8)]
    for ends, how in (
        (across, {"surface_time": _DRIFT}),
        (across, {"surface_time": _DRIFT, "objective": "energy"}),
        (((152.0, -39.9), [(152.6, -40.2)]), {}),
    ):
        yield Case(_times(1.0), _asked(*ends, 0.3, **deep, **how))
    yield Case(
        _times(0.25),
        _asked(a, [b], 0.3, **usual),
        lambda flow, asked: plan_line(flow, asked, Line()),
    )
    here, stay = (152.4, -39.9), Mooring(3000.0, 48 * 3600.0)
    for scale in (0.3, 0.6):
        asked = _asked(here, [here], 0.3, **usual)
        yield Case(_times(scale), asked, lambda flow, asked: plan_mooring(flow, asked, stay))
    begin_ns = _sea().time_ns or 0
    changing = [
        replace(_sea(), time_ns=begin_ns + k * _SIX_HOURS_NS, latent=share * _sea().latent)
        for k, share in enumerate(np.cos(np.arange(12) / 9.0 * np.pi))
    ]
    for start, goal, depth in (
        (a, b, 300.0),
        (*[(152.9, -40.2), (152.3, -39.8)], 450.0),
        (*[(151.8, -39.8), (152.2, -40.2)], 200.0),
    ):
        asked = _asked(start, [goal], 0.3, depth=depth, surface_time=_DRIFT)
        yield Case(changing, replace(asked, start_time_ns=begin_ns))


def _hazardous(count: int, speeds: tuple[float, float]) -> Iterator[Case]:
    for seed in range(count):
        mission = random_mission(seed, speeds)
        yield Case(mission.flow, mission.request)


#: The missions of each set, in order.
SETS: dict[str, Callable[[], Iterator[Case]]] = {
    "free": lambda: _free(21, 16),
    "areas": lambda: _among_areas(11, 14),
    "more areas": lambda: _among_areas(77, 14),
    "bottom": lambda: _over_bottom(9, 9),
    "strong": lambda: _strong(5, 12),
    "three": _three,
    "edges": _near_edges,
    "kinds": _kinds,
    "hazards": lambda: _hazardous(300, (0.03, 0.15)),
    "hazards in strong eddies": lambda: _hazardous(100, (0.15, 0.35)),
}


def answers(name: str, numbers: Container[int] | None = None) -> dict[str, dict[str, Any]]:
    """Return what is said of the missions of a set, by their numbers.

    Args:
        name: Of the set.
        numbers: Of the missions wanted; None for all.
    """
    return {
        str(k): answer(case)
        for k, case in enumerate(SETS[name]())
        if numbers is None or k in numbers
    }


def answer(case: Case) -> dict[str, Any]:
    """Return what is said of a mission, and what comes of it where its commands are flown by other code.

    ``stated_miss``, ``miss``, ``clearance`` of areas and ``above_bottom`` are metres; what there is none of is left out.
    """
    flow = case.flow if len(case.flow) > 1 else case.flow[0]
    try:
        plan = case.planned(flow, case.request)
    except rk.ReplayKitError:
        return {"status": "refused"}
    said = {"status": plan.status, "hours": plan.duration / 3600.0, "legs": len(plan.headings_deg)}
    if not said["legs"]:
        return said
    track = fly_commands(Sea(case.flow, case.request.start_time_ns, _STEP), plan)
    flown = {
        "stated_miss": float(np.max(plan.closest_approach, initial=0.0)),
        "miss": _missed(case, track, plan),
        "clearance": _clearance(case, track),
        "above_bottom": _above_bottom(case, track),
    }
    return said | {name: value for name, value in flown.items() if value is not None}


def _missed(case: Case, track: Array, plan: MissionPlan) -> float:
    """Return how far a flight ends from its last goal; of a mooring, a line or a goal below the surface, from where the plan does [m]."""
    goal, end = case.request.goals[-1], plan.track[-1, :2]
    if goal.depth == 0.0 and case.planned is plan_mission:
        frame = case.flow[0].grid.projection
        end = np.array(to_local(frame, goal.longitude, goal.latitude))
    return float(np.linalg.norm(track[-1, :2] - end))


def _fine(track: Array) -> Array:
    """Return points of a track that are near to each other, shape (n, 3) [m]."""
    parts = [
        np.linspace(a, b, int(np.linalg.norm(b - a) / _APART) + 1, endpoint=False)
        for a, b in pairwise(track)
    ]
    return np.concatenate([*parts, track[-1:]])


def _clearance(case: Case, track: Array) -> float | None:
    """Return the least distance to the areas [m], to those for the surface alone where the track is there; 0 inside."""
    frame, found = case.flow[0].grid.projection, []
    for area in case.request.no_go:
        ring = shapely.make_valid(
            shapely.Polygon(np.column_stack(to_local(frame, *np.array(area.polygon).T)))
        )
        way = shapely.LineString(track[:, :2])
        if area.surface_only:
            points = _fine(track)
            way = shapely.MultiPoint(points[points[:, 2] <= 1e-3, :2])
        found.append(float(shapely.distance(ring, way)))
    return min(found, default=None)


def _above_bottom(case: Case, track: Array) -> float | None:
    """Return the least height above the bottom, linear between the points of its grid [m]."""
    bottom = case.request.bathymetry
    if bottom is None:
        return None
    points = _fine(track)
    at = to_geographic(case.flow[0].grid.projection, points[:, 0], points[:, 1])
    axes = bottom.latitude[:, 0], bottom.longitude[0]
    depth = RegularGridInterpolator(axes, bottom.depth)(np.column_stack(at[::-1]))
    return float(np.min(depth - points[:, 2]))
