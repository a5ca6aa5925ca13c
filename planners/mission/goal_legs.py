"""In which leg of a mission each of its goals is met."""

from itertools import pairwise

import numpy as np

from planners.mission.attempt import GoalSteps
from planners.mission.task import MissionTask
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
