"""One glide flown densely: the true closest approach of a seed or of the optimiser's solution, and of a plan in another flow."""

from dataclasses import dataclass, replace

import numpy as np

from planners.glide.transcription import Glide, GlideTask, approach, solve_glide
from planners.hazards.domain import Region, locate
from planners.track import Track, fly_glide, fractions_of_duration, velocity_through_water
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.plan import Plan

# Largest difference between the optimiser's closest approach and the dense one [m]; after this many refinements the plan reports it.
AGREEMENT = 1.0
_REFINEMENTS = 3
# Dense steps for each of the optimiser's.
_DENSE = 4
# How far the path may bend between the ends of its dense steps [m].
_SKIN = 1.0
# A polished seed is good to this distance [m], and to this share of what it misses the goal by.
_POLISHED = 1e-2, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A glide and its dense path.

    Attributes:
        glide: Heading, glide angle and duration flown.
        until: When its path leaves the region or meets land or the bottom [s]; ``duration`` when it does not.
        time: Of the closest approach until then [s].
        distance: Closest approach until then [m].
        track: The dense path.
        predicted_distance: Closest approach by the optimiser's own path [m]; NaN for a seed.
        iterations: IPOPT's, over all refinements.
        return_status: IPOPT's last.
    """

    glide: Glide
    until: float
    time: float
    distance: float
    track: Track
    predicted_distance: float = float("nan")
    iterations: int = 0
    return_status: str = "not started"

    @property
    def is_consistent(self) -> bool:
        """Whether the dense path comes as close as the optimiser predicted."""
        return self.distance <= self.predicted_distance + AGREEMENT


def fly_candidate(task: GlideTask, glide: Glide, refinement: int = _DENSE) -> Candidate:
    """Return a glide flown through the task's flow.

    Args:
        task: The problem.
        glide: Its duration is positive.
        refinement: Steps for each of the optimiser's.
    """
    velocity = np.array(
        velocity_through_water(np, glide.heading, glide.glide_angle, task.settings.speed)
    )
    fractions = aligned_fractions(task, glide, refinement * task.n_steps)
    track = fly_glide(task.flow, task.start, velocity, fractions * glide.duration)
    if not np.all(np.isfinite(track.position)):
        return Candidate(glide, 0.0, 0.0, np.inf, track)
    until = min(track.allowed_until(task.region.allowed), _above_bottom(task, track))
    time, distance = track.closest(task.goal, until)
    return Candidate(glide, until, time, distance, track)


def _above_bottom(task: GlideTask, track: Track) -> float:
    """Return the begin of the first step on which a track comes too near to the bottom [s]; its end when none does."""
    last = float(track.time[-1])
    if task.bottom is None:
        return last
    ends = np.stack([track.position[:-1], track.position[1:]], axis=1)
    below = task.bottom.is_below(ends[..., :2], ends[..., 2], np.full(len(ends), _SKIN))
    return float(track.time[np.argmax(below)]) if below.any() else last


def aligned_fractions(task: GlideTask, glide: Glide, n_steps: int) -> Array:
    """Return the ends of a glide's steps as fractions of its duration, one at each level it crosses."""
    end_depth = task.start[2] + task.settings.speed * np.sin(glide.glide_angle) * glide.duration
    return fractions_of_duration(task.start[2], end_depth, task.flow.levels, n_steps)


def optimise(task: GlideTask, guess: Glide) -> Candidate | None:
    """Return the optimum found from a guess; None when the solution is not a number.

    Least squares come near, IPOPT finishes. The steps fit the depths of the guess; where the dense path is farther away than the solver
    predicted, they are fitted to the depths of the solution, then refined. A path that leaves the region is solved within it; one that
    ends on land is left as it is, as the solver does not know about land.
    """
    iterations, n_steps, best, bounded = 0, task.n_steps, None, False
    for refinement in range(_REFINEMENTS + 1):
        begun = guess = _approached(task, guess, n_steps)
        answer = solve_glide(task, guess, aligned_fractions(task, guess, n_steps), bounded)
        iterations += answer.iterations
        if not np.isfinite(answer.distance):
            break
        guess = answer.glide
        flown = fly_candidate(task, guess)
        if best is None or flown.distance < best.distance:
            best = replace(flown, predicted_distance=answer.distance)
        if best.is_consistent or (
            flown.until < guess.duration and (bounded or stops_on_land(task, flown))
        ):
            break
        # A path cut short is not a matter of step length: from the same guess again, now within the region.
        if flown.until < guess.duration:
            bounded, guess = True, begun
            continue
        n_steps = task.n_steps * 2**refinement
    return best and replace(best, iterations=iterations, return_status=answer.return_status)


def stops_on_land(task: GlideTask, flown: Candidate) -> bool:
    """Return whether what cuts a glide short is land or the bottom, not the region's edge."""
    beyond = flown.track.at(np.array([min(flown.until + 1.0, flown.glide.duration)]))
    return meets_bottom(task, flown) or bool(task.region.inside(beyond)[0])


def meets_bottom(task: GlideTask, flown: Candidate) -> bool:
    """Return whether what cuts a glide short is the bottom of the bathymetry."""
    return flown.until < flown.track.allowed_until(task.region.allowed)


def _approached(task: GlideTask, guess: Glide, n_steps: int) -> Glide:
    """Return the guess after a least-squares approach, or as it was when the approach left the region or came no closer."""
    moved = approach(task, guess, aligned_fractions(task, guess, n_steps))
    return (
        moved
        if fly_candidate(task, moved, 1).distance < fly_candidate(task, guess, 1).distance
        else guess
    )


def polish(task: GlideTask, seed: Candidate) -> Candidate:
    """Return a seed improved without derivatives (Nelder-Mead on the flown distance), for when IPOPT did worse than the seed."""
    from scipy.optimize import minimize  # loads slowly, and is hardly ever needed

    limit = np.log(task.settings.max_duration)
    # of a goal that is missed by far, metres do not matter
    close = max(_POLISHED[0], _POLISHED[1] * seed.distance)

    def glide(unknowns: Array) -> Glide:
        return Glide(
            float(unknowns[0]), float(unknowns[1]), float(np.exp(np.clip(unknowns[2], 0.0, limit)))
        )

    heading, glide_angle, duration = seed.glide
    first = np.array([heading, glide_angle, np.log(duration)])
    simplex = first + np.vstack(
        [np.zeros(3), np.diag([0.02, 0.1 * max(abs(glide_angle), 1e-3), -0.02])]
    )
    options = {
        "initial_simplex": simplex,
        "xatol": close / (task.settings.speed * duration),
        "fatol": close,
        "maxiter": 100,
    }
    best = minimize(
        lambda at: fly_candidate(task, glide(at), 1).distance,
        first,
        method="Nelder-Mead",
        options=options,
    ).x
    improved = fly_candidate(task, glide(best))
    return improved if improved.distance <= seed.distance else seed


# A head current stronger than planned delays the closest approach; half as long again catches it, and a glide that has not come close
# by then has passed the goal.
_LONGER = 1.5
_FINER = 2


def fly(flow: FlowEstimate, plan: Plan) -> tuple[Array, Array, float]:
    """Return (time, track, closest approach) of a plan's heading and glide angle kept in a flow.

    The glide is flown for one and a half times the planned duration, or until it leaves the flow's region, meets land, surfaces or
    passes the deepest level. The closest approach is taken on the continuous path.

    Args:
        flow: Where to fly it; its projection may differ from that of the plan's flow.
        plan: The plan; one that failed stays where it is.

    Returns:
        Time, shape (n,) [s] since the start; track, shape (n, 3) [m], east, north, depth in the flow's local frame; distance [m].

    Raises:
        PlanError: The plan's start or goal is outside the flow's region or on land there.
    """
    region = Region(flow.grid)
    start, goal = locate(region, plan.start, "start"), locate(region, plan.goal, "goal")
    duration = _LONGER * plan.duration
    if plan.status == "failed" or duration == 0.0:
        return np.zeros(1), start[None, :], float(np.linalg.norm(start - goal))
    turn = float(true_north_halfway(flow.grid.projection, start[None, :2], goal[None, :2])[0])
    velocity = np.array(
        velocity_through_water(
            np, np.deg2rad(plan.heading_deg) + turn, np.deg2rad(plan.glide_angle_deg), plan.speed
        )
    )
    n_steps = _FINER * plan.track_time.size + flow.levels.size
    fractions = fractions_of_duration(
        start[2], start[2] + velocity[2] * duration, flow.levels, n_steps
    )
    track = fly_glide(flow, start, velocity, fractions * duration)
    until = track.allowed_until(region.allowed)
    _, distance = track.closest(goal, until)
    time = np.append(track.time[track.time < until], until)
    return time, track.at(time), distance
