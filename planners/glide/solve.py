"""One glide planned: seeds, IPOPT from several of them, the best path flown again densely, its outcome in words.

A glide ends where it meets land: it cannot turn, so there is no route round it.
"""

import numpy as np

from planners.glide.candidate import (
    AGREEMENT,
    Candidate,
    fly_candidate,
    meets_bottom,
    optimise,
    polish,
    stops_on_land,
)
from planners.glide.seeds import find_seeds
from planners.glide.transcription import Glide, GlideSettings, GlideTask
from planners.hazards.bottom import bottom_of
from planners.hazards.domain import Region, locate
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.plan import Place, Plan, PlanStatus

_DEFAULT = GlideSettings()
# A goal passed this close needs no further start [m].
_CLOSE_ENOUGH = 1.0
# A seed this many kernel lengths farther from the goal than the best one is not tried.
_SEED_RANGE = 3.0
_MOST_SEEDS = 8
# An optimum this close to a seed that is one already (a warm start) is no worse than it [m].
_TIE = 1e-2


def plan(
    flow: FlowEstimate,
    start: Place,
    goal: Place,
    *,
    settings: GlideSettings = _DEFAULT,
    start_time_ns: int = 0,
    warm: Plan | None = None,
) -> Plan:
    """Return the glide at one constant velocity through water that passes closest to a goal.

    The closest approach is taken on the continuous path, as long as the path stays in the water that the flow's grid covers. The
    result is a value whatever the outcome: ``status`` and ``message`` say whether the goal is reached and which limit binds.

    Args:
        flow: The current, held constant in time.
        start: Where the glide begins.
        goal: Where it should pass.
        settings: What the glide may do.
        start_time_ns: When it begins [ns, UTC]; copied to the plan.
        warm: An earlier plan for the same goal; its heading, angle and remaining duration are tried first, and when they lead to the
            goal nothing else is tried.

    Raises:
        PlanError: The start or the goal is outside the region, above the surface, below the deepest level or the vehicle's limit, on land,
            or below the bottom less the clearance.
    """
    region = Region(flow.grid, settings.max_depth)
    begin, end = locate(region, start, "start"), locate(region, goal, "goal")
    bottom = (
        None
        if settings.bathymetry is None
        else bottom_of(region, settings.bathymetry, settings.clearance)
    )
    if bottom is not None:
        bottom.check("start", begin)
        bottom.check("goal", end)
    task = GlideTask(flow, region, begin, end, settings, bottom)
    turn = float(true_north_halfway(flow.grid.projection, begin[None, :2], end[None, :2])[0])
    # No glide beats one that passes the goal, so an earlier plan that still leads there needs no search.
    seeds = _flown(task, _remaining(warm, start_time_ns, turn))
    solved = _solve_all(task, seeds)
    if not any(candidate.distance <= _CLOSE_ENOUGH for candidate in solved):
        found = _seeds(task)
        seeds = sorted([*seeds, *found], key=lambda candidate: candidate.distance)
        if not seeds:
            return _failed(task, start, goal, start_time_ns)
        solved += _solve_all(task, found[: max(settings.starts - len(solved), 1)])
    seed = seeds[0]
    best = min(solved, key=lambda candidate: candidate.distance, default=seed)
    notes = []
    if best is seed or best.distance > seed.distance + _TIE:
        best = polish(task, seed)
        notes.append("IPOPT did no better than the seed, which was polished by Nelder-Mead instead")
    elif not best.is_consistent and best.until == best.glide.duration:
        notes.append(
            f"the optimiser predicted {best.predicted_distance:.1f} m, more than {AGREEMENT:g} m from the dense path"
        )
    statistics = _statistics(solved, seed, best)
    return _to_plan(task, best, (start, goal, start_time_ns, turn), notes, statistics)


def _remaining(warm: Plan | None, start_time_ns: int, turn: float) -> list[Glide]:
    """Return what remains of an earlier plan; nothing when there is none."""
    if warm is None or warm.status == "failed":
        return []
    remaining = warm.duration - (start_time_ns - warm.start_time_ns) / 1e9
    return [
        Glide(
            float(np.deg2rad(warm.heading_deg)) + turn,
            float(np.deg2rad(warm.glide_angle_deg)),
            max(remaining, 1.0),
        )
    ]


def _seeds(task: GlideTask) -> list[Candidate]:
    """Return the optimiser's starts, flown in the flow itself, nearest to the goal first; none when no path is finite."""
    found = find_seeds(task, _MOST_SEEDS)
    reach = _SEED_RANGE * max(
        task.flow.horizontal.kernel.length_east, task.flow.horizontal.kernel.length_north
    )
    guesses = [seed.glide for seed in found if seed.distance <= found[0].distance + reach]
    return sorted(_flown(task, guesses), key=lambda seed: seed.distance)[: task.settings.starts]


def _flown(task: GlideTask, guesses: list[Glide]) -> list[Candidate]:
    """Return the guesses whose path is finite."""
    limit = task.settings.max_duration
    flown = [
        fly_candidate(task, guess._replace(duration=float(np.clip(guess.duration, 1.0, limit))), 1)
        for guess in guesses
    ]
    return [seed for seed in flown if np.isfinite(seed.distance)]


def _solve_all(task: GlideTask, seeds: list[Candidate]) -> list[Candidate]:
    solved: list[Candidate] = []
    for seed in seeds:
        candidate = optimise(task, seed.glide)
        if candidate is not None:
            solved.append(candidate)
            if candidate.distance <= _CLOSE_ENOUGH:
                break
    return solved


def _statistics(
    solved: list[Candidate], seed: Candidate, best: Candidate
) -> dict[str, float | int | str]:
    statistics: dict[str, float | int | str] = {
        "starts": len(solved),
        "iterations": sum(candidate.iterations for candidate in solved),
        "best_seed_distance": seed.distance,
        "worst_optimum": max((candidate.distance for candidate in solved), default=seed.distance),
        "return_status": best.return_status,
    }
    if np.isfinite(best.predicted_distance):
        statistics["solver_distance"] = best.predicted_distance
    return statistics


def _to_plan(
    task: GlideTask,
    best: Candidate,
    request: tuple[Place, Place, int, float],
    notes: list[str],
    statistics: dict[str, float | int | str],
) -> Plan:
    start, goal, start_time_ns, turn = request
    # Flown again to the closest approach alone, so that the track ends there on a step.
    final = fly_candidate(task, best.glide._replace(duration=max(best.time, 1e-3)))
    distance = float(np.linalg.norm(final.track.position[-1] - task.goal))
    status: PlanStatus = "reached" if distance <= task.settings.tolerance else "unreachable"
    return Plan(
        status=status,
        start=start,
        goal=goal,
        start_time_ns=start_time_ns,
        heading_deg=float(np.mod(np.rad2deg(best.glide.heading - turn), 360.0)),
        glide_angle_deg=float(np.rad2deg(best.glide.glide_angle)),
        speed=task.settings.speed,
        velocity_through_water=final.track.velocity[0]
        - np.append(task.flow.velocity(*task.start), 0.0),
        duration=final.glide.duration,
        closest_approach=distance,
        track_time=final.track.time,
        track=final.track.position,
        message="; ".join([explain(task, best, distance, status), *notes]),
        statistics=statistics,
    )


def _failed(task: GlideTask, start: Place, goal: Place, start_time_ns: int) -> Plan:
    """Return the failed plan, when no glide has a finite path; it stays at its start."""
    return Plan(
        status="failed",
        start=start,
        goal=goal,
        start_time_ns=start_time_ns,
        heading_deg=0.0,
        glide_angle_deg=0.0,
        speed=task.settings.speed,
        velocity_through_water=np.zeros(3),
        duration=0.0,
        closest_approach=float(np.linalg.norm(task.start - task.goal)),
        track_time=np.zeros(1),
        track=task.start[None, :].copy(),
        message="no glide has a finite path: the flow is not a number somewhere along each; check the estimate's latent velocities",
        statistics={"starts": 0, "iterations": 0, "return_status": "not started"},
    )


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
