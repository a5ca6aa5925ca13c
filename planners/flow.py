"""The current estimate as a CasADi function with exact derivatives.

The expression is that of ``replay_kit.kernels``, written on vectors over the nodes: CasADi's MX runs one compiled loop for each
operation, which is five times faster over a flight than the same text expanded into scalars (SX). Its derivatives are CasADi's own.
"""

from typing import Any

import casadi as ca
import numpy as np

from replay_kit.flow import FlowEstimate
from replay_kit.kernels.depth import DepthFunctions
from replay_kit.kernels.horizontal import HorizontalKernel
from replay_kit.types import Array


def flow_function(nodes: Array, levels: Array, kernel: HorizontalKernel, depth_functions: DepthFunctions) -> ca.Function:
    """Return the CasADi function (east, north, depth, latent) -> (u, v) of every flow on these nodes.

    It equals ``FlowEstimate.velocity`` everywhere: constant in depth outside the levels, fading to zero outside the nodes. It is
    differentiable to any order in the position; the latent velocities are data, and derivatives by them are not defined.

    Args:
        nodes: shape (N, 2) [m], east and north.
        levels: shape (Z,) [m], increasing.
        kernel: Horizontal kernel.
        depth_functions: How levels combine.
    """
    # CasADi's type stubs read any list of expressions as SX.
    inputs: list[Any] = [ca.MX.sym(name) for name in ("east", "north", "depth")]
    east, north, depth = inputs
    latent = ca.MX.sym("latent", 2 * len(nodes), levels.size)
    at_depth = _latent_at_depth(latent, depth, levels, depth_functions)
    # Coordinates in kernel lengths keep every factor of the kernel of order one.
    x = (east - nodes[:, 0]) / kernel.length_east
    y = (north - nodes[:, 1]) / kernel.length_north
    k = (kernel.speed * kernel.length_east) ** 2 * ca.exp(-0.5 * (x * x + y * y))
    along_east, along_north = k * at_depth[: len(nodes)], k * at_depth[len(nodes) :]
    psi_terms = y / kernel.length_north * along_east - x / kernel.length_east * along_north
    u = ca.sum1(along_east) / kernel.length_north**2 - ca.dot(y, psi_terms) / kernel.length_north
    v = ca.sum1(along_north) / kernel.length_east**2 + ca.dot(x, psi_terms) / kernel.length_east
    options: dict[str, Any] = {"is_diff_in": [True, True, True, False], "cse": True}
    return ca.Function("flow", [*inputs, latent], [u, v], ["east", "north", "depth", "latent"], ["u", "v"], options)


def flow_function_of(flow: FlowEstimate) -> ca.Function:
    """Return ``flow_function`` of the nodes, levels and functions of an estimate; its latent velocities remain an argument."""
    return flow_function(flow.nodes, flow.levels, flow.kernel, flow.depth_functions)


def _latent_at_depth(latent: Any, depth: Any, levels: Array, functions: DepthFunctions) -> Any:
    """Return the latent velocities of a depth, (2N x 1), contracted over the levels before any kernel is evaluated."""
    if levels.size == 1 and functions.kind == "hat":
        return latent[:, 0]
    depth = ca.fmin(ca.fmax(depth, levels[0]), levels[-1])
    if functions.kind == "gaussian":
        return ca.mtimes(latent, ca.exp(-0.5 * ((depth - ca.DM(levels)) / functions.length) ** 2))
    # Only two hats differ from zero: picking their columns is Z/2 times less work than weighting all.
    table = ca.MX(ca.DM(levels))
    upper = ca.low(ca.DM(levels), depth)
    fraction = (depth - table[upper]) / (table[upper + 1] - table[upper])
    return latent[:, upper] * (1.0 - fraction) + latent[:, upper + 1] * fraction


def graph_key(flow: FlowEstimate) -> tuple[bytes, bytes, HorizontalKernel, DepthFunctions]:
    """Return what makes two estimates share one graph: nodes, levels, kernel and depth functions, but not the latent velocities."""
    return np.ascontiguousarray(flow.nodes).tobytes(), np.ascontiguousarray(flow.levels).tobytes(), flow.kernel, flow.depth_functions
