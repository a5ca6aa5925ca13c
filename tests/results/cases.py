"""Small results that lack something, or lie where maps are difficult."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Place, Plan
from replay_kit.results import ResultWriter
from tests.results.result_samples import CONFIG, DEPTHS, METADATA

#: Writes a result to a path.
Case = Callable[[Path], None]


def moved(flow: FlowEstimate, longitude: float) -> FlowEstimate:
    """Return a flow with its whole region at another longitude."""
    projection = replace(flow.grid.projection, longitude=longitude)
    grid = replace(
        flow.grid,
        projection=projection,
        longitude=(flow.grid.longitude - flow.grid.projection.longitude + longitude + 180.0) % 360.0
        - 180.0,
    )
    return replace(flow, grid=grid)


def write(
    path: Path,
    flow: FlowEstimate,
    innovations: list[Innovation],
    plan: Plan | None,
    *,
    grids: bool = True,
    estimate: bool = True,
    depth: float = 20.0,
) -> None:
    """Write a result with a position and a measurement every hour about the centre of a flow."""
    centre = flow.grid.projection
    start = flow.time_ns or 0
    weights = np.linspace(-1.0, 1.0, flow.n_modes * flow.levels.size)
    with ResultWriter(path) as writer:
        writer.start(centre, start, METADATA, CONFIG)
        for k, innovation in enumerate(innovations):
            now = start + k * 3_600_000_000_000
            longitude = (centre.longitude + 0.01 * k + 180.0) % 360.0 - 180.0
            writer.fix(
                VehicleState(
                    now,
                    longitude,
                    centre.latitude + 0.002 * k,
                    depth,
                    False,
                    replace(innovation.source, topic="/gps"),
                )
            )
            writer.innovation(replace(innovation, time_ns=now + 5))
            writer.estimate(now + 5, weights, flow.levels)
            if grids:
                writer.grids(now + 6, flow, DEPTHS)
        if plan is not None:
            centred = replace(
                plan,
                start=Place(centre.longitude, centre.latitude, 0.0),
                goal=Place(centre.longitude + 0.05, centre.latitude + 0.02, 100.0),
                start_time_ns=start + 9 * 3_600_000_000_000,
            )
            writer.plan(centred, centre)
        if estimate:
            writer.finish(flow)
