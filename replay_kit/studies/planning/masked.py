"""Missions among islands and areas drawn at random: no path may cross them that is said not to."""

import time
from collections import Counter
from functools import partial

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import distance
from replay_kit.studies.planning.flights import ANGLES, fly_plan
from replay_kit.studies.planning.masks import Masked, draw_masked
from replay_kit.studies.planning.pictures import MaskedView, draw_masked_cases
from replay_kit.studies.planning.recheck import crossed, ends_of
from replay_kit.studies.planning.told import Asked, Picture, Table, Told
from replay_kit.studies.planning.world import World
from replay_kit.studies.twins.reachable import SPEED, Pair

NAME = "masked"
_CLEAN = ("reached", "unreachable")
_SHOWN = 6
_CAPTION = "Some of the missions, from dot to star: land grey, areas orange, arrows the current at 250 m"
# Three times what most goals take; ways against the current would take minutes to plan.
_MOST_LEGS = 40
Row = tuple[str | int | float | bool, ...]


def masked(world: World) -> Told:
    """Return what comes of missions in random masked cases, their paths flown anew and checked anew."""
    rows: list[Row] = []
    views: list[MaskedView] = []
    for withheld, count in zip(world.truths, world.shares(world.job.masks), strict=True):
        for k in range(count):
            rng = np.random.default_rng((world.job.seed, 3, withheld.member, k))
            case = draw_masked(withheld.estimated["default"], world.depth, withheld.config.nugget, rng)
            world.say(f"masked, truth {withheld.member}", 1)
            row, track = _planned(world, case)
            rows.append((withheld.member, k, *row))
            if case.blocked and len(views) < _SHOWN and track is not None:
                views.append(MaskedView(case.flow, case.areas, track, ends_of(case.flow, case.pair), str(row[0])))
    return Told(
        NAME,
        "Missions among islands and areas drawn at random",
        (_counts(rows), _every(rows)),
        _asked(rows),
        (_words(rows),),
        (Picture("masked_cases", _CAPTION, (11.0, 7.0), partial(draw_masked_cases, tuple(views))),),
    )


def _planned(world: World, case: Masked) -> tuple[Row, Array | None]:
    """Return a case's row, and its path; None without one."""
    vehicle, settings = world.calls.glider(SPEED, *ANGLES), world.calls.settings(depth=world.depth, max_legs=_MOST_LEGS)
    areas = tuple(world.calls.no_go(area, f"area {k + 1}") for k, area in enumerate(case.areas))
    began = time.perf_counter()
    nothing = float("nan")
    away = _away(case.pair)
    try:
        plan = world.calls.plan_mission(case.flow, case.pair.start, case.pair.target, vehicle=vehicle, settings=settings, no_go=areas)
    except PlanError as error:
        return ("refused", case.blocked, away, 0, nothing, "", "", nothing, time.perf_counter() - began, str(error)), None
    seconds = time.perf_counter() - began
    legs = len(plan.headings_deg)
    if not legs:
        return (plan.status, case.blocked, away, 0, nothing, "", "", nothing, seconds, plan.message), None
    anew = fly_plan(case.flow, plan, world.depth)
    apart = float(np.linalg.norm(anew[-1] - plan.track[-1]))
    said, flown = (crossed(case.flow.grid, case.areas, track) or "" for track in (plan.track, anew))
    miss = float(plan.closest_approach[-1])
    return (plan.status, case.blocked, away, legs, miss, said, flown, apart, seconds, plan.message), plan.track


def _every(rows: list[Row]) -> Table:
    columns = ("truth", "case", "status", "blocked", "distance [m]", "legs", "miss [m]", "path crosses", "path flown anew crosses")
    return Table("masked_cases", "Each case", (*columns, "ends apart [m]", "seconds", "message"), tuple(rows), shown=False)


def _counts(rows: list[Row]) -> Table:
    out = []
    for status in dict.fromkeys(str(row[2]) for row in rows):
        alike = [row for row in rows if row[2] == status]
        seconds = np.array([row[10] for row in alike], dtype=np.float64)
        blocked, crossing = sum(bool(row[3]) for row in alike), sum(bool(row[7] or row[8]) for row in alike)
        out.append((status, len(alike), blocked, crossing, float(np.median(seconds)), float(seconds.max())))
    columns = ("status", "cases", "straight way blocked", "crossings", "median seconds", "most seconds")
    return Table(NAME, "Missions among islands and areas, by what the planner says of them", columns, tuple(out))


def _asked(rows: list[Row]) -> tuple[Asked, ...]:
    clean = [row for row in rows if row[2] in _CLEAN]
    counted = Counter("crossings" for row in clean if row[7] or row[8])
    apart = max((float(row[9]) for row in clean), default=float("nan"))
    return (
        Asked("crossings of paths that are said to be clear, planned or flown anew", counted["crossings"], at_most=0),
        Asked("farthest that a path flown anew by other code ends from the planned one [m]", apart, at_most=50.0),
    )


def _words(rows: list[Row]) -> str:
    clean = sum(row[2] in _CLEAN for row in rows)
    blocked = sum(bool(row[3]) for row in rows)
    return (
        f"{len(rows)} cases; in {blocked} the straight way from start to goal is blocked. {clean} plans are said to keep clear. Each path "
        "is checked every 10 m with the nearest grid point's land and with the angles that an area's edges are seen under, both as planned "
        "and flown anew from headings and glide angles by another code. `unsafe` plans say that they cross something."
    )


def _away(pair: Pair) -> float:
    return float(distance(pair.start.longitude, pair.start.latitude, pair.target.longitude, pair.target.latitude))
