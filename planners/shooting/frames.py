"""The local frame along legs, and how it moves with where a leg begins, its heading and its glide angle.

Per metre of depth passed, a vehicle at x in a current u moves by rho + tau (x - begin) + kappa u in the local frame; adrift, by
stretch u per second. These coefficients, and sigma, the seconds per metre of depth, depend on begin, heading and glide angle alone.
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

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
