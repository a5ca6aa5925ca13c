"""Small flows for the planner's tests: random eddies, no current, a nearly uniform current."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from planners import MissionPlan, MissionRequest, NoGo, plan_mission
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalKernel,
    NodeKernel,
    velocity_kernel,
)
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.plan import Place
from tests.synthetic_flow import with_weights

CENTRE = Projection(152.5, -40.0)
LEVELS = (5.0, 40.0, 110.0, 230.0, 400.0)


def still_flow(
    shape: tuple[int, int] = (8, 10),
    levels: tuple[float, ...] = LEVELS,
    kind: Literal["hat", "gaussian"] = "hat",
    length: float = 12e3,
) -> FlowEstimate:
    """Return a flow without current on a grid of some 10 km cells."""
    longitude, latitude = np.meshgrid(
        152.5 + 0.1 * (np.arange(shape[1]) - shape[1] / 2),
        -40.0 + 0.08 * (np.arange(shape[0]) - shape[0] / 2),
    )
    east, north = to_local(CENTRE, longitude, latitude)
    depths = np.array(levels)
    grid = Grid(
        CENTRE, longitude, latitude, east, north, depths, np.full((depths.size, *shape), True)
    )
    n = 2 * len(grid.nodes)
    functions = NodeKernel(HorizontalKernel(length, 0.9 * length, 0.2), grid.nodes)
    return FlowEstimate(
        grid,
        functions,
        DepthFunctions(kind, 80.0),
        np.zeros((n, depths.size)),
        np.empty((n, 0)),
        None,
    )


def eddying_flow(
    seed: int,
    kind: Literal["hat", "gaussian"] = "hat",
    speed: float = 0.2,
    levels: tuple[float, ...] = LEVELS,
) -> FlowEstimate:
    """Return a flow of random latent velocities that fade with depth, of the given RMS speed at its nodes at the first level."""
    flow = still_flow(levels=levels, kind=kind)
    rng = np.random.default_rng(seed)
    latent = rng.standard_normal(flow.latent.shape[:1])[:, None] + 0.4 * rng.standard_normal(
        flow.latent.shape
    )
    flow = replace(flow, latent=latent * np.exp(-flow.levels / 500.0))
    at_nodes = flow.velocity(flow.nodes[:, 0], flow.nodes[:, 1], flow.levels[0])
    return replace(flow, latent=flow.latent * speed / np.sqrt(np.mean(np.sum(at_nodes**2, axis=1))))


def uncertain_flow() -> FlowEstimate:
    """Return an eddying flow of two modes with an uncertainty, so that it can be sampled."""
    flow = eddying_flow(12)
    modes = np.random.default_rng(0).standard_normal((len(flow.latent), 2))
    modes *= np.abs(flow.latent).max()
    return with_weights(replace(flow, time_ns=10**18), modes, 0.01 * np.eye(2 * flow.levels.size))


def uniform_flow(east: float, north: float) -> FlowEstimate:
    """Return a current that is uniform to a fraction of a percent over the inner grid, at all depths."""
    flow = still_flow(length=40e3)
    matrix = velocity_kernel(flow.horizontal.kernel, flow.nodes, flow.nodes)
    wanted = np.repeat([east, north], len(flow.nodes))
    latent = np.linalg.solve(matrix + 1e-9 * np.eye(len(matrix)), wanted)
    return replace(flow, latent=np.tile(latent[:, None], (1, flow.levels.size)))


def place(flow: FlowEstimate, east: float, north: float, depth: float = 0.0) -> Place:
    """Return a local point as a place."""
    longitude, latitude = to_geographic(flow.grid.projection, east, north)
    return Place(float(longitude), float(latitude), depth)


def request_between(
    flow: FlowEstimate, start: Sequence[float], *goals: Sequence[float], **how: Any
) -> MissionRequest:
    """Return a mission from a local point past others: east, north and, below the surface, depth [m]."""
    begin, *ends = (place(flow, *point) for point in (start, *goals))
    return MissionRequest(begin, tuple(ends), **how)


def plan_between(
    flow: FlowEstimate, start: Sequence[float], *goals: Sequence[float], **how: Any
) -> MissionPlan:
    """Return the plan of ``request_between``."""
    return plan_mission(flow, request_between(flow, start, *goals, **how))


def forbidden(
    flow: FlowEstimate, west: float, south: float, east: float, north: float, **kind: Any
) -> NoGo:
    """Return a forbidden area of local sides [m]."""
    corners = [
        place(flow, *corner)
        for corner in ((west, south), (east, south), (east, north), (west, north))
    ]
    return NoGo(
        tuple((corner.longitude, corner.latitude) for corner in corners),
        **{"name": "range", **kind},
    )


def fitted_flow(
    velocity: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    shape: tuple[int, int] = (13, 15),
) -> FlowEstimate:
    """Return a flow of one level that is a given divergence-free one, of local east and north [m], over the inner grid."""
    flow = still_flow(shape, (50.0,), length=22e3)
    matrix = velocity_kernel(flow.horizontal.kernel, flow.nodes, flow.nodes)
    wanted = np.concatenate(velocity(*flow.nodes.T))
    latent = np.linalg.lstsq(matrix, wanted, rcond=1e-13)[0]
    return replace(flow, latent=latent[:, None])
