"""A glider's mission as a nonlinear program: multiple shooting over its legs.

The unknowns are the heading and the glide angle of each leg, the place and the time of its end, and slack variables. Places are in
kilometres, times in hours, angles in radians: all of order one to a hundred. The functions and their derivatives are computed for all legs
at once; what is kept for further missions of the same shape is the order of their entries, and the solvers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planners.shooting.functions import MissionCase, MissionFunctions
from planners.shooting.layout import EACH, FrameMap, Layout
from planners.solver import (
    HOUR,
    KM,
    MOST_ALONG_LINE,
    MOST_ITERATIONS,
    OPTIONS,
    WARM,
    Recent,
    one_at_a_time,
)
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Projection


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePath:
    """A place or a line that a track is to stay near.

    Attributes:
        name: Its name in messages.
        origin: shape (2,) [m], the place, or a point of the line; local east and north.
        across: shape (2, 2), projection of the vector from the origin on what counts: all of it, or its part across the line.
        limit: Largest distance allowed [m].
        weight: Cost of an hour at a distance of a kilometre; it grows with the squared distance.
        surfacings_only: Whether only the places of surfacing count, and not the track between them.
        least_duration: Of the mission [s].
    """

    name: str
    origin: Array
    across: Array
    limit: float
    weight: float
    surfacings_only: bool
    least_duration: float

    def distances(self, points: Array) -> Array:
        """Return the distances [m] of points, shape (n, 2) [m], from the place or line."""
        return np.asarray(np.linalg.norm((points - self.origin) @ self.across.T, axis=1))

    def farthest_and_rms(self, time: Array, points: Array, ends: Array) -> tuple[float, float]:
        """Return the largest distance of a track and its root mean square [m], over time or over the surfacings.

        Args:
            time: shape (n,) [s].
            points: shape (n, 2) [m].
            ends: Numbers of the points at which a leg ends.
        """
        if self.surfacings_only:
            distances = self.distances(points[ends])
            return float(distances.max()), float(np.sqrt(np.mean(distances**2)))
        distances = self.distances(points)
        return float(distances.max()), float(np.sqrt(np.trapezoid(distances**2, time) / time[-1]))


def near_place(
    place: Array, radius: float, duration: float, surfacings_only: bool
) -> ReferencePath:
    """Return the reference path of a mooring within a radius [m] of a place, shape (2,) [m], for a duration [s]."""
    return ReferencePath(
        "the mooring", place, np.eye(2), radius, 3600.0 / duration, surfacings_only, duration
    )


def along_line(begin: Array, end: Array, weight: float, width: float) -> ReferencePath:
    """Return the reference path of the line between two points, shape (2,) [m].

    Args:
        begin: Of the line.
        end: Of the line.
        weight: Cross-track penalty [h per h and km].
        width: Largest distance allowed [m].
    """
    along = (end - begin) / np.linalg.norm(end - begin)
    normal = np.array([along[1], -along[0]])
    return ReferencePath("the line", begin, np.outer(normal, normal), width, weight, False, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class MissionGuess:
    """An initial guess or a solution of the program.

    Attributes:
        places: shape (L, 2) [m], at the ends of the legs.
        headings: shape (L,), clockwise from true north [rad].
        angles: shape (L,), glide angles [rad].
    """

    places: Array
    headings: Array
    angles: Array


@dataclass(frozen=True, slots=True, eq=False)
class MissionSolution:
    """The solver's result.

    Attributes:
        guess: The local optimum, from which another solve may begin.
        plane_violation: Largest distance beyond a half-plane [m].
        objective: In the program's units.
        iterations: IPOPT's.
        return_status: IPOPT's.
        through: shape (L, 2, 2), derivatives of the places where legs end by those where they begin; None where nothing was solved.
        places: shape (L, n_places, 2) [m], at which half-planes count; None where nothing was solved.
    """

    guess: MissionGuess
    plane_violation: float
    objective: float
    iterations: int
    return_status: str
    through: Array | None
    places: Array | None = None


class _Callback(ca.Callback):
    """A CasADi function that calls one of NumPy's arrays."""

    def __init__(
        self,
        name: str,
        given: Sequence[Any],
        found: Sequence[Any],
        evaluate: Callable[..., Sequence[Array | float]],
    ) -> None:
        """Take the sparsities of what is given and found, and the function between their entries."""
        ca.Callback.__init__(self)
        self._given, self._found, self._evaluate = given, found, evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of what is given."""
        return len(self._given)

    def get_n_out(self) -> int:
        """Return the number of what is found."""
        return len(self._found)

    def get_sparsity_in(self, index: int) -> Any:
        """Return the sparsity of what is given."""
        return self._given[index]

    def get_sparsity_out(self, index: int) -> Any:
        """Return the sparsity of what is found."""
        return self._found[index]

    def has_eval_buffer(self) -> bool:
        """Return that entries are passed where they lie in memory."""
        return True

    def eval_buffer(self, given: Sequence[Any], found: Sequence[Any]) -> int:
        """Evaluate the function."""
        values = [
            np.frombuffer(one) if size.nnz() else np.zeros(0)
            for one, size in zip(given, self._given, strict=True)
        ]
        for out, value in zip(found, self._evaluate(*values), strict=True):
            if out is not None:
                np.frombuffer(out)[:] = value
        return 0


class Program:
    """A mission's program of one layout, with its solvers."""

    def __init__(self, functions: MissionFunctions) -> None:
        """Make the callbacks of some functions."""
        self.functions, layout = functions, functions.layout
        self.lower = np.concatenate([np.zeros(layout.n_equal), np.full(layout.n_limited, -np.inf)])
        self.upper = np.zeros(layout.n_equal + layout.n_limited)
        unknowns = ca.Sparsity.dense(layout.n_unknowns, 1)
        one = ca.Sparsity.dense(1, 1)
        none = ca.Sparsity(0, 0)
        limits = ca.Sparsity.dense(self.upper.size, 1)
        value = functions.value
        jacobian = functions.jacobian_entries
        hessian = functions.hessian_entries
        # held: CasADi does not keep them
        self._value = _Callback("mission", [unknowns], [one, limits], value)
        self._derivatives = {
            "grad_f": _Callback(
                "grad_f",
                [unknowns, none],
                [one, unknowns],
                lambda x, _: (value(x)[0], functions.gradient(x)),
            ),
            "jac_g": _Callback(
                "jac_g",
                [unknowns, none],
                [limits, functions.jacobian.sparsity],
                lambda x, _: (value(x)[1], jacobian(x)),
            ),
            "hess_lag": _Callback(
                "hess_lag",
                [unknowns, none, one, limits],
                [functions.hessian.sparsity],
                lambda x, _, f, g: (hessian(x, float(f[0]), g),),
            ),
        }
        self._solvers: dict[bool, Any] = {}

    def solver(self, warm_start: bool = False) -> Any:
        """Return the solver for a guess that is nearly optimal (``warm_start``) or not; all share the same functions."""
        if warm_start not in self._solvers:
            layout = self.functions.layout
            x = ca.MX.sym("x", layout.n_unknowns)
            cost, constraints = self._value(x)
            most = MOST_ALONG_LINE if layout.has_reference else MOST_ITERATIONS
            each, beside = most[warm_start]
            options = {
                **OPTIONS,
                **(WARM if warm_start else {}),
                "ipopt.max_iter": each * layout.n_legs + beside,
                "no_nlp_grad": True,
                **self._derivatives,
            }
            self._solvers[warm_start] = ca.nlpsol(
                "mission", "ipopt", {"x": x, "f": cost, "g": constraints}, options
            )
        return self._solvers[warm_start]


_programs = Recent[Program](8)


def mission_program(projection: Projection, vehicle: Glider, layout: Layout) -> Program:
    """Return the program of a layout, made once for the missions that share it, in whatever flow."""
    return _programs.get(
        (projection, vehicle, layout),
        lambda: Program(MissionFunctions(layout, FrameMap(projection, vehicle, layout.n_legs))),
    )


@one_at_a_time
def solve_mission(
    program: Program,
    vehicle: Glider,
    case: MissionCase,
    guess: MissionGuess,
    *,
    warm_start: bool = False,
) -> MissionSolution:
    """Return the local optimum that IPOPT finds from a guess.

    Args:
        program: Of the mission's layout.
        vehicle: The glider.
        case: The mission's numbers.
        guess: Where to begin.
        warm_start: Whether the guess is the optimum of nearly the same problem.
    """
    functions, layout = program.functions, program.functions.layout
    solver = program.solver(warm_start)
    unknowns, lower, upper = _unknowns(vehicle, layout, case, guess)
    functions.give(case)
    answer = solver(x0=unknowns, lbx=lower, ubx=upper, lbg=program.lower, ubg=program.upper)
    statistics = solver.stats()
    found = np.asarray(answer["x"]).ravel()
    legs = found[: layout.slack_at].reshape(-1, EACH)
    return MissionSolution(
        MissionGuess(legs[:, :2] * KM, legs[:, 3], legs[:, 4]),
        float(found[-1]) * KM if layout.n_planes else 0.0,
        float(answer["f"]),
        int(statistics["iter_count"]),
        str(statistics["return_status"]),
        functions.first(found)[1].places[:, -1, :, :2],
        functions.places(found),
    )


def _unknowns(
    vehicle: Glider, layout: Layout, case: MissionCase, guess: MissionGuess
) -> tuple[Array, Array, Array]:
    """Return a guess as the program's unknowns, leg after leg, then the slacks, with their lower and upper bounds."""
    duration = case.lengths / np.asarray(vehicle.speeds(np, guess.angles)[1]) + case.drifts
    legs = np.column_stack(
        [guess.places / KM, np.cumsum(duration) / HOUR, guess.headings, guess.angles]
    )
    n_slacks, (shallow, steep) = layout.n_unknowns - layout.slack_at, vehicle.angles
    lower = np.concatenate([np.tile([*[-np.inf] * 4, shallow], layout.n_legs), np.zeros(n_slacks)])
    upper = np.concatenate(
        [np.tile([*[np.inf] * 4, steep], layout.n_legs), np.full(n_slacks, np.inf)]
    )
    if case.reference is not None:
        lower[layout.slack_at - EACH + 2] = case.reference.least_duration / HOUR
    miss = (guess.places[[leg for leg, _ in layout.goals]] - case.goals) / KM
    slacks = np.stack([np.maximum(miss, 0.0), np.maximum(-miss, 0.0)], axis=1).ravel()
    return np.concatenate([legs.ravel(), slacks, np.zeros(n_slacks - slacks.size)]), lower, upper
