"""Problems without a solution: planning for each has to end soon and name the reason."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import planners
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place, Plan
from replay_kit.estimator.basis.embedding import embed
from replay_kit.studies.planning.job import StudyReport
from replay_kit.studies.planning.masks import with_land
from replay_kit.studies.planning.world import World, attempted
from replay_kit.studies.reports.tables import Criterion, Table
from replay_kit.studies.twins.reachable import SPEED, place_at

NAME = "infeasible"
_SECONDS = 10.0
# A current this many times as fast as the vehicle, and a goal this far upstream [m].
_TIMES, _UPSTREAM = 3.0, 15e3


@dataclass(frozen=True, slots=True, eq=False)
class Impossible:
    """A problem without a solution.

    Attributes:
        name: What is wrong.
        flow: The current.
        start: Where it begins.
        goal: Where it cannot end.
        words: One of these has to be in the reason.
    """

    name: str
    flow: FlowEstimate
    start: Place
    goal: Place
    words: tuple[str, ...]


def infeasible(world: World) -> StudyReport:
    """Return how plans of glides and missions end that cannot reach their goals."""
    flow = world.truths[0].estimated["default"]
    settings = planners.MissionSettings(depth=world.depth)

    def glide(flow: FlowEstimate, start: Place, goal: Place) -> Plan:
        return planners.plan(flow, start, goal)

    def mission(flow: FlowEstimate, start: Place, goal: Place) -> planners.MissionPlan:
        return planners.plan_mission(
            flow, planners.MissionRequest(start, (goal,), world.glider, settings)
        )

    rows = []
    for case in cases(flow, world.truths[0].config.nugget):
        for kind, plan in (("glide", glide), ("mission", mission)):
            world.advance(f"infeasible, {case.name}, {kind}")
            made, reason, seconds = attempted(partial(plan, case.flow, case.start, case.goal))
            status = "refused" if made is None else made.status
            rows.append(
                (
                    case.name,
                    kind,
                    status,
                    status != "reached" and any(word in reason for word in case.words),
                    seconds,
                    reason,
                )
            )
    columns = ("problem", "kind of plan", "status", "reason named", "seconds", "reason")
    unnamed, longest = sum(not row[3] for row in rows), max(row[4] for row in rows)
    return StudyReport(
        NAME,
        "Problems without a solution",
        (
            Table(
                NAME,
                "How they end; the times include building the planner's graphs",
                columns,
                tuple(rows),
            ),
        ),
        (
            Criterion("cases that end without a named reason", unnamed, at_most=0),
            Criterion("longest [s]", longest, at_most=_SECONDS),
        ),
    )


def cases(flow: FlowEstimate, nugget: float) -> tuple[Impossible, ...]:
    """Return the problems on an estimate: goals on land, against a current that is too fast, too deep, outside, and boxed in by land.

    Args:
        flow: The estimate.
        nugget: As for ``with_land``.
    """
    grid = flow.grid
    rows, columns = grid.east.shape
    j, i = rows // 2, columns // 2
    column = max(i - 4, 1)
    middle, beside = (np.array([grid.east[j, k], grid.north[j, k]]) for k in (i, column))
    away = np.maximum(*np.abs(np.indices(grid.east.shape) - np.array([j, i])[:, None, None]))
    here, there = place_at(grid, beside, 0.0), place_at(grid, middle, 0.0)
    deepest = float(flow.levels[-1])
    edge = np.array([2.0 * float(np.max(grid.east)), 0.0])
    return (
        Impossible("goal on land", with_land(flow, away == 0, nugget), here, there, ("land",)),
        _against_current(flow, middle, nugget),
        Impossible(
            "goal below the deepest level",
            flow,
            here,
            place_at(grid, middle, deepest + 100.0),
            ("deep",),
        ),
        Impossible(
            "goal outside of the region", flow, here, place_at(grid, edge, 0.0), ("outside",)
        ),
        Impossible(
            "goal boxed in by land",
            with_land(flow, away == 2, nugget),
            here,
            there,
            ("land", "constraint"),
        ),
    )


def _against_current(flow: FlowEstimate, start: Array, nugget: float) -> Impossible:
    """Return a problem in a current that is too fast everywhere, with the goal upstream: in an eddy it could be reached by going round."""
    count = len(flow.nodes)
    uniform = np.repeat([_TIMES * SPEED, 0.0], count)[:, None] * np.ones(flow.levels.size)
    grid, fast = (
        flow.grid,
        replace(flow.mean_flow(), latent=embed(flow.horizontal, flow.nodes, uniform, nugget)),
    )
    goal = start - np.array([_UPSTREAM, 0.0])
    return Impossible(
        "current faster than the vehicle",
        fast,
        place_at(grid, start, 0.0),
        place_at(grid, goal, 0.0),
        ("current",),
    )
