"""Goals that a random flight has met, over shallows, past areas, one after the other: none is out of reach."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from planners import Glider, MissionRequest, MissionSettings, plan_mission
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, to_local
from tests.benchmarks.measure import Row, cpu, row
from tests.planners.flow_samples import place
from tests.planners.hazardous import LATITUDE, LONGITUDE, HazardousMission, random_mission
from tests.reference.vehicle import Sea

# Glide angles of the flights [degrees]: within those that a plan may have; their dives, at most [m], and longest steps [s].
_ANGLES, _DEPTH, _STEP = (16.0, 30.0), 300.0, 120.0
# Distance from areas, and from shallower water, that they keep at least [m]: some margins of a plan.
_AWAY, _AROUND = 200.0, 1500.0
# Directions tried for each leg; a plan may last so many times as long.
_TRIES, _LONGER = 40, 1.1


@dataclass(frozen=True, slots=True, eq=False)
class Met:
    """Where a random flight begins [m], the goals that it meets one after the other [m], and when it has met the last [s]."""

    start: np.ndarray
    goals: tuple[np.ndarray, ...]
    lasts: float


#: What is said of a mission: its status, whether a goal is out of reach, whether the bound is above a flight; the plan's time [s].
Reached = tuple[str, bool, bool, float]


def reach_row(missions: Sequence[Reached]) -> Row:
    """Return how many missions to goals that can be met were called out of reach, and how many bounds were above a flight."""
    statuses, out_of_reach, above, seconds = zip(*missions, strict=True)
    wrong = {"out_of_reach": float(sum(out_of_reach)), "bounds_above": float(sum(above))}
    name = f"{len(missions)} missions past one to three goals that a random flight has met: 0 out of reach"
    took = [one for one in seconds if one > 0.0] or [0.0]
    more = {"slowest_s": max(took), **Counter(statuses)}
    return row(name, float(np.median(took)), "", error=wrong, **more)


def one_mission(seed: int) -> Reached:
    """Return what is said of a mission past the goals of a random flight."""
    mission = random_mission(seed)
    if (met := _flight(mission, np.random.default_rng((1, seed)))) is None:
        return "no_flight", False, False, 0.0
    try:
        seconds, plan = cpu(lambda: plan_mission(mission.flow, _asked(mission, met)))
    except PlanError as error:
        return f"refused: {error}", False, False, 0.0
    bound = 3600.0 * float(plan.statistics.get("bound_h", 0.0))
    above = bound > min(met.lasts, plan.duration)
    return plan.status, "out of reach" in plan.message, above, seconds


def _asked(mission: HazardousMission, met: Met) -> MissionRequest:
    goals = tuple(place(mission.flow[0], *goal) for goal in met.goals)
    settings = MissionSettings(depth=_DEPTH, surface_time=300.0, max_duration=_LONGER * met.lasts)
    start = place(mission.flow[0], *met.start)
    return replace(mission.request, start=start, goals=goals, settings=settings)


def _flight(mission: HazardousMission, rng: np.random.Generator) -> Met | None:
    """Return what a flight of random legs meets that turns above the bottom and keeps clear of areas; None where it finds no way."""
    sea = replace(mission.sea, longest_step=_STEP)
    start = np.array([rng.uniform(-8e3, 8e3), rng.uniform(-6e3, 6e3)])
    if _room(mission, start[None]) < 30.0:
        return None
    at, towards, goals = (start, 0.0, 0.0), rng.uniform(0.0, 2.0 * np.pi), list[np.ndarray]()
    for _ in range(int(rng.integers(1, 4))):
        for _ in range(int(rng.integers(1, 5))):
            leg = _leg(mission, sea, at, towards, rng)
            if leg is None:
                return None
            at, towards = leg
        goals.append(at[0])
        *_, at = sea.drift(at, np.zeros(2), 0.0, 300.0)
    return Met(start, tuple(goals), at[2] - 300.0)


def _leg(
    mission: HazardousMission,
    sea: Sea,
    begin: tuple[np.ndarray, float, float],
    towards: float,
    rng: np.random.Generator,
) -> tuple[tuple[np.ndarray, float, float], float] | None:
    """Return the end of a leg and its heading [rad], near to that of the one before; None where none is clear."""
    vehicle = SimpleNamespace(vehicle=Glider())
    for k in range(_TRIES):
        heading = towards + rng.normal(0.0, 0.4 + 0.1 * k)
        angle = float(np.deg2rad(rng.uniform(*_ANGLES)))
        turn = min(_DEPTH, _room(mission, begin[0][None]))
        path = sea.dive(begin, vehicle, heading, angle, (0.0, turn, 0.0))  # type: ignore[arg-type]
        places = np.array([begin[0], *(at for at, *_ in path)])
        ahead = places[-1] + np.outer([0.0, 400.0], [np.sin(heading), np.cos(heading)])
        if _room(mission, np.vstack([places, ahead])) >= turn:
            return path[-1], heading
    return None


def _room(mission: HazardousMission, places) -> float:
    """Return how deep dives may go [m] around places, shape (n, 2) [m]; below 0 where they come near to an area or the region's edge."""
    frame, bottom = mission.flow[0].grid.projection, mission.request.bathymetry
    assert bottom is not None
    line = shapely.MultiPoint(places)
    for area in mission.request.no_go:
        ring = shapely.Polygon(np.column_stack(to_local(frame, *np.array(area.polygon).T)))
        if shapely.distance(ring, line) < _AWAY:
            return -1.0
    around = np.stack(np.meshgrid(*[[-_AROUND, 0.0, _AROUND]] * 2), axis=-1).reshape(-1, 2)
    points = (places[:, None] + around).reshape(-1, 2)
    if np.any(np.abs(points) > [35e3, 25e3]):
        return -1.0
    longitude, latitude = to_geographic(frame, *points.T)
    depth = RegularGridInterpolator((LATITUDE, LONGITUDE), bottom.depth)
    return float(np.min(depth(np.column_stack([latitude, longitude])))) - 25.0
