"""Problems without a solution: each has to end soon, with the reason in words."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import Place
from replay_kit.estimator.basis.modes import embed
from replay_kit.studies.planning.flights import ANGLES
from replay_kit.studies.planning.masks import with_land
from replay_kit.studies.planning.told import Asked, Table, Told
from replay_kit.studies.planning.world import World
from replay_kit.studies.twins.reachable import SPEED

NAME = "infeasible"
_SECONDS = 10.0
# A current so many times as fast as the vehicle, and a goal so far up it [m].
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


def infeasible(world: World) -> Told:
    """Return how glides and missions end that cannot reach their goals."""
    flow = world.truths[0].estimated["default"]
    vehicle, settings = world.calls.glider(SPEED, *ANGLES), world.calls.settings(depth=world.depth)

    def mission(flow: FlowEstimate, start: Place, goal: Place) -> Any:
        return world.calls.plan_mission(flow, start, goal, vehicle=vehicle, settings=settings)

    rows = []
    for case in cases(flow, world.truths[0].config.nugget):
        for kind, plan in (("glide", world.calls.plan), ("mission", mission)):
            world.say(f"infeasible, {case.name}, {kind}", 1)
            rows.append((case.name, kind, *_ended(case, plan)))
    columns = ("what is wrong", "asked for", "ended as", "reason named", "seconds", "reason")
    unnamed, longest = sum(not row[3] for row in rows), max(float(row[4]) for row in rows)
    return Told(
        NAME,
        "Problems without a solution",
        (Table(NAME, "How they end; the planner's graphs are built within the time", columns, tuple(rows)),),
        (Asked("cases that end without a named reason", unnamed, at_most=0), Asked("longest [s]", longest, at_most=_SECONDS)),
    )


def _ended(case: Impossible, plan: Callable[[FlowEstimate, Place, Place], Any]) -> tuple[str, bool, float, str]:
    began = time.perf_counter()
    try:
        made = plan(case.flow, case.start, case.goal)
        how, reason = str(made.status), str(made.message)
    except PlanError as error:
        how, reason = "refused", str(error)
    named = how != "reached" and any(word in reason for word in case.words)
    return how, named, time.perf_counter() - began, reason


def cases(flow: FlowEstimate, nugget: float) -> tuple[Impossible, ...]:
    """Return the problems on an estimate: goals on land, up a current that is too fast, too deep, outside, and boxed in by land.

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
    here, there = _place(flow, beside, 0.0), _place(flow, middle, 0.0)
    deepest = float(flow.levels[-1])
    edge = np.array([2.0 * float(np.max(grid.east)), 0.0])
    return (
        Impossible("goal on land", with_land(flow, away == 0, nugget), here, there, ("land",)),
        _against_current(flow, middle, nugget),
        Impossible("goal below the deepest level", flow, here, _place(flow, middle, deepest + 100.0), ("deep",)),
        Impossible("goal outside of the region", flow, here, _place(flow, edge, 0.0), ("outside",)),
        Impossible(
            "goal boxed in by land", with_land(flow, away == 2, nugget), here, there, ("land", "may not be crossed", "may not be entered")
        ),
    )


def _against_current(flow: FlowEstimate, start: Array, nugget: float) -> Impossible:
    """Return a problem in a current that is too fast everywhere, with the goal up the current: in an eddy it could be reached round it."""
    count = len(flow.nodes)
    uniform = np.repeat([_TIMES * SPEED, 0.0], count)[:, None] * np.ones(flow.levels.size)
    fast = replace(flow.certain(), latent=embed(flow.kernel, flow.nodes, uniform, nugget))
    goal = start - np.array([_UPSTREAM, 0.0])
    return Impossible("current faster than the vehicle", fast, _place(flow, start, 0.0), _place(flow, goal, 0.0), ("current",))


def _place(flow: FlowEstimate, point: Array, depth: float) -> Place:
    longitude, latitude = to_geographic(flow.grid.projection, point[0], point[1])
    return Place(float(longitude), float(latitude), depth)
