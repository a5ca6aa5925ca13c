"""One glide flown densely in the estimate: the true closest approach of a seed or of the optimiser's solution."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from planners.glide.settings import GlideSettings
from planners.glide.transcription import GlideCase, approach, solve_glide
from planners.route.region import Region
from planners.track import Track, fly_glide, fractions_of_duration, velocity_through_water
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# Largest difference between the optimiser's closest approach and the dense one [m]; after this many refinements the plan reports it.
AGREEMENT = 1.0
_REFINEMENTS = 3
# Dense steps for each of the optimiser's.
_DENSE = 4
# A polished seed is good to this distance [m], and to this share of what it misses the goal by.
_POLISHED = 1e-2, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class GlideTask:
    """One planning problem.

    Attributes:
        flow: The current.
        region: Where the path may be.
        case: Places and limits in the local frame.
        settings: Limits of the glide, effort of the planner.
    """

    flow: FlowEstimate
    region: Region
    case: GlideCase
    settings: GlideSettings

    @property
    def n_steps(self) -> int:
        """Steps of the optimiser before any refinement: each level crossed takes at most one of its own."""
        return self.settings.n_steps + self.flow.levels.size


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A glide and its dense path.

    Attributes:
        heading: Clockwise from local north [rad].
        glide_angle: Below the horizontal [rad].
        duration: Flown [s].
        until: When its path leaves the region or meets land [s]; ``duration`` when it does not.
        time: Of the closest approach until then [s].
        distance: Closest approach until then [m].
        track: The dense path.
        predicted_distance: Closest approach by the optimiser's own path [m]; NaN for a seed.
        iterations: IPOPT's, over all refinements.
        return_status: IPOPT's last.
    """

    heading: float
    glide_angle: float
    duration: float
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


def fly_candidate(task: GlideTask, heading: float, glide_angle: float, duration: float, refinement: int = _DENSE) -> Candidate:
    """Return a glide flown through the task's flow.

    Args:
        task: The problem.
        heading: Clockwise from local north [rad].
        glide_angle: Below the horizontal [rad].
        duration: [s], positive.
        refinement: Steps for each of the optimiser's.
    """
    velocity = np.array(velocity_through_water(np, heading, glide_angle, task.case.speed))
    fractions = aligned_fractions(task, glide_angle, duration, refinement * task.n_steps)
    track = fly_glide(task.flow, task.case.start, velocity, fractions * duration)
    if not np.all(np.isfinite(track.position)):
        return Candidate(heading, glide_angle, duration, 0.0, 0.0, np.inf, track)
    until = track.allowed_until(task.region.allowed)
    time, distance = track.closest(task.case.goal, until)
    return Candidate(heading, glide_angle, duration, until, time, distance, track)


def aligned_fractions(task: GlideTask, glide_angle: float, duration: float, n_steps: int) -> Array:
    """Return the ends of a glide's steps as fractions of its duration, one at each level it crosses."""
    start_depth = task.case.start[2]
    end_depth = start_depth + task.case.speed * np.sin(glide_angle) * duration
    return fractions_of_duration(start_depth, end_depth, task.flow.levels, n_steps)


def optimise(task: GlideTask, guess: tuple[float, float, float]) -> Candidate | None:
    """Return the optimum found from a guess of heading, glide angle and duration; None when the solution is not a number.

    Least squares come near, IPOPT finishes. The steps fit the depths of the guess; where the dense path is farther away than the solver
    predicted, they are fitted to the depths of the solution, then refined. A path that leaves the region is solved within it; one that
    ends on land is left as it is, as the solver does not know about land.
    """
    iterations, n_steps, best, bounded = 0, task.n_steps, None, False
    for refinement in range(_REFINEMENTS + 1):
        begun = guess = _approached(task, guess, n_steps)
        answer = solve_glide(task.flow, task.case, guess, aligned_fractions(task, guess[1], guess[2], n_steps), bounded)
        iterations += answer.iterations
        if not np.isfinite(answer.distance):
            break
        guess = answer.heading, answer.glide_angle, answer.duration
        flown = fly_candidate(task, *guess)
        if best is None or flown.distance < best.distance:
            best = replace(flown, predicted_distance=answer.distance)
        fixed = task.settings.integrator == "euler"
        if best.is_consistent or fixed or (flown.until < flown.duration and (bounded or stops_on_land(task, flown))):
            break
        # A path cut short is not a matter of step length: from the same guess again, now within the region.
        if flown.until < flown.duration:
            bounded, guess = True, begun
            continue
        n_steps = task.n_steps * 2**refinement
    return best and replace(best, iterations=iterations, return_status=answer.return_status)


def stops_on_land(task: GlideTask, flown: Candidate) -> bool:
    """Return whether what cuts a glide short is land, not the region's edge."""
    beyond = flown.track.at(np.array([min(flown.until + 1.0, flown.duration)]))
    return bool(task.region.inside(beyond)[0])


def _approached(task: GlideTask, guess: tuple[float, float, float], n_steps: int) -> tuple[float, float, float]:
    """Return the guess after a least-squares approach, or as it was when the approach left the region or came no closer."""
    moved = approach(task.flow, task.case, guess, aligned_fractions(task, guess[1], guess[2], n_steps))
    return moved if fly_candidate(task, *moved, 1).distance < fly_candidate(task, *guess, 1).distance else guess


def polish(task: GlideTask, seed: Candidate) -> Candidate:
    """Return a seed improved without derivatives (Nelder-Mead on the flown distance), for when IPOPT did worse than the seed."""
    limit = np.log(task.settings.max_duration)
    # of a goal that is missed by far, metres do not matter
    close = max(_POLISHED[0], _POLISHED[1] * seed.distance)

    def distance(unknowns: Array) -> float:
        flown = fly_candidate(task, unknowns[0], unknowns[1], float(np.exp(np.clip(unknowns[2], 0.0, limit))), refinement=1)
        return flown.distance

    first = np.array([seed.heading, seed.glide_angle, np.log(seed.duration)])
    simplex = first + np.vstack([np.zeros(3), np.diag([0.02, 0.1 * max(abs(seed.glide_angle), 1e-3), -0.02])])
    options = {"initial_simplex": simplex, "xatol": close / (task.case.speed * seed.duration), "fatol": close, "maxiter": 100}
    best = minimize(distance, first, method="Nelder-Mead", options=options).x
    improved = fly_candidate(task, float(best[0]), float(best[1]), float(np.exp(np.clip(best[2], 0.0, limit))))
    return improved if improved.distance <= seed.distance else seed
