"""A random flow on a small grid, with land and a shallow corner."""

from dataclasses import replace
from typing import Literal

import numpy as np

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, HorizontalKernel, NodeKernel
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
    return FlowEstimate(
        grid=grid,
        horizontal=NodeKernel(HorizontalKernel(1.2 * spacing, 1.1 * spacing, 0.5), grid.nodes),
        depth_functions=DepthFunctions(kind, 90.0),
        latent=rng.normal(size=(2 * nodes, levels)),
        modes=rng.normal(size=(2 * nodes, n_modes)),
        covariance=0.01 * factor @ factor.T if n_modes else np.empty((0, 0)),
        time_ns=TIME_NS,
    )


def regular(flow: FlowEstimate) -> FlowEstimate:
    """Return a flow on a grid of meridians and parallels."""
    longitude, latitude = np.meshgrid(np.linspace(4.8, 5.2, 7), np.linspace(61.9, 62.1, 5))
    east, north = to_local(flow.grid.projection, longitude, latitude)
    grid = replace(flow.grid, longitude=longitude, latitude=latitude, east=east, north=north)
    return replace(flow, grid=grid, horizontal=replace(flow.horizontal, nodes=grid.nodes))
