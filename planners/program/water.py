"""Current of a mission as B-splines of each level in space and time, and integrals over depth."""

from typing import Any

import casadi as ca
import numpy as np

from planners.task import Task
from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import depth_weights

#: Programs measure distances in kilometres and times in hours, so that their unknowns are of order one to a hundred.
KM, HOUR = 1e3, 3600.0
# Knots a kernel length; depths of the integrals, and parts between two of them; margin over which a time beyond the last is held [h].
_PER_LENGTH, _DEPTHS, _PARTS, _ROUNDED = 4.0, 61, 16, 0.2


class Water:
    """Current of a mission for CasADi.

    Attributes:
        count: Number of levels within the dive depth, C.
        surface: Weights of levels at the surface, shape (C,).
        integrals: CasADi function depth [km] -> integral of each level's weight from the surface, shape (C,) [km].
        at: CasADi function (position [km], time [h]) -> current of each level, shape (2 C,) [km/h].
    """

    def __init__(self, task: Task) -> None:
        """Fit the splines over the whole region, as routes in strong currents deviate far from the straight line."""
        flow = task.flow
        deepest = max(task.settings.deepest, float(np.max(task.goals[:, 2])), float(task.start[2]))
        self._functions, self._levels = flow.depth_functions, flow.levels
        met = int(np.searchsorted(flow.levels, deepest)) + 1
        self.count = min(max(met, 2), flow.levels.size)
        self.surface = self.weights(np.zeros(1))[0]
        depths = np.linspace(0.0, max(deepest, 1.0), _DEPTHS)
        fine = np.linspace(0.0, depths[-1], (_DEPTHS - 1) * _PARTS + 1)
        weights = self.weights(fine)
        steps = 0.5 * (weights[1:] + weights[:-1]) * np.diff(fine)[:, None]
        summed = np.vstack([np.zeros(self.count), np.cumsum(steps, axis=0)])[::_PARTS]
        self._depths, self._summed = depths, summed
        self.integrals = spline([depths / KM], summed.T / KM)
        self.at = self._currents(task)

    def weights(self, depths: Array) -> Array:
        """Return the weights of levels at depths [m], shape (n, C)."""
        found = depth_weights(self._functions, depths, self._levels)
        held: Array = np.ascontiguousarray(found[:, : self.count])
        return held

    def integral(self, depth: float) -> Array:
        """Return the integrals of the levels' weights from the surface to a depth, shape (C,) [m]; an odd function of depth."""
        found = [np.interp(abs(depth), self._depths, of) for of in self._summed.T]
        return np.asarray(np.sign(depth) * np.array(found))

    def _currents(self, task: Task) -> ca.Function:
        flow, kernel, grid = task.flow, task.flow.horizontal.kernel, task.flow.grid
        low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
        lengths = np.array([kernel.length_east, kernel.length_north])
        counts = np.maximum(np.ceil((high - low) / lengths * _PER_LENGTH).astype(int) + 1, 5)
        axes = [np.linspace(low[i], high[i], counts[i]) for i in (0, 1)]
        times, latent = task.currents_through()
        points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        velocity = flow.horizontal.velocity(points, latent)
        velocity = velocity.reshape(2, counts[1], counts[0], times.size, -1)[..., : self.count]
        # level after level, each east and north
        table = velocity.transpose(4, 0, 2, 1, 3).reshape(-1, counts[0], counts[1], times.size)
        table, place, time = table * HOUR / KM, ca.MX.sym("place", 2), ca.MX.sym("time")
        axes = [axis / KM for axis in axes]
        if times.size == 1:
            return ca.Function("at", [place, time], [spline(axes, table[..., 0])(place)])
        held = _held(time, times[0] / HOUR, times[-1] / HOUR)
        value = spline([*axes, times / HOUR], table)(ca.vertcat(place, held))
        return ca.Function("at", [place, time], [value])


def _held(time: Any, first: float, last: float) -> Any:
    """Return a time smoothly clipped to the first and last."""

    def ramp(x: Any) -> Any:
        return 0.5 * (x + ca.sqrt(x * x + _ROUNDED**2))

    return first + ramp(time - first) - ramp(time - last)


def spline(axes: list[Array], values: Array) -> ca.Function:
    """Return the interpolating B-spline of values as a CasADi function, cubic along axes of four or more.

    Args:
        axes: Increasing coordinates along each axis.
        values: Values, shape (m, n1, n2, ...).
    """
    coefficients, degrees = values, [min(len(axis) - 1, 3) for axis in axes]
    knots = [_knots(axis, degree) for axis, degree in zip(axes, degrees, strict=True)]
    for k, axis in enumerate(axes):
        # fitted one axis after the other
        unit = np.eye(len(axis)).ravel(order="F").tolist()
        basis = ca.Function.bspline("basis", [knots[k]], unit, [degrees[k]], len(axis))
        solved = np.linalg.inv(np.array(basis(np.asarray(axis)[None])).T)
        coefficients = np.moveaxis(np.tensordot(solved, coefficients, axes=(1, k + 1)), 0, k + 1)
    flat = coefficients.ravel(order="F").tolist()
    return ca.Function.bspline("spline", knots, flat, degrees, values.shape[0])


def _knots(axis: Array, degree: int) -> list[float]:
    """Return the knots of an interpolating spline of a degree; not-a-knot for cubic ones."""
    inner = axis[2:-2] if degree == 3 else axis[1:-1] if degree == 1 else axis[:0]
    ends = [float(axis[0])] * (degree + 1), [float(axis[-1])] * (degree + 1)
    return [*ends[0], *map(float, inner), *ends[1]]
