"""The current estimate as a CasADi function with exact first and second derivatives.

A flow is a contraction over its levels (and times), then one over its horizontal functions. Both are differentiated by hand. With X and Y
the distances to a node in kernel lengths and He the Hermite polynomials of probability, every derivative of a node kernel's stream
function is

    d^(p+q) psi / dX^p dY^q = (-1)^(p+q) sum_nodes k [He_p(X) He_(q+1)(Y) beta_u / l_y - He_(p+1)(X) He_q(Y) beta_v / l_x],

On a lattice, where the stream function is a sum of products of Gaussians g of widths w_x, w_y with the coefficients C around a place,

    d^(p+q) psi / dx^p dy^q = g_p(x)' C g_q(y),    g_p = (-1 / w_x)^p He_p(X) exp(-X^2 / 2),    X = (x - s) / w_x,

in which only ``WINDOW`` lattice lines a direction count: the cost depends on neither the nodes nor the size of the region. The window moves
with the place by whole lattice lines, at distances where a Gaussian is less than 3e-7.

So a derivative costs what the value costs, where automatic differentiation pays for every operation several times. MX runs one
compiled loop for each operation, which is faster than the same text expanded into scalars (SX). The latent values are an argument: a
new estimate needs no new graph.
"""

from collections.abc import Hashable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, NodeKernel
from replay_kit.core.flow.lattice import (
    HALF_WINDOW,
    WINDOW,
    HorizontalFunctions,
    StreamFunctionLattice,
)
from replay_kit.core.grid import Projection


def field_function(flow: FlowEstimate, times: Array | None = None) -> ca.Function:
    """Return the CasADi function (place, latent) -> velocity of every flow of an estimate's functions; place: east, north, depth[, time].

    It equals ``FlowEstimate.velocity`` without its potential everywhere: constant in depth outside the levels, fading to zero outside the
    grid. With times it is linear between them, and constant before the first and after the last. It is differentiable twice in place and
    time, not by the latent values, which are data.

    Args:
        flow: Its levels and functions in the horizontal and in depth; its latent values remain an argument.
        times: shape (T,) [s], increasing; the latent values are then (M, Z T), all levels of the first time first. None for a
            flow that does not change, whose latent values are (M, Z).
    """
    return _field(flow, flow.levels, flow.depth_functions, times, ("east", "north", "depth"))


def latent_over_time(flows: Sequence[FlowEstimate]) -> tuple[Array, Array]:
    """Return (times [s] since the first, latent values (M, Z T)) of one flow at several times.

    Args:
        flows: The flow at increasing times, each with its ``time_ns``, all of the same levels and functions.

    Raises:
        PlanError: There are fewer than two, a time is missing or does not increase, or their functions differ.
    """
    if len(flows) < 2:
        raise PlanError(
            f"a flow that changes needs two times or more, but {len(flows)} came; give one flow alone for one that does not"
        )
    for k, flow in enumerate(flows):
        before = flows[max(k - 1, 0)].time_ns
        if flow.time_ns is None or before is None or (k > 0 and flow.time_ns <= before):
            raise PlanError(
                f"flow {k} of a sequence has the time {flow.time_ns} ns after {before} ns; expected increasing times"
            )
        if graph_key(flow) != graph_key(flows[0]):
            raise PlanError(
                f"flow {k} of a sequence is not on the nodes, levels, kernel and depth functions of the first"
            )
    first = flows[0].time_ns or 0
    return np.array([((flow.time_ns or 0) - first) / 1e9 for flow in flows]), np.hstack(
        [flow.latent for flow in flows]
    )


def graph_key(flow: FlowEstimate) -> tuple[Hashable, bytes, DepthFunctions, Projection]:
    """Return what makes two estimates share one graph: functions in the horizontal and in depth, levels and frame; no latent values."""
    return (
        flow.horizontal.key,
        np.ascontiguousarray(flow.levels).tobytes(),
        flow.depth_functions,
        flow.grid.projection,
    )


def _field(
    flow: FlowEstimate,
    levels: Array,
    functions: DepthFunctions,
    times: Array | None,
    axes: tuple[str, ...],
) -> ca.Function:
    """Return the function (place, latent) -> velocity with its own derivatives, its place having these axes and time where there is one."""
    names = axes if times is None else (*axes, "time")
    place: Any = ca.MX.sym("place", len(names))
    latent = ca.MX.sym(
        "latent", flow.horizontal.size, levels.size * (1 if times is None else times.size)
    )
    summed = _sum_over(flow.horizontal, place)

    def derivative(*by: str) -> Any:
        """Return the velocity differentiated once by each of the axes given."""
        by_depth = (
            _depth_columns(levels, functions, place[2], by.count("depth"))
            if "depth" in names
            else [(0, 1.0)]
        )
        by_time = (
            [(0, 1.0)]
            if times is None
            else _hat_columns(times, place[len(names) - 1], by.count("time"))
        )
        columns = [
            (z + levels.size * t, of_time * of_depth)
            for t, of_time in by_time
            for z, of_depth in by_depth
        ]
        if not columns:
            return ca.MX(2, 1)
        combined = sum(weight * summed.near(latent, column) for column, weight in columns)
        return summed.velocity(combined, by.count("east"), by.count("north"))

    first = ca.horzcat(*(derivative(i) for i in names))
    # one row for each entry of the Jacobian, column after column
    second = ca.vertcat(*(ca.horzcat(*(derivative(i, j) for j in names)) for i in names))
    return _with_derivatives(place, latent, derivative(), first, second)


def _with_derivatives(place: Any, latent: Any, value: Any, first: Any, second: Any) -> ca.Function:
    """Return the function (place, latent) -> value whose derivatives by the place are the expressions given; none are made by CasADi."""
    inputs, names = [place, latent], ["place", "latent"]
    n, n_latent = value.numel(), latent.numel()
    options: dict[str, Any] = {"cse": True, "never_inline": True}
    given = [
        ca.MX.sym("out_value", n),
        ca.MX.sym("out_first", *first.shape),
        ca.MX.sym("out_first_latent", ca.Sparsity(n, n_latent)),
    ]
    outputs = {"jac_value_place": first, "jac_value_latent": ca.MX(n, n_latent)}
    blocks = {
        f"jac_{name}_{by}": ca.MX(outputs[name].numel(), k)
        for name in outputs
        for by, k in (("latent", n_latent), ("out_value", n))
    }
    blocks |= {
        "jac_jac_value_place_place": second,
        "jac_jac_value_latent_place": ca.MX(n * n_latent, place.numel()),
    }
    order = [f"jac_{name}_{by}" for name in outputs for by in ("place", "latent", "out_value")]
    by_value = [*names, "out_value"]
    hessian = ca.Function(
        "jac_jac_field",
        [*inputs, *given],
        [blocks[name] for name in order],
        [*by_value, "out_jac_value_place", "out_jac_value_latent"],
        order,
        {**options, "is_diff_in": [True, False, False, False, False]},
    )
    custom = {
        **options,
        "is_diff_in": [True, False, False],
        "custom_jacobian": hessian,
        "jac_penalty": 0,
    }
    jacobian = ca.Function(
        "jac_field", [*inputs, given[0]], list(outputs.values()), by_value, list(outputs), custom
    )
    custom = {**options, "is_diff_in": [True, False], "custom_jacobian": jacobian, "jac_penalty": 0}
    return ca.Function("field", inputs, [value], names, ["value"], custom)


def _sum_over(functions: HorizontalFunctions, place: Any) -> "_SumOverNodes | _SumOverLattice":
    if isinstance(functions, StreamFunctionLattice):
        return _SumOverLattice(functions, place)
    if not isinstance(functions, NodeKernel):
        raise TypeError(f"no graph of {type(functions).__name__} is known")
    return _SumOverNodes(functions, place)


class _SumOverNodes:
    """The contraction over the nodes: velocities, and their derivatives in place, of the latent velocities of one depth and time."""

    def __init__(self, functions: NodeKernel, place: Any) -> None:
        kernel, nodes = functions.kernel, functions.nodes
        # Coordinates in kernel lengths keep every factor of the kernel of order one.
        self.lengths = kernel.length_east, kernel.length_north
        x, y = ((place[i] - nodes[:, i]) / self.lengths[i] for i in (0, 1))
        self.gaussian = (kernel.speed * kernel.length_east) ** 2 * ca.exp(-0.5 * (x * x + y * y))
        self.hermite_x, self.hermite_y = _hermite(x), _hermite(y)

    def near(self, latent: Any, column: Any) -> Any:
        """Return the latent velocities of a column that count at the place: all."""
        return latent[:, column]

    def velocity(self, latent: Any, east: int, north: int) -> Any:
        """Return the velocity (2 x 1) of latent velocities (2N x 1), differentiated so many times towards east and north."""
        along_x, along_y = self.lengths
        scale = along_x**east * along_y**north
        u = self._stream_function(latent, east, north + 1) / (along_y * scale)
        v = -self._stream_function(latent, east + 1, north) / (along_x * scale)
        return ca.vertcat(u, v)

    def _stream_function(self, latent: Any, p: int, q: int) -> Any:
        """Return d^(p+q) psi / dX^p dY^q."""
        n = self.gaussian.numel()
        east = ca.dot(self.hermite_x[p] * self.hermite_y[q + 1], self.gaussian * latent[:n])
        north = ca.dot(self.hermite_x[p + 1] * self.hermite_y[q], self.gaussian * latent[n:])
        return (-1) ** (p + q) * (east / self.lengths[1] - north / self.lengths[0])


class _SumOverLattice:
    """The same over the coefficients of a lattice in the window around the place."""

    def __init__(self, lattice: StreamFunctionLattice, place: Any) -> None:
        first, self.gaussians = [], []
        for origin, spacing, width, count, at in zip(
            lattice.origin,
            lattice.spacing,
            lattice.widths,
            lattice.shape,
            ca.vertsplit(place)[:2],
            strict=True,
        ):
            line = ca.fmin(
                ca.fmax(ca.floor((at - origin) / spacing) - (HALF_WINDOW - 1), 0.0),
                float(count - WINDOW),
            )
            x = (at - origin - spacing * (line + np.arange(WINDOW))) / width
            gaussian = ca.exp(-0.5 * x * x)
            self.gaussians.append(
                [(-1.0 / width) ** p * he * gaussian for p, he in enumerate(_hermite(x)[:4])]
            )
            first.append(line)
        window = np.add.outer(lattice.shape[1] * np.arange(WINDOW), np.arange(WINDOW)).ravel()
        self.rows, self.size = lattice.shape[1] * first[0] + first[1] + window, lattice.size

    def near(self, latent: Any, column: Any) -> Any:
        """Return the coefficients of a column in the window, north first."""
        return latent.nz[self.rows + self.size * column]

    def velocity(self, latent: Any, east: int, north: int) -> Any:
        """Return the velocity (2 x 1) of the window's coefficients, differentiated so many times towards east and north."""
        coefficients = ca.reshape(latent, WINDOW, WINDOW)
        return ca.vertcat(
            self._stream_function(coefficients, east, north + 1),
            -self._stream_function(coefficients, east + 1, north),
        )

    def _stream_function(self, coefficients: Any, p: int, q: int) -> Any:
        """Return d^(p+q) psi / dx^p dy^q."""
        along_east = ca.mtimes(coefficients.T, self.gaussians[1][q])
        return ca.dot(self.gaussians[0][p], along_east)


def _hermite(x: Any) -> list[Any]:
    """Return He_0 to He_4 at x, with d/dx (He_p exp(-x^2/2)) = -He_(p+1) exp(-x^2/2)."""
    values = [ca.MX.ones(x.shape), x]
    for p in range(1, 4):
        values.append(x * values[p] - p * values[p - 1])
    return values


def _depth_columns(
    levels: Array, functions: DepthFunctions, depth: Any, order: int
) -> list[tuple[Any, Any]]:
    """Return the levels that count at a depth and their weights, the functions of depth differentiated so many times."""
    if functions.kind == "hat":
        return _hat_columns(levels, depth, order)
    within = ca.logic_and(depth >= levels[0], depth <= levels[-1]) if order else 1.0
    x = (ca.fmin(ca.fmax(depth, levels[0]), levels[-1]) - ca.DM(levels)) / functions.length
    weights = (-1 / functions.length) ** order * within * _hermite(x)[order] * ca.exp(-0.5 * x * x)
    return [(j, weights[j]) for j in range(levels.size)]


def _hat_columns(knots: Array, at: Any, order: int) -> list[tuple[Any, Any]]:
    """Return the knots between which a number lies and their weights; beyond the ends the nearest knot alone counts."""
    if knots.size == 1 or order > 1:
        return [(0, 1.0)] if order == 0 else []
    # Only two hats differ from zero: picking their columns is less work than weighting all.
    table = ca.MX(ca.DM(knots))
    lower = ca.low(ca.DM(knots), at)
    spacing = table[lower + 1] - table[lower]
    if order == 1:
        slope = ca.logic_and(at >= knots[0], at <= knots[-1]) / spacing
        return [(lower, -slope), (lower + 1, slope)]
    fraction = (ca.fmin(ca.fmax(at, knots[0]), knots[-1]) - table[lower]) / spacing
    return [(lower, 1.0 - fraction), (lower + 1, fraction)]
