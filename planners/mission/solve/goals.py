"""Which goals a mission leads to, in which leg it meets each, and the same path cut into more legs or fewer."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.hazards.bottom import DEPTH_TOLERANCE
from planners.mission.solve.attempt import Attempt, GoalSteps
from planners.mission.task import MissionTask, turns_of
from planners.shooting.program import MissionGuess
from replay_kit.core.arrays import Array


def goal_legs_of(passed: Array, n_legs: int) -> tuple[int, ...]:
    """Return after which leg each goal is met, counted from 1: the one nearest in time to the route, each goal after a leg of its own.

    Args:
        passed: shape (G,) [s], increasing; the last is the route's end.
        n_legs: Number of legs, at least G.
    """
    numbers: list[int] = []
    for k, share in enumerate(passed / passed[-1]):
        least, most = (numbers[-1] if numbers else 0) + 1, n_legs - (len(passed) - 1 - k)
        numbers.append(int(np.clip(np.round(n_legs * share), least, most)))
    return tuple(numbers)


def goal_steps_of(task: MissionTask, passed: Array, legs: tuple[int, ...]) -> GoalSteps:
    """Return when each goal is met.

    Args:
        task: The problem.
        passed: shape (G,), when the goals are passed [s]; the last ends the mission.
        legs: In which leg each is met, counted from 1.
    """
    within = legs[-1] * passed / passed[-1] - (np.array(legs) - 1.0)
    return GoalSteps(legs, task.goal_steps(legs, legs[-1], within))


def add_leg(goal_legs: tuple[int, ...], angles: Array) -> tuple[int, ...]:
    """Return after which leg each goal is met with one more leg, on the way to the goal with the shallowest glide angles.

    Args:
        goal_legs: Before, counted from 1.
        angles: shape (L,), glide angles of the legs.
    """
    mean_angles = [float(np.mean(angles[begin:end])) for begin, end in pairwise((0, *goal_legs))]
    shallowest = int(np.argmin(mean_angles))
    return tuple(number + int(k >= shallowest) for k, number in enumerate(goal_legs))


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
    places = attempt.flight.place[0, ends]
    met = dict(zip(kept, zip(attempt.goals.legs, attempt.goals.steps, strict=True), strict=True))
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


def with_n_legs(task: MissionTask, attempt: Attempt, n_legs: int) -> Attempt:
    """Return an attempt whose guess has ``n_legs`` legs of equal time along the same path."""
    flight, duration = attempt.flight, float(attempt.flight.time[-1])
    at = duration * np.arange(1, n_legs + 1) / n_legs
    places = np.column_stack([np.interp(at, flight.time, flight.place[0, :, i]) for i in (0, 1)])
    headings = np.interp(
        at - 0.5 * at[0], flight.time, np.unwrap(attempt.legs.headings)[flight.leg]
    )
    passed = flight.time[attempt.goals.points(flight)]
    # a leg over several turns as high as the highest of their dives
    ends, turns = flight.time[flight.ends], np.array(turns_of(attempt.yo_depths))
    first = np.searchsorted(ends, at - at[0], side="right")
    last = np.minimum(np.searchsorted(ends, at), len(ends) - 1)
    limited = replace(
        task,
        turns=tuple(
            float(turns[begin : end + 1].min()) for begin, end in zip(first, last, strict=True)
        ),
    )
    goals = goal_steps_of(limited, passed, goal_legs_of(passed, n_legs))
    return replace(
        attempt,
        yo_depths=limited.yo_depths(n_legs),
        guess=MissionGuess(places, headings, np.full(n_legs, task.angle_of(at[0]))),
        goals=goals,
    )
