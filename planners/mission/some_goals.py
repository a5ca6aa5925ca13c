"""Missions to some of the goals asked for: without those met before the first leg."""

from dataclasses import replace

import numpy as np

from planners.mission.attempt import Attempt, GoalSteps
from planners.mission.task import MissionTask
from planners.route.bottom import DEPTH_TOLERANCE


def met_at_start(task: MissionTask) -> int:
    """Return how many of the first goals lie within the tolerance of the start.

    Where others follow, a goal at another depth is not met: a dive passes it on the way.
    """
    near = task.from_start <= task.settings.tolerance
    if near.all():
        return near.size
    return int(np.argmin(near & (np.abs(task.goals[:, 2] - task.start[2]) <= DEPTH_TOLERANCE)))


def to_some(task: MissionTask, kept: tuple[int, ...]) -> MissionTask:
    """Return the mission to some of its goals.

    Args:
        task: The mission to all of them.
        kept: Their numbers, from 0, in order.
    """
    goals = tuple(task.request.goals[k] for k in kept)
    return replace(task, request=replace(task.request, goals=goals), goals=task.goals[list(kept)])


def aimed_at(task: MissionTask, attempt: Attempt) -> tuple[MissionTask, Attempt]:
    """Return the mission to the goals that an attempt leads to, and the attempt as one to these alone."""
    if attempt.kept is None:
        return task, attempt
    goals = GoalSteps(
        *(
            tuple(numbers[k] for k in attempt.kept)
            for numbers in (attempt.goals.legs, attempt.goals.steps)
        )
    )
    return to_some(task, attempt.kept), replace(
        attempt, goals=goals, miss=attempt.miss[list(attempt.kept)], kept=None, beyond=()
    )


def to_all(task: MissionTask, kept: tuple[int, ...], attempt: Attempt) -> Attempt:
    """Return an attempt to some of the goals as one to all: each of the others counts where a leg comes nearest to it, in their order.

    Args:
        task: The mission to all goals.
        kept: Numbers of those that the attempt leads to, from 0.
        attempt: Of the mission to these.
    """
    ends = np.concatenate([[0], attempt.flight.ends])
    places, met = (
        attempt.flight.place[0, ends],
        dict(zip(kept, zip(attempt.goals.legs, attempt.goals.steps, strict=True), strict=True)),
    )
    legs, steps = list[int](), list[int]()
    for k in range(len(task.goals)):
        if k not in met:
            before = legs[-1] if legs else 0
            after = next((met[later][0] for later in kept if later > k), ends.size - 1)
            away = np.linalg.norm(places[before : after + 1] - task.goals[k, :2], axis=1)
            met[k] = before + int(np.argmin(away)), 0
        legs.append(met[k][0])
        steps.append(met[k][1])
    goals = GoalSteps(tuple(legs), tuple(steps))
    miss = np.linalg.norm(
        attempt.flight.place[0, goals.points(attempt.flight)] - task.goals[:, :2], axis=1
    )
    beyond = tuple(replace(bound, goal=kept[bound.goal]) for bound in attempt.beyond)
    # an attempt to some of them may itself leave some out
    leads_to = kept if attempt.kept is None else tuple(kept[k] for k in attempt.kept)
    return replace(attempt, goals=goals, miss=miss, kept=leads_to, beyond=beyond)
