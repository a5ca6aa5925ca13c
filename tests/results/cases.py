"""Small results that lack something, or lie where maps are difficult."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Innovation, VehicleState
from replay_kit.core.plan import Place, Plan
from replay_kit.logs import merge
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.outcome import Outcome, checked_outcome
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import read_result
from replay_kit.workflows.replay.account import Account
from replay_kit.workflows.replay.steps import Counts
from tests.results.result_samples import CONFIG, DEPTHS, METADATA
from tests.synthetic_flow import synthetic_flow

#: Writes a result to a path.
Case = Callable[[Path], None]


def placed(longitude: float, latitude: float) -> FlowEstimate:
    """Return a flow whose local frame has another centre."""
    flow = synthetic_flow(latitude=latitude)
    projection = Projection(longitude, latitude)
    places = to_geographic(projection, flow.grid.east, flow.grid.north)
    moved = replace(flow.grid, projection=projection, longitude=places[0], latitude=places[1])
    return replace(flow, grid=moved)


def on(flow: FlowEstimate, east: np.ndarray, north: np.ndarray) -> FlowEstimate:
    """Return a flow on a grid of other places, shape (J, I) [m]."""
    longitude, latitude = to_geographic(flow.grid.projection, east, north)
    grid = replace(flow.grid, longitude=longitude, latitude=latitude, east=east, north=north)
    return replace(flow, grid=grid, horizontal=replace(flow.horizontal, nodes=grid.nodes))


def turned(flow: FlowEstimate, degrees: float) -> FlowEstimate:
    """Return a flow with its grid turned against clockwise, but not the flow."""
    places = (flow.grid.east + 1j * flow.grid.north) * np.exp(1j * np.deg2rad(degrees))
    return on(flow, places.real, places.imag)


def one_bin(innovation: Innovation, **changes: Any) -> Innovation:
    """Return an innovation with its first bin alone, as of a mean current."""
    names = (
        *("depth", "innovation", "innovation_std", "residual", "prior_innovation"),
        *("flags", "reasons"),
    )
    first = {name: getattr(innovation, name)[:1] for name in names}
    return replace(innovation, **{**first, "dof": 2, **changes})


def write(
    path: Path,
    flow: FlowEstimate,
    innovations: list[Innovation],
    plan: Plan | None,
    *,
    grids: bool = True,
    estimate: bool = True,
    depth: float = 20.0,
    more: Callable[[ResultWriter], None] = lambda writer: None,
) -> Contents:
    """Write and open a result with a position and a measurement every hour about the centre of a flow, and what ``more`` adds."""
    centre = flow.grid.projection
    start, x = flow.time_ns or 0, np.linspace(-1.0, 1.0, flow.n_modes * flow.levels.size)
    estimated = flow
    if flow.unknowns is not None:
        latent = replace(flow.unknowns, x=x).latent(flow.modes, start)
        estimated = replace(flow, latent=latent)
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
            place = to_local(centre, longitude, centre.latitude + 0.002 * k)
            measured = estimated.velocity(*place, innovation.depth) + innovation.residual
            writer.innovations([replace(innovation, time_ns=now + 5, measured=measured)])
            if grids:
                writer.grids(now + 6, flow, DEPTHS)
        more(writer)
        if plan is not None:
            centred = replace(
                plan,
                start=Place(centre.longitude, centre.latitude, 0.0),
                goal=Place(centre.longitude + 0.05, centre.latitude + 0.02, 100.0),
                start_time_ns=start + 9 * 3_600_000_000_000,
            )
            writer.plan(centred, centre)
        writer.summary(start, outcome_of(innovations))
        if estimate:
            writer.finish(flow)
    return Contents(read_result(path))


def outcome_of(innovations: Sequence[Innovation]) -> Outcome:
    """Return the outcome of measurements, all of them used."""
    nothing = np.empty((0, 2))
    steps: list[Any] = [
        SimpleNamespace(event=None, innovation=one, dive_innovation=nothing) for one in innovations
    ]
    part = Account(Counts().after(steps), (), merge([], 0.0)).part()
    rows = [row | {"rms_innovation_predicted": None} for row in part["by_dive"]]
    return checked_outcome(part | {"by_dive": rows, "messages": None})


def failed(plan: Plan, message: str = "no path") -> Plan:
    """Return a plan that found no way."""
    lost: dict[str, Any] = {"track": plan.track[:0], "track_time": plan.track_time[:0]}
    return replace(plan, status="failed", message=message, **lost)


def without_estimate(
    path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan
) -> Contents:
    return write(path, flow, [innovation] * 3, plan, estimate=False)


def of_one_ping(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> Contents:
    return write(path, flow, [innovation], None)


def across_the_antimeridian(
    path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan
) -> Contents:
    return write(path, placed(179.98, 62.0), [innovation] * 4, plan)


def of_nothing(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> Contents:
    return write(path, flow, [], None, estimate=False)


def write_many(
    path: Path, flow: FlowEstimate, state: VehicleState, innovation: Innovation, pings: int
) -> None:
    """Write a result with a position, a measurement and an estimate every second, 500 to a dive."""
    second, noise = 1_000_000_000, np.random.default_rng(0).normal(0.0, 1.0, (997, 4))
    block = []
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, state.time_ns, METADATA, CONFIG)
        for k in range(pings):
            now = state.time_ns + k * second
            writer.fix(replace(state, time_ns=now, longitude=5.0 + 1e-7 * k))
            pairs = np.column_stack([noise[k % 997], innovation.innovation[:, 1]])
            block.append(replace(innovation, time_ns=now, dive=1 + k // 500, innovation=pairs))
            if len(block) == 16:
                writer.innovations(block)
                block = []
            if k % (pings // 20) == 0:
                writer.grids(now, flow, DEPTHS)
        if block:
            writer.innovations(block)
        writer.finish(flow)
