"""Missions planned for samples of the estimate: their 90th percentile of miss distances, and how many enter an area downstream."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import planners
from planners.mission.flights import fly_mission
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.studies.planning.flights import (
    Polygon,
    corners_of,
    draw_missions,
    ends_of,
    polygon_of,
    winds_around,
)
from replay_kit.studies.planning.job import StudyReport
from replay_kit.studies.planning.pictures import ScenarioView, draw_scenarios
from replay_kit.studies.planning.world import Withheld, World, timed
from replay_kit.studies.reports.tables import Cell, Criterion, Picture, Table, named_columns
from replay_kit.studies.twins.reachable import Pair

NAME = "scenarios"
_KEPT, _RATIO, _CORRECTED, _SECONDS = 0.12, 1.05, 0.8, 15.0
# The share of the path beside which the area lies, and how far out it reaches [m], so far that going round its far side does not pay.
_BESIDE, _OUT = (0.35, 0.65), 10e3
# How far the area overlaps the path [m], so that a plan that keeps clear of it has to differ.
_OVERLAP = 100.0
# Points between two of a flight, so that a path that cuts an area's corner is found.
_FINER = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """One mission: estimate, samples to plan for, fresh ones to evaluate with, start and goal, vehicle and settings."""

    flow: FlowEstimate
    samples: tuple[FlowEstimate, ...]
    fresh: tuple[FlowEstimate, ...]
    pair: Pair
    how: dict[str, Any]

    def plan(self, *areas: planners.NoGo) -> planners.MissionPlan:
        """Return the deterministic plan, made on the estimate alone."""
        return planners.plan_mission(self.flow, self._request(areas))

    def plan_scenarios(
        self, allowed: float, *areas: planners.NoGo
    ) -> tuple[planners.MissionPlan, float]:
        """Return the plan for the samples, and the seconds it took."""
        (plan, _), seconds = timed(
            partial(
                planners.plan_scenarios,
                self.flow,
                self.samples,
                self._request(areas),
                allowed=allowed,
            )
        )
        return plan, seconds

    def _request(self, areas: tuple[planners.NoGo, ...]) -> planners.MissionRequest:
        return planners.MissionRequest(
            self.pair.start, (self.pair.target,), no_go=areas, **self.how
        )

    def miss(self, plan: planners.MissionPlan) -> float:
        """Return the 90th percentile of the miss distances of a plan in the fresh samples [m]."""
        return float(np.quantile(fly_mission(self.fresh, plan).miss[:, -1], 0.9))


def scenarios(world: World) -> StudyReport:
    """Return the outcome of scenario plans beside plans made on the estimate alone."""
    free, beside, views = [], [], []
    for withheld, found in world.each_truth(_of_truth, world.job.scenarios):
        for compared, row, view in found:
            free.append({"truth": withheld.member, **compared})
            beside.append({"truth": withheld.member, **row})
            views.append(view)
    tables = (
        named_columns(
            "scenarios_open",
            "No areas: 90th percentile of the miss distances in fresh samples",
            free,
        ),
        named_columns("scenarios_area", "An area downstream of the path", beside),
    )
    caption = (
        "The mission whose deterministic plan enters the area in the most samples, flown in fresh samples from dot to star, past an area "
        "downstream (orange); arrows: the current at 250 m"
    )
    worst = max(views, key=lambda view: view.shares[0])
    picture = Picture("scenarios_area", caption, (11.0, 5.0), partial(draw_scenarios, worst))
    title = "Missions planned for samples of the estimate"
    return StudyReport(
        NAME, title, tables, _criteria(world, *tables), (_findings(world),), (picture,)
    )


def _of_truth(
    world: World, count: int
) -> list[tuple[dict[str, Cell], dict[str, Cell], ScenarioView]]:
    """Return the figures of missions in the one truth of a world without areas and past one, and what to draw of these."""
    (withheld,), found = world.truths, []
    for case in _cases(world, withheld, count):
        world.advance(f"scenarios, truth {withheld.member}")
        plain = case.plan()
        found.append(
            (_compared(world, case, plain), *_past(world, case, area_downstream(case.flow, plain)))
        )
    return found


def _cases(world: World, withheld: Withheld, count: int) -> list[_Case]:
    job, flow = world.job, withheld.estimate()
    how = {
        "vehicle": world.glider,
        "settings": planners.MissionSettings(depth=world.depth, legs=job.legs),
    }
    # a planner knows only the estimate, so its goals are drawn as reachable there
    pairs = draw_missions(withheld, flow.mean_flow(), count, world.depth, job.legs, job.seed)
    samples = flow.sample(job.samples + job.fresh, job.seed)
    return [
        _Case(flow, samples[: job.samples], samples[job.samples :], pair, how) for pair in pairs
    ]


def _compared(world: World, case: _Case, plain: planners.MissionPlan) -> dict[str, Cell]:
    """Return the figures of a mission without areas: the deterministic plan, the scenario plan, the former corrected by a pilot."""
    plan, seconds = case.plan_scenarios(world.job.allowed)
    deterministic, robust = case.miss(plain), case.miss(plan)
    corrected = float(
        planners.fly_scenarios(case.flow, case.fresh, plain, pilot=planners.Pilot()).miss_90_percent
    )
    return {
        "deterministic: 90 % miss by [m]": deterministic,
        "scenarios: 90 % miss by [m]": robust,
        "corrected: 90 % miss by [m]": corrected,
        "ratio of scenarios": robust / deterministic,
        "ratio of corrected": corrected / deterministic,
        "seconds": seconds,
    }


def _past(world: World, case: _Case, area: Polygon) -> tuple[dict[str, Cell], ScenarioView]:
    """Return the figures of a mission past an area, shares being of the fresh samples, and what to draw of it."""
    no_go = planners.NoGo(area, "area downstream")
    plain, (robust, seconds) = case.plan(no_go), case.plan_scenarios(world.job.allowed, no_go)
    flown = [fly_mission(case.fresh, plan) for plan in (plain, robust)]
    corners = corners_of(case.flow.grid, area)
    shares = [float(np.mean(entering(corners, flights.place))) for flights in flown]
    misses = [float(np.quantile(flights.miss[:, -1], 0.9)) for flights in flown]
    row: dict[str, Cell] = {
        "deterministic": plain.status,
        "scenarios": robust.status,
        "deterministic: share in the area": shares[0],
        "scenarios: share in the area": shares[1],
        "ratio of 90 % misses": misses[1] / misses[0],
        "ratio of durations": robust.duration / plain.duration,
        "seconds": seconds,
    }
    places = tuple(flights.place[:: max(len(flights.place) // 100, 1)] for flights in flown)
    return row, ScenarioView(
        case.flow, corners, ends_of(case.flow.grid, case.pair), places, tuple(shares)
    )


def entering(corners: Array, place: Array) -> Array:
    """Return which flights, shape (K,), enter an area at some time.

    Args:
        corners: shape (m, 2) [m].
        place: shape (K, n, 2) [m].
    """
    shares = np.arange(_FINER)[:, None] / _FINER
    between = place[:, :-1, None] * (1.0 - shares) + place[:, 1:, None] * shares
    points = np.concatenate([between.reshape(len(place), -1, 2), place[:, -1:]], axis=1)
    return np.asarray(
        winds_around(corners, points.reshape(-1, 2)).reshape(len(place), -1).any(axis=1)
    )


def area_downstream(flow: FlowEstimate, plan: planners.MissionPlan) -> Polygon:
    """Return a rectangle on the side of a mission's middle to which the current sets, its near edge a little over the path.

    It reaches less far out where it would contain the start or the end.

    Args:
        flow: The estimate.
        plan: The mission.
    """
    track = plan.track[:, :2]
    begin, end = (round(share * (len(track) - 1)) for share in _BESIDE)
    middle = track[begin : end + 1]
    along = (middle[-1] - middle[0]) / np.linalg.norm(middle[-1] - middle[0])
    across = np.array([along[1], -along[0]])
    across *= (
        1.0
        if float(np.mean(flow.velocity(*plan.track[begin : end + 1].T) @ across)) >= 0.0
        else -1.0
    )
    near, reach = (
        float(np.max((middle - middle[0]) @ across)) - _OVERLAP,
        float(np.linalg.norm(middle[-1] - middle[0])),
    )
    out = _OUT
    while True:
        sides = ((0.0, near), (reach, near), (reach, near + out), (0.0, near + out))
        corners = np.array([middle[0] + a * along + b * across for a, b in sides])
        if out < _OVERLAP or not winds_around(corners, track[[0, -1]]).any():
            return polygon_of(flow.grid, corners)
        out /= 2.0


def _criteria(world: World, free: Table, beside: Table) -> tuple[Criterion, ...]:
    quantile, share = (
        "90th percentile of the miss over the deterministic plan's",
        f"share in the area, {world.job.allowed:.0%} allowed",
    )
    duration = f"seconds for a scenario plan of {world.job.samples} samples and {world.job.legs} dives, median"
    corrected = "corrected at each surfacing, median over the missions"
    seconds = np.concatenate([free.column("seconds"), beside.column("seconds")])
    limited = (
        (
            f"{quantile}, median over the missions",
            "the same, worst mission",
            free.column("ratio of scenarios"),
            _RATIO,
        ),
        (
            f"the same, {corrected}",
            "corrected at each surfacing, worst mission",
            free.column("ratio of corrected"),
            _CORRECTED,
        ),
        (
            f"{share}, median over the missions",
            "the same, worst mission",
            beside.column("scenarios: share in the area"),
            _KEPT,
        ),
    )
    least = float(beside.column("deterministic: share in the area").min())
    return (
        *(
            Criterion(what, float(of(values)), at_most=most)
            for median, worst, values, most in limited
            for what, of in ((median, np.median), (worst, np.max))
        ),
        Criterion(
            "share in the area under the deterministic plan, least of the missions",
            least,
            at_least=_KEPT,
        ),
        Criterion(duration, float(np.median(seconds)), at_most=_SECONDS),
    )


def _findings(world: World) -> str:
    job = world.job
    return (
        f"Each plan is made for {job.samples} samples of the estimate after {job.pings} pings and flown in {job.fresh} others without "
        "correction. Corrected means that the next leg of the deterministic plan is aimed again at each surfacing, from the place there, "
        "the estimate, and the dead reckoning of the leg before. The area overlaps the path that is planned without it by "
        f"{_OVERLAP:g} m, on the side to which the current sets there. Entries are counted by the winding number of the area, not by the "
        "planner."
    )
