"""Missions planned for samples of the estimate: what nine of ten miss by, and how many trespass on an area downstream."""

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.studies.planning.calls import Mission
from replay_kit.studies.planning.flights import ANGLES, draw_missions
from replay_kit.studies.planning.pictures import ScenarioView, draw_scenarios
from replay_kit.studies.planning.recheck import Polygon, corners_of, ends_of, winds_around
from replay_kit.studies.planning.told import Asked, Picture, Table, Told
from replay_kit.studies.planning.world import Withheld, World
from replay_kit.studies.twins.reachable import SPEED, Pair

NAME = "scenarios"
_KEPT, _RATIO, _CORRECTED, _SECONDS = 0.12, 1.05, 0.8, 15.0
# The share of the path beside which the area lies, and how far out it reaches [m]: the way round its far side is no way.
_BESIDE, _OUT = (0.35, 0.65), 10e3
# How far the area overlaps the path [m]: a plan that keeps clear of it is another one.
_OVERLAP = 100.0
# Points between two of a flight, so that a path does not cut an area's corner unseen.
_FINER = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """One mission: estimate, samples to plan on, fresh ones to judge by, places, and how to plan."""

    flow: FlowEstimate
    drawn: tuple[FlowEstimate, ...]
    fresh: tuple[FlowEstimate, ...]
    pair: Pair
    how: dict[str, Any]


def scenarios(world: World) -> Told:
    """Return what comes of scenario plans beside plans made on the estimate alone."""
    free, beside, views = [], [], []
    for withheld, count in zip(world.truths, world.shares(world.job.scenarios), strict=True):
        for case in _cases(world, withheld, count):
            world.say(f"scenarios, truth {withheld.member}", 1)
            plain = world.calls.plan_mission(case.flow, case.pair.start, case.pair.target, **case.how)
            free.append((withheld.member, *_compared(world, case, plain)))
            area = area_downstream(case.flow, plain)
            row, view = _past(world, case, area)
            beside.append((withheld.member, *row))
            views.append(view)
    return Told(
        NAME,
        "Missions planned for samples of the estimate",
        _tables(free, beside),
        _asked(world, free, beside),
        (_words(world),),
        _drawn(views),
    )


def _cases(world: World, withheld: Withheld, count: int) -> list[_Case]:
    if count == 0:
        return []
    job, flow = world.job, withheld.estimate()
    how = {"vehicle": world.calls.glider(SPEED, *ANGLES), "settings": world.calls.settings(depth=world.depth, legs=job.legs)}
    # a planner knows the estimate only: its goals are reached there
    pairs = draw_missions(withheld, flow.certain(), count, world.depth, job.legs, job.seed)
    samples = flow.sample(job.samples + job.fresh, job.seed)
    return [_Case(flow, samples[: job.samples], samples[job.samples :], pair, how) for pair in pairs]


def _compared(world: World, case: _Case, plain: Mission) -> tuple[float | str, ...]:
    """Return what nine of ten miss by where nothing is forbidden, and how long the scenario plan took.

    The misses are those of the plan made on the estimate alone, of the scenario plan, and of the first when a pilot corrects it.
    """
    plan, seconds = _scenario_plan(world, case, ())
    deterministic = float(np.quantile(world.calls.fly_mission(case.fresh, plain).miss[:, -1], 0.9))
    robust = float(np.quantile(world.calls.fly_mission(case.fresh, plan).miss[:, -1], 0.9))
    corrected = float(world.calls.fly_corrected(case.flow, case.fresh, plain).miss_90_percent)
    return deterministic, robust, corrected, robust / deterministic, corrected / deterministic, seconds


def _scenario_plan(world: World, case: _Case, areas: tuple[Any, ...]) -> tuple[Mission, float]:
    began = time.perf_counter()
    plan, _ = world.calls.plan_scenarios(
        case.flow, case.drawn, case.pair.start, case.pair.target, allowed=world.job.allowed, no_go=areas, **case.how
    )
    return plan, time.perf_counter() - began


def _past(world: World, case: _Case, area: Polygon) -> tuple[tuple[float | str, ...], ScenarioView]:
    """Return how many fresh samples trespass on an area under both plans, and what to draw of it."""
    areas = (world.calls.no_go(area, "area downstream"),)
    plain = world.calls.plan_mission(case.flow, case.pair.start, case.pair.target, no_go=areas, **case.how)
    robust, seconds = _scenario_plan(world, case, areas)
    flown = [world.calls.fly_mission(case.fresh, plan) for plan in (plain, robust)]
    corners = corners_of(case.flow.grid, area)
    shares = [float(np.mean(trespasses(corners, flights.place))) for flights in flown]
    misses = [float(np.quantile(flights.miss[:, -1], 0.9)) for flights in flown]
    longer = robust.duration / plain.duration
    row = (plain.status, robust.status, shares[0], shares[1], misses[1] / misses[0], longer, seconds)
    places = tuple(flights.place[:: max(len(flights.place) // 100, 1)] for flights in flown)
    return row, ScenarioView(case.flow, corners, ends_of(case.flow, case.pair), places, tuple(shares))


def trespasses(corners: Array, place: Array) -> Array:
    """Return which flights, shape (K,), enter an area at some time.

    Args:
        corners: shape (m, 2) [m].
        place: shape (K, n, 2) [m].
    """
    shares = np.arange(_FINER)[:, None] / _FINER
    between = place[:, :-1, None] * (1.0 - shares) + place[:, 1:, None] * shares
    points = np.concatenate([between.reshape(len(place), -1, 2), place[:, -1:]], axis=1)
    return np.asarray(winds_around(corners, points.reshape(-1, 2)).reshape(len(place), -1).any(axis=1))


def area_downstream(flow: FlowEstimate, plan: Mission) -> Polygon:
    """Return a rectangle on the side of a mission's middle to which the current sets, its near edge a little over the path.

    It reaches less far out where it would hold the start or the end.

    Args:
        flow: The estimate.
        plan: The mission.
    """
    track = plan.track[:, :2]
    begin, end = (round(share * (len(track) - 1)) for share in _BESIDE)
    middle = track[begin : end + 1]
    along = (middle[-1] - middle[0]) / np.linalg.norm(middle[-1] - middle[0])
    across = np.array([along[1], -along[0]])
    across *= 1.0 if float(np.mean(flow.velocity(*plan.track[begin : end + 1].T) @ across)) >= 0.0 else -1.0
    near, reach = float(np.max((middle - middle[0]) @ across)) - _OVERLAP, float(np.linalg.norm(middle[-1] - middle[0]))
    out = _OUT
    while True:
        sides = ((0.0, near), (reach, near), (reach, near + out), (0.0, near + out))
        corners = np.array([middle[0] + a * along + b * across for a, b in sides])
        if out < _OVERLAP or not winds_around(corners, track[[0, -1]]).any():
            break
        out /= 2.0
    longitude, latitude = to_geographic(flow.grid.projection, *corners.T)
    return tuple((float(x), float(y)) for x, y in zip(longitude, latitude, strict=True))


def _tables(free: list[Any], beside: list[Any]) -> tuple[Table, ...]:
    misses = ("deterministic: 90 % miss by [m]", "scenarios: 90 % miss by [m]", "corrected: 90 % miss by [m]")
    open_sea = ("truth", *misses, "ratio of scenarios", "ratio of corrected", "seconds")
    past = ("truth", "deterministic", "scenarios", "deterministic: share trespassing", "scenarios: share trespassing")
    return (
        Table("scenarios_open", "Nothing forbidden: what nine of ten fresh samples miss the goal by", open_sea, tuple(free)),
        Table(
            "scenarios_area",
            "An area downstream of the path",
            (*past, "ratio of 90 % misses", "ratio of durations", "seconds"),
            tuple(beside),
        ),
    )


def _asked(world: World, free: list[Any], beside: list[Any]) -> tuple[Asked, ...]:
    ratios, corrected = [row[4] for row in free], [row[5] for row in free]
    seconds = [row[6] for row in free] + [row[7] for row in beside]
    plain, robust = [row[3] for row in beside], [row[4] for row in beside]
    return (
        Asked(
            "90th percentile of the miss over the deterministic plan's, median over the missions", float(np.median(ratios)), at_most=_RATIO
        ),
        Asked("the same, worst mission", max(ratios), at_most=_RATIO),
        Asked("the same, corrected at each surfacing, median over the missions", float(np.median(corrected)), at_most=_CORRECTED),
        Asked("corrected at each surfacing, worst mission", max(corrected), at_most=_CORRECTED),
        Asked(f"share trespassing, {world.job.allowed:.0%} allowed, median over the missions", float(np.median(robust)), at_most=_KEPT),
        Asked("the same, worst mission", max(robust), at_most=_KEPT),
        Asked("share trespassing under the deterministic plan, least of the missions", min(plain), at_least=_KEPT),
        Asked(
            f"seconds for a scenario plan of {world.job.samples} samples and {world.job.legs} dives, median",
            float(np.median(seconds)),
            at_most=_SECONDS,
        ),
    )


def _words(world: World) -> str:
    job = world.job
    return (
        f"Each plan is made with {job.samples} samples of the estimate after {job.pings} pings and flown through {job.fresh} others "
        "without correction on the way. Corrected, the deterministic plan's next leg is aimed anew at each surfacing, by the place there, "
        "the estimate, and what dead reckoning told of the leg before. The area "
        f"overlaps by {_OVERLAP:g} m the path that is planned without it, on the side to which the current sets there. Trespasses are "
        "counted with the angles that the area's edges are seen under, not by the planner."
    )


def _drawn(views: list[ScenarioView]) -> tuple[Picture, ...]:
    caption = (
        "The mission whose deterministic plan trespasses most, flown in fresh samples from dot to star, past an area downstream (orange); "
        "arrows: the current at 250 m"
    )
    worst = max(views, key=lambda view: view.shares[0])
    return (Picture("scenarios_area", caption, (11.0, 5.0), partial(draw_scenarios, worst)),)
