"""Plans made on each flow and flown in the truth without correction: single glides (Table III), and missions of many dives."""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

import planners
from planners.mission.flights import fly_mission
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Plan
from replay_kit.studies.paper.rows import coherence
from replay_kit.studies.planning.arrival_tables import (
    Arrival,
    draw_misses,
    order_of,
    place_of_average,
    place_of_mean,
    tables_of,
)
from replay_kit.studies.planning.job import StudyReport
from replay_kit.studies.planning.world import FLOWS, Withheld, World, draw_missions, timed
from replay_kit.studies.reports.flows import LABELS
from replay_kit.studies.reports.tables import NAN, Picture
from replay_kit.studies.scoring import NEAR
from replay_kit.studies.twins.reachable import TARGET_DEPTH, Pair, draw_pairs

_CAPTION = (
    "Left: share of the plans whose miss distance is no larger. Right: each truth's median against the relative error of the flow that "
    "plans were made on; miss distances below 1 m are drawn at 1 m"
)
Made = TypeVar("Made")
#: Status of a plan on a flow, its predicted miss and its miss in the truth [m].
Outcome = tuple[str, float, float]


def glides(world: World) -> StudyReport:
    """Return the miss distances of glides of constant velocity to targets that the truth reaches."""
    seed = world.job.seed

    def draw(withheld: Withheld, count: int) -> tuple[Pair, ...]:
        return draw_pairs(withheld.field, withheld.truth, withheld.case.ensemble.grid, count, seed)

    def fly(truth: FlowEstimate, plan: Plan, pair: Pair) -> Outcome:
        return plan.status, plan.closest_approach, planners.fly(truth, plan)[2]

    arrivals, coherent = _arrivals(
        world, "glides", draw, lambda flow, pair: planners.plan(flow, pair.start, pair.target), fly
    )
    depth = min(TARGET_DEPTH, arrivals[0].goal.depth)
    title = f"Closest approach to a target at {depth:g} m of a glide of constant velocity, planned on each flow, flown in the truth"
    return _report("glides", ("Glides of constant velocity", title), arrivals, coherent)


def missions(world: World) -> StudyReport:
    """Return the miss distances of missions to goals that missions of random headings reach in the truth."""
    job, depth, glider = world.job, world.depth, world.glider
    settings = planners.MissionSettings(depth=depth, legs=job.legs, tolerance=NEAR)

    def draw(withheld: Withheld, count: int) -> tuple[Pair, ...]:
        return draw_missions(withheld, withheld.truth, count, depth, job.legs, job.seed)

    def plan(flow: FlowEstimate, pair: Pair) -> planners.MissionPlan:
        return planners.plan_mission(
            flow, planners.MissionRequest(pair.start, (pair.target,), glider, settings)
        )

    def fly(truth: FlowEstimate, mission: planners.MissionPlan, pair: Pair) -> Outcome:
        if len(mission.headings_deg):
            return (
                mission.status,
                float(mission.closest_approach[-1]),
                float(fly_mission(truth, mission).miss[0, -1]),
            )
        # a plan that failed stays at its start
        return mission.status, NAN, pair.distance

    arrivals, coherent = _arrivals(world, "missions", draw, plan, fly)
    dives = f"{job.legs} dives to {depth:g} m, a heading and glide angle each"
    title = f"Miss distance at the goal of {dives}, planned on each flow, flown in the truth"
    return _report("missions", ("Missions of many dives", title), arrivals, coherent)


def _arrivals(
    world: World,
    study: str,
    draw: Callable[[Withheld, int], tuple[Pair, ...]],
    plan: Callable[[FlowEstimate, Pair], Made],
    fly: Callable[[FlowEstimate, Made, Pair], Outcome],
) -> tuple[list[Arrival], float]:
    """Return each plan's arrival in its truth, and the mean coherence in depth of the truths."""
    arrivals, coherent = [], []
    for of_truth, of_depth in world.each_truth(
        partial(_of_truth, study, draw, plan, fly), world.job.pairs, len(FLOWS)
    ):
        arrivals += of_truth
        coherent.append(of_depth)
    return arrivals, float(np.mean(coherent))


def _of_truth(
    study: str,
    draw: Callable[[Withheld, int], tuple[Pair, ...]],
    plan: Callable[[FlowEstimate, Pair], Made],
    fly: Callable[[FlowEstimate, Made, Pair], Outcome],
    world: World,
    count: int,
) -> tuple[list[Arrival], float]:
    """Return each plan's arrival in the one truth of a world, and its coherence in depth."""
    (withheld,), arrivals = world.truths, []
    pairs = draw(withheld, count)
    # missions end at the surface
    depth = pairs[0].target.depth or world.depth
    for name, flow in withheld.flows(depth).items():
        error = withheld.relative_error(flow, depth)
        for pair in pairs:
            world.advance(f"{study}, truth {withheld.member}, {LABELS[name]}")
            made, seconds = timed(partial(plan, flow, pair))
            outcome = fly(withheld.truth, made, pair)
            arrivals.append(
                Arrival(name, withheld.member, pair.start, pair.target, *outcome, error, seconds)
            )
    return arrivals, coherence(withheld.truth, depth)


def _report(
    study: str, titles: tuple[str, str], arrivals: list[Arrival], coherent: float
) -> StudyReport:
    """Return the report of a study with the titles of its section and of its table."""
    findings = place_of_average(arrivals, coherent, once=study == "glides"), place_of_mean(arrivals)
    picture = Picture(
        f"{study}_misses", _CAPTION, (11.0, 4.6), partial(draw_misses, tuple(arrivals))
    )
    return StudyReport(
        study,
        titles[0],
        tables_of(study, titles[1], arrivals),
        order_of(arrivals),
        findings,
        (picture,),
    )
