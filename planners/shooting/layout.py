"""The local frame along legs, and where unknowns, constraints and the entries of their derivatives are in a mission's program.

Per metre of depth passed, a vehicle at x in a current u moves by rho + tau (x - begin) + kappa u in the local frame; adrift, by stretch u
per second. These coefficients, and sigma, the seconds per metre of depth, depend on begin, heading and glide angle alone.

The unknowns are, leg after leg, where and when it ends [km, km, h], its heading and its glide angle [rad]; then slack variables: of each
goal what is missed towards east, north, west and south [km], of the reference path, of the half-planes [km]. The constraints are those of
each leg's end (east, north, time), of each goal, of the half-planes of each place, of each place's distance from the reference path.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rate_in_frame
from replay_kit.core.grid import Projection

#: Where the coefficients are: rho (2), then tau, kappa and stretch (4 each, row after row), then sigma.
RHO, TAU, KAPPA, STRETCH, SIGMA, COUNT = 0, 2, 6, 10, 14, 15
# What they depend on: begin (2), heading, glide angle.
GIVEN = 4


class FrameMap:
    """The coefficients of the frames of a number of legs, and their derivatives."""

    def __init__(self, projection: Projection, vehicle: Glider, count: int) -> None:
        """Prepare the memory of ``count`` legs."""
        functions = _functions(projection, vehicle)
        shapes = (COUNT,), (GIVEN, COUNT), (GIVEN, GIVEN)
        self._calls = [
            _Call(function, count, shape) for function, shape in zip(functions, shapes, strict=True)
        ]

    def value(self, legs: Array, lengths: Array) -> Array:
        """Return the coefficients, shape (L, 15).

        Args:
            legs: shape (L, 4): begin [m], heading, clockwise from true north, and glide angle [rad].
            lengths: shape (L,), depth passed, down and up [m].
        """
        return self._calls[0](legs, lengths)

    def first(self, legs: Array, lengths: Array) -> Array:
        """Return their derivatives by the numbers of a leg, shape (L, 15, 4)."""
        return self._calls[1](legs, lengths).transpose(0, 2, 1)

    def second(self, legs: Array, lengths: Array, weights: Array) -> Array:
        """Return the second derivatives, shape (L, 4, 4), of their sums with weights, shape (L, 15)."""
        return self._calls[2](legs, lengths, weights)


class _Call:
    """A CasADi function of one leg called for several, without copies of what it takes and returns but one."""

    def __init__(self, function: Any, count: int, shape: tuple[int, ...]) -> None:
        mapped = function.map(count)
        self._given = [np.zeros(mapped.nnz_in(k)) for k in range(mapped.n_in())]
        self._found = np.zeros((count, *shape))
        # the buffer is held, as the call writes through it
        self._buffer, self._evaluate = mapped.buffer()
        for k, array in enumerate(self._given):
            self._buffer.set_arg(k, array.data)
        self._buffer.set_res(0, self._found.data)

    def __call__(self, *given: Array) -> Array:
        """Return what the function makes of arrays whose first axis is that of the legs."""
        for array, values in zip(self._given, given, strict=True):
            array[:] = values.ravel()
        self._evaluate()
        return self._found.copy()


@lru_cache(maxsize=8)
def _functions(projection: Projection, vehicle: Glider) -> tuple[Any, Any, Any]:
    """Return the functions of one leg for its coefficients, their derivatives, and the second derivatives of a sum of them."""
    leg, length, weights = ca.SX.sym("leg", GIVEN), ca.SX.sym("length"), ca.SX.sym("weights", COUNT)
    along, down = vehicle.speeds(ca, leg[3])
    through = along * ca.vertcat(ca.sin(leg[2]), ca.cos(leg[2]))
    rate, turn, stretch = frame_function(projection)(leg[:2], through, length / down)
    rows = ca.vec(stretch.T)
    value = ca.vertcat(rate / down, ca.vec(turn.T) / down, rows / down, rows, 1.0 / down)
    second = ca.hessian(ca.dot(weights, value), leg)[0]
    options = {"cse": True}
    return (
        ca.Function("frame_value", [leg, length], [value], options),
        ca.Function("frame_first", [leg, length], [ca.densify(ca.jacobian(value, leg))], options),
        ca.Function("frame_second", [leg, length, weights], [ca.densify(second)], options),
    )


@lru_cache(maxsize=8)
def frame_function(projection: Projection) -> ca.Function:
    """Return the function of a leg that makes ``rate_in_frame`` linear: (place, velocity through water, duration) -> (rate, turn, stretch).

    A compass holds a heading of true north, which turns along the leg, and the frame stretches lengths. At a place x in a current u the
    local coordinates change by rate + turn (x - place) + stretch u, the slopes being those halfway along the leg: to a part in a million
    for a leg of 5 km.

    Args:
        projection: The local frame.
    """
    place, through, current = (ca.SX.sym(name, 2) for name in ("place", "through", "current"))
    duration, at = ca.SX.sym("duration"), ca.SX.sym("at", 2)
    exact = ca.vertcat(
        *rate_in_frame(projection, at[0], at[1], (through[0], through[1]), (current[0], current[1]))
    )
    halfway = 0.5 * duration * through
    turn, stretch = (
        ca.substitute(ca.substitute(value, current, ca.DM.zeros(2)), at, place + halfway)
        for value in (ca.jacobian(exact, at), ca.jacobian(exact, current))
    )
    rate = (
        ca.substitute(ca.substitute(exact, current, ca.DM.zeros(2)), at, place + halfway)
        - turn @ halfway
    )
    return ca.Function("frame", [place, through, duration], [rate, turn, stretch], {"cse": True})


#: Unknowns of each leg.
EACH = 5


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the unknowns and constraints of a mission are.

    Attributes:
        n_legs: Number of legs.
        goals: In which leg each goal is met, counted from 0, and after which of its steps, from 1; 0 for its end.
        n_places: Places of a leg at which half-planes and the reference path count.
        n_planes: Half-planes of each place.
        has_reference: Whether there is a reference path.
        changing: Whether the current changes.
    """

    n_legs: int
    goals: tuple[tuple[int, int], ...]
    n_places: int
    n_planes: int
    has_reference: bool
    changing: bool

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns."""
        return (
            self.slack_at + 4 * len(self.goals) + int(self.has_reference) + int(self.n_planes > 0)
        )

    @property
    def slack_at(self) -> int:
        """Position of the first slack."""
        return EACH * self.n_legs

    @property
    def n_equal(self) -> int:
        """Number of constraints that are equations."""
        return 3 * self.n_legs + 2 * len(self.goals)

    @property
    def n_limited(self) -> int:
        """Number of the others."""
        return (self.n_planes + int(self.has_reference)) * self.n_places * self.n_legs

    @property
    def columns(self) -> NDArray[np.intp]:
        """Positions, shape (L, Q), of what each leg depends on among the unknowns; -1 for the start of the first, which is known."""
        legs = EACH * np.arange(self.n_legs)[:, None]
        before = np.where(legs > 0, legs - EACH + np.arange(3), -1)
        columns = np.concatenate([before[:, :2], legs + np.array([3, 4]), before[:, 2:]], axis=1)
        return columns if self.changing else columns[:, :GIVEN]


class Scatter:
    """Puts the entries of a sparse matrix, given in any order with positions of -1 left out, into the order of compressed columns."""

    def __init__(self, rows: Array, columns: Array, shape: tuple[int, int]) -> None:
        """Order entries at given rows and columns, shape (n,) each."""
        kept = np.flatnonzero((rows >= 0) & (columns >= 0))
        self._order = kept[np.lexsort((rows[kept], columns[kept]))]
        self.sparsity = ca.Sparsity.triplet(*shape, rows[kept].tolist(), columns[kept].tolist())

    def __call__(self, *parts: Array) -> Array:
        """Return the entries, in order, of parts one after the other."""
        return np.concatenate([np.ravel(part) for part in parts])[self._order]


def jacobian_scatter(layout: Layout) -> Scatter:
    """Return where the entries of the Jacobian are, in the order in which ``MissionFunctions`` gives them."""
    n_legs, columns, found = layout.n_legs, layout.columns, list[tuple[Any, Any]]()
    legs = np.arange(n_legs)
    found.append((3 * legs[:, None, None] + np.arange(2)[:, None], columns[:, None]))
    found.append((3 * legs[:, None] + np.arange(3), EACH * legs[:, None] + np.arange(3)))
    found.append((3 * legs + 2, np.where(legs > 0, EACH * legs - 3, -1)))
    found.append((3 * legs + 2, EACH * legs + 4))
    for g, (leg, step) in enumerate(layout.goals):
        rows = 3 * n_legs + 2 * g + np.arange(2)
        found.append((rows[:, None], columns[leg]) if step else (rows, EACH * leg + np.arange(2)))
    rows = 3 * n_legs + 2 * np.arange(len(layout.goals))[:, None] + np.array([0, 1, 0, 1])
    found.append((rows, layout.slack_at + np.arange(4 * len(layout.goals)).reshape(-1, 4)))
    at, per_leg = layout.n_equal, columns[:, None, None]
    if layout.n_planes:
        of_planes = at + np.arange(n_legs * layout.n_places * layout.n_planes).reshape(
            n_legs, layout.n_places, layout.n_planes
        )
        found += [(of_planes[..., None], per_leg), (of_planes, np.array(layout.n_unknowns - 1))]
        at += of_planes.size
    if layout.has_reference:
        of_places = at + np.arange(n_legs * layout.n_places).reshape(n_legs, layout.n_places)
        found += [
            (of_places[..., None], per_leg[:, 0]),
            (of_places, np.array(layout.slack_at + 4 * len(layout.goals))),
        ]
    return _scatter(found, (layout.n_equal + layout.n_limited, layout.n_unknowns))


def hessian_scatter(layout: Layout) -> Scatter:
    """Return where the entries of the Hessian's upper triangle are; those given below it are left out."""
    columns = layout.columns
    slacks = layout.slack_at + np.arange(4 * len(layout.goals)).reshape(-1, 4)
    found: list[tuple[Any, Any]] = [(one[:, :, None], one[:, None]) for one in (columns, slacks)]
    if layout.has_reference:
        found.append((np.array([slacks.max() + 1]),) * 2)
    return _scatter(found, (layout.n_unknowns,) * 2, upper=True)


def _scatter(found: list[tuple[Any, Any]], shape: tuple[int, int], upper: bool = False) -> Scatter:
    pairs = [[one.ravel() for one in np.broadcast_arrays(rows, columns)] for rows, columns in found]
    rows, columns = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    return Scatter(np.where(rows <= columns, rows, -1) if upper else rows, columns, shape)
