"""One constant-velocity glide as a nonlinear program: three unknowns, a path by Runge-Kutta, a squared distance to minimise.

Minimised over the duration too, the distance at the end is the closest approach on the continuous path. Everything that changes from
plan to plan (latent velocities, places, limits, steps) is a parameter, so that one graph serves every estimate on the same nodes.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from planners.flow import graph_key
from planners.hazards.bottom import Bathymetry, Bottom
from planners.hazards.domain import Region
from planners.solver import KM, QUIET, Recent, one_at_a_time
from planners.track import path_function, velocity_through_water
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# Most steps of least squares: a handful for a goal that can be reached; for others its rate is linear and IPOPT takes over.
_APPROACH_STEPS = 60
# Steepest angle a guess may have [rad]: the tangent of a right angle is no start.
_STEEPEST = np.pi / 2 - 1e-3
_OPTIONS: dict[str, Any] = {
    **QUIET,
    # Tight enough for a millimetre where nothing binds, and for centimetres where a limit does.
    "ipopt.tol": 1e-6,
    # The bends of hats between two iterates can keep the gradient just above that, at millimetres from the optimum.
    "ipopt.acceptable_tol": 1e-4,
    "ipopt.acceptable_iter": 2,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.max_iter": 40,
    # The seeds are good and lie mostly far from the limits: a small barrier keeps them where they are.
    "ipopt.mu_init": 1e-7,
    # The objective must fall wherever the limits hold to rounding; by default rounding counts as progress in feasibility.
    "ipopt.delta": 1e-10,
    "ipopt.bound_push": 1e-6,
    "ipopt.bound_frac": 1e-6,
    # Limits hold to the last digit: no relaxation beyond what the path's own check forgives.
    "ipopt.bound_relax_factor": 1e-9,
}


@dataclass(frozen=True, slots=True)
class GlideSettings:
    """Limits of a glide and effort of its planner.

    Attributes:
        speed: Through water [m/s].
        tolerance: A path that passes this close has reached the goal [m].
        max_duration: Longest glide considered [s].
        max_depth: Greatest depth that the vehicle may go to [m].
        n_steps: Steps of the optimiser, beside one for each level; doubled where the dense path disagrees by a metre.
        bathymetry: Bottom depth; a glide ends where it comes nearer to it than the clearance. None leaves the bottom out of account.
        clearance: Least height above it [m].
        starts: Most seeds that the optimiser starts from.
    """

    speed: float = 0.3
    tolerance: float = 250.0
    max_duration: float = 432000.0
    max_depth: float = inf
    n_steps: int = 24
    starts: int = 3
    bathymetry: Bathymetry | None = None
    clearance: float = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class GlideProgram:
    """The compiled program of one node set and one number of steps.

    Attributes:
        solver: CasADi NLP solver over (heading, descent, logarithm of duration).
        miss: CasADi function (unknowns, parameters) -> (goal to end of path [km], its Jacobian).
        lower: Lower bounds of the constraints.
        upper_sides: Upper bounds of the outline's constraints, one for each step and side.
    """

    solver: ca.Function
    miss: ca.Function
    lower: Array
    upper_sides: Array


class Glide(NamedTuple):
    """A glide at one constant velocity through water.

    Attributes:
        heading: Clockwise from local north [rad].
        glide_angle: Below the horizontal [rad].
        duration: [s].
    """

    heading: float
    glide_angle: float
    duration: float


# Not slotted: the sides are fitted once, when they are first needed.
@dataclass(frozen=True, eq=False)
class GlideTask:
    """One planning problem in the local frame.

    Attributes:
        flow: The current.
        region: Where the path may be.
        start: shape (3,) [m], local east, north, depth.
        goal: shape (3,) [m].
        settings: Limits of the glide, effort of the planner.
        bottom: What limits its depth; None without a bathymetry.
    """

    flow: FlowEstimate
    region: Region
    start: Array
    goal: Array
    settings: GlideSettings
    bottom: Bottom | None = None

    @property
    def n_steps(self) -> int:
        """Steps of the optimiser before any refinement: each level crossed takes at most one of its own."""
        return self.settings.n_steps + self.flow.levels.size

    @cached_property
    def sides(self) -> Array:
        """The outline, shape (4, 7), as ``Region.sides`` gives it."""
        return self.region.sides()


@dataclass(frozen=True, slots=True)
class GlideSolution:
    """The solution of IPOPT.

    Attributes:
        glide: The local optimum.
        distance: To the goal at the end [m].
        iterations: IPOPT's.
        return_status: IPOPT's.
    """

    glide: Glide
    distance: float
    iterations: int
    return_status: str


_programs = Recent[GlideProgram](8)


def glide_program(task: GlideTask, n_steps: int, bounded: bool) -> GlideProgram:
    """Return the program of a flow's nodes, built once: estimates that differ only in latent velocities share it.

    Args:
        task: Its flow counts.
        n_steps: Number of steps.
        bounded: Whether the path is constrained to the region.
    """
    flow = task.flow
    return _programs.get(
        (*graph_key(flow), n_steps, bounded),
        lambda: _build(flow, n_steps, bounded),
    )


def approach(task: GlideTask, guess: Glide, fractions: Array) -> Glide:
    """Return a guess moved towards the goal by nonlinear least squares, within the bounds of the unknowns; the region is ignored.

    From a rough seed the exact Hessian is often indefinite, and IPOPT spends dozens of iterations on it; the Gauss-Newton steps of
    least squares go straight down, at a third of the cost each. Arguments as for ``solve_glide``.
    """
    from scipy.optimize import least_squares  # loads slowly, and missions need none

    program = glide_program(task, fractions.size - 1, False)
    parameters = _parameters(task, fractions)
    unknowns, lower, upper = _unknowns(task.settings, guess)
    seen: dict[bytes, tuple[Array, Array]] = {}

    def miss(at: Array) -> tuple[Array, Array]:
        key = at.tobytes()
        if key not in seen:
            value, jacobian = program.miss(at, parameters)
            seen[key] = np.asarray(value).ravel(), np.asarray(jacobian)
        return seen[key]

    if not np.all(np.isfinite(miss(unknowns)[0])):
        return guess
    inside = np.clip(unknowns, lower + 1e-9, upper - 1e-9)
    answer = least_squares(
        lambda x: miss(x)[0],
        inside,
        lambda x: miss(x)[1],
        (lower, upper),
        x_scale="jac",
        max_nfev=_APPROACH_STEPS,
    )
    return _glide(task.settings, answer.x)


@one_at_a_time
def solve_glide(task: GlideTask, guess: Glide, fractions: Array, bounded: bool) -> GlideSolution:
    """Return the local optimum that IPOPT finds from a guess.

    Without constraints on the path its line search descends strictly, so the region is only brought in for paths that leave it.

    Args:
        task: The problem.
        guess: Where to begin.
        fractions: shape (n_steps + 1,), where the steps end as fractions of the duration.
        bounded: Whether the path is constrained to the region.
    """
    program = glide_program(task, fractions.size - 1, bounded)
    unknowns, lower, upper = _unknowns(task.settings, guess)
    answer = program.solver(
        x0=unknowns,
        p=_parameters(task, fractions),
        lbx=lower,
        ubx=upper,
        lbg=program.lower,
        ubg=np.concatenate([[task.region.deepest / KM], program.upper_sides])
        if bounded
        else program.upper_sides,
    )
    statistics = program.solver.stats()
    distance = (
        float(np.sqrt(max(float(answer["f"]), 0.0))) * KM
        if np.isfinite(float(answer["f"]))
        else np.inf
    )
    glide = _glide(task.settings, np.asarray(answer["x"]).ravel())
    return GlideSolution(
        glide, distance, int(statistics["iter_count"]), str(statistics["return_status"])
    )


def _unknowns(settings: GlideSettings, guess: Glide) -> tuple[Array, Array, Array]:
    """Return a guess as the program's unknowns with their lower and upper bounds: heading, descent in kilometres, logarithm of duration.

    The descent is V T tan(glide angle). At the small angles of a long glide it is the depth gained, so that duration and angle do not
    have to turn together along a curved valley of constant depth; and no angle is out of its reach.
    """
    duration = float(np.clip(guess.duration, 1.0, settings.max_duration))
    descent = (
        settings.speed * duration * np.tan(np.clip(guess.glide_angle, -_STEEPEST, _STEEPEST)) / KM
    )
    return (
        np.array([guess.heading, descent, np.log(duration)]),
        np.array([-np.inf, -np.inf, 0.0]),
        np.array([np.inf, np.inf, np.log(settings.max_duration)]),
    )


def _glide(settings: GlideSettings, unknowns: Array) -> Glide:
    """Return the glide of the program's unknowns."""
    duration = float(np.exp(unknowns[2]))
    return Glide(
        float(unknowns[0]),
        float(np.arctan(unknowns[1] * KM / (settings.speed * duration))),
        duration,
    )


def _parameters(task: GlideTask, fractions: Array) -> Array:
    sides, latent = task.sides.ravel(order="F"), task.flow.latent.ravel(order="F")
    return np.concatenate(
        [task.start, task.goal, [task.settings.speed], np.diff(fractions), sides, latent]
    )


def _build(flow: FlowEstimate, n_steps: int, bounded: bool) -> GlideProgram:
    unknowns = ca.MX.sym("unknowns", 3)
    start, goal, speed = ca.MX.sym("start", 3), ca.MX.sym("goal", 3), ca.MX.sym("speed")
    steps, sides = ca.MX.sym("steps", n_steps), ca.MX.sym("sides", 4, 7)
    latent = ca.MX.sym("latent", *flow.latent.shape)
    duration = ca.exp(unknowns[2])
    glide_angle = ca.atan(unknowns[1] * KM / (speed * duration))
    velocity = ca.vertcat(*velocity_through_water(ca, unknowns[0], glide_angle, speed))
    positions = ca.horzsplit(
        path_function(flow, n_steps)(start, velocity, duration * steps, latent)
    )
    beyond = [_beyond_sides(position[:2] / KM, sides) for position in positions]
    miss = (positions[-1] - goal) / KM
    program: dict[str, Any] = {
        "x": unknowns,
        "p": ca.veccat(start, goal, speed, steps, sides, latent),
        "f": ca.sumsqr(miss),
    }
    if bounded:
        program["g"] = ca.vertcat(positions[-1][2] / KM, *beyond)
    n_sides = 4 * n_steps if bounded else 0
    lower = np.concatenate([np.zeros(int(bounded)), np.full(n_sides, -np.inf)])
    jacobian = ca.Function("miss", [unknowns, program["p"]], [miss, ca.jacobian(miss, unknowns)])
    return GlideProgram(
        ca.nlpsol("glide", "ipopt", program, _OPTIONS), jacobian, lower, np.zeros(n_sides)
    )


def _beyond_sides(point: Any, sides: Any) -> Any:
    """Return how far a point [km] is beyond each of the four sides [km], negative inside."""
    along = sides[:, 2:4] @ point
    return sides[:, 0:2] @ point - (sides[:, 4] + sides[:, 5] * along + sides[:, 6] * along * along)
