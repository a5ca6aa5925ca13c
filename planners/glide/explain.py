"""The outcome of a plan in words, with the limit that binds when the goal is not reached."""

import numpy as np

from planners.glide.candidate import Candidate, meets_bottom, stops_on_land
from planners.glide.transcription import GlideTask
from replay_kit.core.plan import PlanStatus

# A limit counts as binding when the path ends this close to it [m], or within this share of the longest duration.
_NEAR, _NEAR_SHARE = 5.0, 1e-3


def explain(task: GlideTask, best: Candidate, distance: float, status: PlanStatus) -> str:
    """Return the closest approach in words and, when the goal is not reached, the limit that binds.

    Args:
        task: The problem.
        best: The glide chosen.
        distance: Its closest approach [m].
        status: Its outcome.
    """
    what = f"passes the goal at {distance:.1f} m after {best.time / 3600.0:.1f} h"
    if status == "reached":
        return what
    return f"{what}, outside the tolerance of {task.settings.tolerance:g} m; {_binding(task, best)}"


def _binding(task: GlideTask, best: Candidate) -> str:
    end = best.track.at(np.array([best.time]))[0]
    if float(np.linalg.norm(end - task.start)) < _NEAR:
        return "every glide leads away from the goal: the current is stronger than the vehicle"
    if best.until < best.glide.duration and best.time > best.until - 1.0:
        if meets_bottom(task, best):
            return f"the path comes within the clearance of {task.settings.clearance:g} m of the bottom there"
        return (
            "the path meets land there"
            if stops_on_land(task, best)
            else "the path leaves the region that the forecast covers there"
        )
    if best.time >= (1.0 - _NEAR_SHARE) * task.settings.max_duration:
        return (
            f"limit: the longest glide considered, max_duration = {task.settings.max_duration:g} s"
        )
    if _distance_to_sides(task, end) < _NEAR:
        return "limit: the edge of the region that the forecast covers"
    if end[2] > task.region.deepest - _NEAR and task.goal[2] < task.region.deepest - _NEAR:
        return f"limit: {task.region.floor}"
    if end[2] < _NEAR < task.goal[2]:
        return "limit: the surface"
    through = best.track.velocity[:, :2] - task.flow.velocity(*best.track.position.T)
    current = float(np.mean(np.linalg.norm(best.track.velocity[:, :2] - through, axis=1)))
    return f"no limit binds: the current, {current:.2f} m/s along the path, carries a vehicle of {task.settings.speed:g} m/s past the goal"


def _distance_to_sides(task: GlideTask, point: np.ndarray) -> float:
    """Return how far inside the outline a point is [m]."""
    sides, place = task.sides, point[:2] / 1e3
    along = sides[:, 2:4] @ place
    return (
        float(
            np.min(
                sides[:, 4] + sides[:, 5] * along + sides[:, 6] * along**2 - sides[:, :2] @ place
            )
        )
        * 1e3
    )
