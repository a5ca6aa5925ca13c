"""Missions of every kind, what a planner says of each, and what other code meets that flies its commands.

``files/missions.json.xz`` holds what is asked in the current of ``files/missions_flow.nc``, by set: places (longitude, latitude [degrees]
and, below the surface, depth [m]), areas as their corners, mounts of the bottom (longitude, latitude, radius [degrees], least depth [m]).
The other sets are random missions among hazards, whose numbers are their seeds.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
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
)
from planners.plan import plan_mission
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.plan import Place
from tests.planners.hazardous import random_mission
from tests.record.record import FILES, checked, unpacked
from tests.reference.vehicle import Sea, fly_commands

#: Sets of random missions: their number, and the least and greatest RMS speed of the eddies at the first level [m/s].
HAZARDS = {"hazards": (300, (0.03, 0.15)), "hazards in strong eddies": (100, (0.15, 0.35))}
# Longest step of the flights [s]; points at which the bottom is looked at are so far apart at most [m].
_STEP, _APART = 120.0, 2.0
_SIX_HOURS_NS = 6 * 3600 * 10**9


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A mission to plan.

    Attributes:
        flow: The current, or one at each of some times.
        request: What is asked.
        kind: ``line`` or ``mooring``; empty for a mission to goals.
    """

    flow: Sequence[FlowEstimate]
    request: MissionRequest
    kind: str = ""

    def planned(self) -> MissionPlan:
        """Return what answers it."""
        flow = self.flow if len(self.flow) > 1 else self.flow[0]
        shapes = {"line": Line(), "mooring": Mooring(3e3, 48 * 3600.0), "": None}
        return plan_mission(flow, replace(self.request, shape=shapes[self.kind]))


@cache
def _asked() -> dict[str, Any]:
    return unpacked(FILES / "missions.json.xz")


def sets() -> list[str]:
    """Return the names of the sets."""
    return [*_asked(), *HAZARDS]


def cases(name: str) -> list[Callable[[], Case]]:
    """Return what makes each mission of a set, in order."""
    if name not in HAZARDS:
        return [partial(_case, asked) for asked in _asked()[name]]
    count, speeds = HAZARDS[name]
    return [partial(_random, seed, speeds) for seed in range(count)]


def _random(seed: int, speeds: tuple[float, float]) -> Case:
    mission = random_mission(seed, speeds)
    return Case(mission.flow, mission.request)


def _case(asked: Mapping[str, Any]) -> Case:
    sea = rk.open_estimate(checked(FILES / "missions_flow.nc"))
    begin_ns, scales = sea.time_ns or 0, [asked.get("scale", 1.0)]
    if asked.get("changes"):
        scales = np.cos(np.arange(12) / 9.0 * np.pi).tolist()
    flow = [
        replace(sea, time_ns=begin_ns + k * _SIX_HOURS_NS, latent=scale * sea.latent)
        for k, scale in enumerate(scales)
    ]
    start, *goals = (Place(*at, *[0.0] * (3 - len(at))) for at in (asked["start"], *asked["goals"]))
    settings = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in asked["settings"].items()
    }
    request = MissionRequest(
        start,
        tuple(goals),
        Glider(speed=asked["speed"]),
        MissionSettings(**settings),
        tuple(
            NoGo(tuple(map(tuple, ring)), f"area {k}")
            for k, ring in enumerate(asked.get("areas", ()))
        ),
        _bottom(asked["mounts"], asked["shelf"]) if "mounts" in asked else None,
        begin_ns if asked.get("changes") else 0,
    )
    return Case(flow, request, asked.get("kind", ""))


def _bottom(mounts: Sequence[Sequence[float]], shelf: bool) -> Bathymetry:
    """Return a bottom at 600 m with mounts, and perhaps a shelf that falls to the north."""
    axes = np.arange(151.5, 153.51, 0.02), np.arange(-40.55, -39.44, 0.02)
    longitude, latitude = np.meshgrid(*axes)
    depth = np.full(longitude.shape, 600.0)
    for x, y, radius, top in mounts:
        away = ((longitude - x) ** 2 * 0.59 + (latitude - y) ** 2) / radius**2
        depth = np.minimum(depth, top + (600.0 - top) * np.minimum(away, 1.0))
    if shelf:
        depth = np.minimum(depth, np.interp(latitude, [-40.4, -39.7], [80.0, 500.0]))
    return Bathymetry(longitude, latitude, depth)


def answers(name: str, numbers: Container[int] | None = None) -> dict[str, dict[str, Any]]:
    """Return what is said of the missions of a set, by their numbers.

    Args:
        name: Of the set.
        numbers: Of the missions wanted; None for all.
    """
    return {
        str(k): answer(case())
        for k, case in enumerate(cases(name))
        if numbers is None or k in numbers
    }


def answer(case: Case) -> dict[str, Any]:
    """Return what is said of a mission, and what comes of it where its commands are flown by other code.

    ``stated_miss``, ``miss``, ``clearance`` of areas and ``above_bottom`` are metres; what there is none of is left out.
    """
    try:
        plan = case.planned()
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


def _missed(case: Case, track: np.ndarray, plan: MissionPlan) -> float:
    """Return how far a flight ends from its last goal; of a mooring, a line or a goal below the surface, from where the plan does [m]."""
    goal, end = case.request.goals[-1], plan.track[-1, :2]
    if goal.depth == 0.0 and not case.kind:
        frame = case.flow[0].grid.projection
        end = np.array(to_local(frame, goal.longitude, goal.latitude))
    return float(np.linalg.norm(track[-1, :2] - end))


def _fine(track: np.ndarray) -> np.ndarray:
    """Return points of a track that are near to each other, shape (n, 3) [m]."""
    parts = [
        np.linspace(a, b, int(np.linalg.norm(b - a) / _APART) + 1, endpoint=False)
        for a, b in pairwise(track)
    ]
    return np.concatenate([*parts, track[-1:]])


def _clearance(case: Case, track: np.ndarray) -> float | None:
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


def _above_bottom(case: Case, track: np.ndarray) -> float | None:
    """Return the least height above the bottom, linear between the points of its grid [m]."""
    bottom = case.request.bathymetry
    if bottom is None:
        return None
    points = _fine(track)
    at = to_geographic(case.flow[0].grid.projection, points[:, 0], points[:, 1])
    axes = bottom.latitude[:, 0], bottom.longitude[0]
    depth = RegularGridInterpolator(axes, bottom.depth)(np.column_stack(at[::-1]))
    return float(np.min(depth - points[:, 2]))
