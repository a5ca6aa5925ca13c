"""Currents, random islands, shelves and areas for missions."""

from dataclasses import replace

import numpy as np

from planners import NoGo
from replay_kit import open_ensemble
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.estimator import embed_member
from tests.places import DATA
from tests.planners.flow_samples import place


def members_flow(number: int, tiny: bool) -> FlowEstimate | None:
    """Return a member of the quasi-geostrophic set as it is; None where the shared data are not there, or when tiny."""
    path = DATA / "qg" / "climatology.nc"
    if tiny or not path.exists():
        return None
    return embed_member(open_ensemble(path), number, EstimatorConfig())


def bounds(flow: FlowEstimate) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the largest local east and north of a flow's grid [m]."""
    low, high = (np.array([f(flow.grid.east), f(flow.grid.north)]) for f in (np.min, np.max))
    return low, high


def islands(flow: FlowEstimate, rng: np.random.Generator) -> FlowEstimate:
    """Return a flow with blocks of land, from the surface or from some level down."""
    wet = flow.grid.wet.copy()
    for _ in range(rng.integers(1, 5)):
        j, i = (rng.integers(0, size) for size in wet.shape[1:])
        high, wide = rng.permutation([rng.integers(1, 4), rng.integers(1, 3)])
        wet[rng.integers(0, 3) :, j : j + high, i : i + wide] = False
    keep, grid = np.tile(wet[0].ravel(), 2), replace(flow.grid, wet=wet)
    return replace(
        flow,
        grid=grid,
        horizontal=replace(flow.horizontal, nodes=grid.nodes),
        latent=flow.latent[keep],
        modes=flow.modes[keep],
    )


def random_area(flow: FlowEstimate, centre, rng: np.random.Generator, name: str) -> NoGo:
    """Return an area of up to 3 km around a place."""
    bearings = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 7)))
    far = rng.uniform(300.0, 3000.0)
    corners = [
        place(flow, *(centre + far * np.array([np.sin(at), np.cos(at)])), 0.0) for at in bearings
    ]
    return NoGo(
        tuple((corner.longitude, corner.latitude) for corner in corners),
        name,
        surface_only=bool(rng.random() < 0.3),
    )
