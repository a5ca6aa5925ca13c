"""A random flow on a small grid, with land and a shallow corner."""

from dataclasses import replace
from typing import Literal

import numpy as np

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, HorizontalKernel, NodeKernel
from replay_kit.core.flow.process import Process, Unknowns
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid, Projection

TIME_NS = 1_700_000_000_123_456_789


def synthetic_flow(
    kind: Literal["hat", "gaussian"] = "hat",
    n_modes: int = 4,
    spacing: float = 5_000.0,
    latitude: float = 62.0,
    seed: int = 1,
) -> FlowEstimate:
    """Return a random flow on a 7 x 5 grid of 3 levels with one dry column and a shallower corner."""
    rng = np.random.default_rng(seed)
    projection = Projection(5.0, latitude)
    east, north = np.meshgrid(spacing * np.arange(-3.0, 4.0), spacing * np.arange(-2.0, 3.0))
    longitude, latitudes = to_geographic(projection, east, north)
    wet = np.ones((3, 5, 7), dtype=bool)
    wet[:, 0, 0] = False
    wet[2, 4, 5:] = False
    nodes, levels = int(wet[0].sum()), 3
    factor = rng.normal(size=(n_modes * levels, n_modes * levels))
    grid = Grid(projection, longitude, latitudes, east, north, np.array([0.5, 50.0, 200.0]), wet)
    latent = rng.normal(size=(2 * nodes, levels))
    flow = FlowEstimate(
        grid=grid,
        horizontal=NodeKernel(HorizontalKernel(1.2 * spacing, 1.1 * spacing, 0.5), grid.nodes),
        depth_functions=DepthFunctions(kind, 90.0),
        latent=latent,
        modes=rng.normal(size=(2 * nodes, n_modes)),
        time_ns=TIME_NS,
    )
    return with_weights(flow, flow.modes, 0.01 * factor @ factor.T) if n_modes else flow


def with_weights(flow: FlowEstimate, modes: np.ndarray, covariance: np.ndarray) -> FlowEstimate:
    """Return a flow whose modes' weights, level by level, have an error of some covariance and are constant in time."""
    levels, r = flow.levels.size, modes.shape[1]
    size = levels * r
    # one unknown for each weight
    process = Process(
        np.array([flow.time_ns or 0]),
        np.zeros((1, levels, r)),
        np.eye(size).reshape(1, size, levels, r),
        np.empty((0, levels, r)),
        np.ones(1),
        np.eye(levels),
        np.full(size, np.inf),
    )
    nothing, covariance = np.zeros((levels, len(flow.nodes))), 0.5 * (covariance + covariance.T)
    x = np.linspace(-1.0, 1.0, size)
    offset = flow.latent - modes @ x.reshape(levels, r).T
    unknowns = Unknowns(process, offset, x, covariance, flow.time_ns, nothing)
    return replace(flow, modes=modes, unknowns=unknowns)


def constant(flow: FlowEstimate, time_ns: int) -> FlowEstimate:
    """Return a flow without uncertainty that holds at any time, given for one [ns, UTC]."""
    at = replace(flow, time_ns=time_ns)
    return with_weights(at, flow.modes[:, :0], np.empty((0, 0)))


def growing(flow: FlowEstimate, factors: np.ndarray, step: float) -> FlowEstimate:
    """Return a flow without uncertainty that is multiplied by a factor a step [s] from its time on, and between them by their line."""
    start, levels = flow.time_ns or 0, flow.levels.size
    process = Process(
        start + (np.arange(factors.size) * step * 1e9).astype(np.int64),
        factors[:, None, None] * np.eye(levels),
        np.empty((factors.size, 0, levels, levels)),
        np.empty((0, levels, levels)),
        np.ones(factors.size),
        np.eye(levels),
        np.empty(0),
    )
    nothing = np.zeros((levels, len(flow.nodes)))
    empty, offset = np.empty((0, 0)), np.zeros_like(flow.latent)
    unknowns = Unknowns(process, offset, np.empty(0), empty, start, nothing)
    return replace(flow, modes=flow.latent, unknowns=unknowns).moved(start)


def regular(flow: FlowEstimate) -> FlowEstimate:
    """Return a flow on a grid of meridians and parallels."""
    longitude, latitude = np.meshgrid(np.linspace(4.8, 5.2, 7), np.linspace(61.9, 62.1, 5))
    east, north = to_local(flow.grid.projection, longitude, latitude)
    grid = replace(flow.grid, longitude=longitude, latitude=latitude, east=east, north=north)
    return replace(flow, grid=grid, horizontal=replace(flow.horizontal, nodes=grid.nodes))
