"""Nonlinear program of a mission of L legs as a CasADi graph.

Unknowns: the ends of N = L M segments X [km], glide angle A [rad] and depth H [km] of each leg, miss distance S [km] of each goal,
violation z of half-planes [km], and relative speed v. The heading follows from the displacement through water q of each segment:

    q_k = X_k - X_(k-1) - sum_c (J_ck / w + D_k s_c) U_ck - b_k,    |q_1|^2 = (V cos A T_1)^2,    q_m T_1 = q_1 T_m within a leg,
    T_k = (p_k H - o_k) / w,    w = V sin A,    J_ck = a_k I_c(H) + a'_k I_c(H / 2) - j_ck,
    U_ck = (u_c(begin) + 4 u_c(middle) + u_c(end)) / 6

with I_c the integral over depth of the weight of level c, D drifts, s_c the weights at the surface. For a glide, a single leg from depth to
depth, A is the duration [h]: T_k = A / M, |q_1|^2 = (V T_1)^2 - (dz / M)^2, J_ck / w = j_ck T_k.

Constants from the simulated flight of the previous iterate: the defect b, the offset of a goal below the surface from its leg's chord,
half-planes and depth limits. At convergence the program is equivalent to the full simulation.

The current u_c and the I_c are B-splines of each level in space and time, and in depth.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planners.task import Task
from planners.vehicle import Glider
from replay_kit.core.arrays import Array, points_over

#: Programs measure distances in kilometres and times in hours, so that their unknowns are of order one to a hundred.
KM, HOUR = 1e3, 3600.0
# Knots a kernel length; depths of the integrals, and parts between two of them; margin over which a time beyond the last is held [h].
_PER_LENGTH, _DEPTHS, _PARTS, _HELD = 4.0, 61, 16, 0.2


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
        self._currents = task.currents
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
        self.at = self._splined(task)

    def weights(self, depths: Array) -> Array:
        """Return the weights of levels at depths [m], shape (n, C)."""
        return np.ascontiguousarray(self._currents.weights(depths)[:, : self.count])

    def integral(self, depth: float) -> Array:
        """Return the integrals of the levels' weights from the surface to a depth, shape (C,) [m]; an odd function of depth."""
        found = [np.interp(abs(depth), self._depths, column) for column in self._summed.T]
        return np.asarray(np.sign(depth) * np.array(found))

    def _splined(self, task: Task) -> ca.Function:
        flow, (low, high) = task.flow, task.flow.grid.ends
        lengths = flow.horizontal.kernel.lengths
        counts = np.maximum(np.ceil((high - low) / lengths * _PER_LENGTH).astype(int) + 1, 5)
        axes = [np.linspace(*span) for span in zip(low, high, counts, strict=True)]
        times, latent = task.currents_through()
        velocity = flow.horizontal.velocity(points_over(*axes), latent)
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
        return 0.5 * (x + ca.sqrt(x * x + _HELD**2))

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


#: Half-planes of each segment, and the offset of one that forbids nothing [km].
PLANES, FAR = 3, 1e7
# Cost of a kilometre behind a wall, and of what the other goals are missed by within which it is rounded [h/km, km^2].
_BEYOND, _ROUNDED = 200.0, 1e-4
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-5,
    "ipopt.acceptable_tol": 1e-4,
    "ipopt.acceptable_iter": 4,
    "ipopt.mu_init": 1e-3,
    "ipopt.bound_push": 1e-4,
    "ipopt.bound_frac": 1e-4,
    "ipopt.max_iter": 80,
}


@dataclass(frozen=True, slots=True)
class Shape:
    """Dimensions of a program.

    Attributes:
        legs: Number of legs.
        segments: Number of segments per leg.
        goals: Number of goals.
        glide: Whether the mission is a single glide.
        planes: Number of half-planes per segment.
    """

    legs: int
    segments: int
    goals: int
    glide: bool
    planes: int

    @property
    def n(self) -> int:
        """Number of segments."""
        return self.legs * self.segments


#: Parameters by name, in their order, with the shapes that a ``Shape`` gives them.
def _sizes(shape: Shape, levels: int) -> dict[str, tuple[int, int]]:
    n, goals = shape.n, shape.goals
    return {
        "start": (2, 1),
        "goals": (2, goals),
        "met": (n + 1, goals),  # which ends, or blends of two, meet each goal
        "bend": (2, goals),
        "passes": (n, 1),
        "begins": (n, 1),
        "whole": (n, 1),
        "half": (n, 1),
        "fixed": (levels, n),
        "drift": (n, 1),
        "walls": (4, n * shape.planes),
        "defect": (2, n),
        "pumps": (shape.legs, 1),
        "weights": (5, 1),  # of time, energy, misses, line, mooring
        "line": (4, 1),
        "mooring": (2, 1),
        "within": (3, 1),  # whether the line and the mooring count, and how far off [km]
        "glide": (1, 1),  # depth passed [km]
        "battery": (1, 1),  # one over its energy [1/kJ]
    }


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Compiled program with its solver.

    Attributes:
        shape: Dimensions of the program.
        levels: Number of levels.
        solver: IPOPT solver.
        result: CasADi function (unknowns, parameters) -> displacements through water (2, N) [km], durations (N) and ends (N) [h].
    """

    shape: Shape
    levels: int
    solver: Any
    result: Any

    def parameters(self, **given: Array) -> Array:
        """Return the parameter vector of the solver; omitted parameters, in the shapes of ``_sizes``, are zero."""
        sizes = _sizes(self.shape, self.levels)
        values = [
            np.reshape(given[k], sizes[k]) if k in given else np.zeros(sizes[k]) for k in sizes
        ]
        return np.concatenate([value.ravel(order="F") for value in values])


def program(water: Water, vehicle: Glider, shape: Shape) -> Program:
    """Return the program with given dimensions."""
    n, segments, planes = shape.n, shape.segments, shape.planes
    sizes = _sizes(shape, water.count)
    p = {name: ca.MX.sym(name, *size) for name, size in sizes.items()}
    ends, angles, depths = (
        ca.MX.sym(name, *size)
        for name, size in (("X", (2, n)), ("A", (shape.legs, 1)), ("H", (shape.legs, 1)))
    )
    missed, beyond, pace = ca.MX.sym("S", 2, shape.goals), ca.MX.sym("z"), ca.MX.sym("v")

    def each(of_legs: Any) -> Any:
        """Return values of legs repeated for each of their segments."""
        return of_legs if segments == 1 else ca.vec(ca.repmat(of_legs.T, segments, 1))

    along, down = (pace * speed * HOUR / KM for speed in vehicle.speeds(ca, angles))
    if shape.glide:
        lasts = each(angles) / segments
        speed = pace * vehicle.speed * HOUR / KM
        reach = (speed * lasts) ** 2 - (p["glide"] / segments) ** 2
        hours = p["fixed"] * ca.repmat(lasts.T, water.count, 1)
    else:
        lasts = (p["passes"] * each(depths) - p["begins"]) / each(down)
        reach = (each(along) * lasts) ** 2
        over = _columns(water.integrals(depths.T), segments) * _rows(p["whole"], water.count)
        if segments > 2:
            half = _columns(water.integrals(0.5 * depths.T), segments)
            over += half * _rows(p["half"], water.count)
        hours = (over - p["fixed"]) / _rows(each(down), water.count)
    hours += ca.mtimes(ca.DM(water.surface), p["drift"].T)
    points = ca.horzcat(p["start"], ends)
    begins, middles = points[:, :-1], 0.5 * (points[:, :-1] + ends)
    end = ca.cumsum(lasts + p["drift"])
    begin = ca.vertcat(0.0, end[:-1]) if n > 1 else ca.MX(0.0)
    flow = water.at.map(2 * n + 1)(
        ca.horzcat(points, middles), ca.vertcat(0.0, end, 0.5 * (begin + end)).T
    )
    mean = (flow[:, :n] + flow[:, 1 : n + 1] + 4.0 * flow[:, n + 1 :]) / 6.0
    carried = ca.vertcat(ca.sum1(hours * mean[0::2, :]), ca.sum1(hours * mean[1::2, :]))
    through = ends - begins - carried - p["defect"]
    firsts = list(range(0, n, segments))
    rest = [k for k in range(n) if k % segments]
    first_of_leg = [k - k % segments for k in rest]
    same = (
        ca.vec(
            through[:, rest] * _rows(lasts[first_of_leg], 2)
            - through[:, first_of_leg] * _rows(lasts[rest], 2)
        )
        if rest
        else ca.MX(0, 1)
    )
    columns = [k for k in range(n) for _ in range(planes)]
    at = begins[:, columns] + ca.repmat(p["walls"][3, :], 2, 1) * (ends - begins)[:, columns]
    walls = ca.sum1(p["walls"][:2, :] * at).T - p["walls"][2, :].T - beyond

    def off_line(place: Any) -> Any:
        along_east, along_north, east, north = ca.vertsplit(p["line"])
        return (along_east * (place[1, :] - north) - along_north * (place[0, :] - east)) ** 2

    def off_mooring(place: Any) -> Any:
        return _squares(place - ca.repmat(p["mooring"], 1, place.shape[1]))

    on_line, moored, radius = ca.vertsplit(p["within"])
    away = on_line * off_line(ends) + moored * off_mooring(ends)
    within = (away.T - radius**2) / radius - beyond
    driven = vehicle.thrust * (pace * vehicle.speed) ** 3 * ca.sum1(lasts)
    pumped = vehicle.pump_work(KM) * ca.dot(p["pumps"], depths)
    taken = (HOUR * (vehicle.hotel * end[-1] + driven) + pumped) / 1e3
    constraints = ca.vertcat(
        (_squares(through[:, firsts]).T - reach[firsts]) / 10.0,
        same,
        ca.vec(ca.mtimes(points, p["met"]) + p["bend"] - p["goals"] - missed),
        walls,
        within,
        p["battery"] * taken - 1.0 - beyond,
        end[-1],
    )
    time, energy, miss, line, mooring = ca.vertsplit(p["weights"])

    def integral(value: Any) -> Any:
        """Return the integral over time of a function of position, by Simpson's rule."""
        return (
            ca.sum2((lasts + p["drift"]).T * (value(begins) + 4.0 * value(middles) + value(ends)))
            / 6.0
        )

    cost = (
        time * end[-1]
        + energy * taken
        + miss * ca.sum2(ca.sqrt(_squares(missed) + _ROUNDED))
        + _BEYOND * beyond
        + line * integral(off_line)
        + mooring * integral(off_mooring)
    )
    unknowns = ca.veccat(ends, angles, depths, missed, beyond, pace)
    parameters = ca.veccat(*p.values())
    problem: dict[str, Any] = {"x": unknowns, "p": parameters, "f": cost, "g": constraints}
    solver = ca.nlpsol("mission", "ipopt", problem, _OPTIONS)
    result = ca.Function("result", [unknowns, parameters], [through, lasts, end])
    return Program(shape, water.count, solver, result)


def _columns(of_legs: Any, segments: int) -> Any:
    """Return columns of legs repeated for each segment."""
    return of_legs[:, [k for k in range(of_legs.shape[1]) for _ in range(segments)]]


def _rows(column: Any, count: int) -> Any:
    return ca.repmat(column.T, count, 1)


def _squares(places: Any) -> Any:
    return ca.sum1(places * places)
