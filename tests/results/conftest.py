"""A small synthetic flow and the values of a small run."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from replay_kit.flow import FlowEstimate
from replay_kit.geodesy import to_geographic
from replay_kit.kernels.depth import DepthFunctions
from replay_kit.kernels.horizontal import HorizontalKernel
from replay_kit.results import ResultWriter
from replay_kit.types import Grid, Innovation, Place, Plan, Projection, Source, VehicleState
from tests.results.result_samples import CONFIG, DEPTHS, METADATA, Run, decoded

TIME_NS = 1_700_000_000_123_456_789
MakeFlow = Callable[..., FlowEstimate]


def synthetic_flow(
    kind: Literal["hat", "gaussian"] = "hat", n_modes: int = 4, spacing: float = 5_000.0, latitude: float = 62.0, seed: int = 1
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
    return FlowEstimate(
        grid=Grid(projection, longitude, latitudes, east, north, np.array([0.5, 50.0, 200.0]), wet),
        kernel=HorizontalKernel(1.2 * spacing, 1.1 * spacing, 0.5),
        depth_functions=DepthFunctions(kind, 90.0),
        latent=rng.normal(size=(2 * nodes, levels)),
        modes=rng.normal(size=(2 * nodes, n_modes)),
        covariance=0.01 * factor @ factor.T if n_modes else np.empty((0, 0)),
        time_ns=TIME_NS,
    )


@pytest.fixture(scope="session")
def make_flow() -> MakeFlow:
    return synthetic_flow


@pytest.fixture
def flow() -> FlowEstimate:
    return synthetic_flow()


@pytest.fixture
def state() -> VehicleState:
    return VehicleState(TIME_NS, 5.01, 62.02, 12.5, True, Source(0, "/gps", 77, TIME_NS))


@pytest.fixture
def innovation() -> Innovation:
    rng = np.random.default_rng(3)
    misfit = rng.normal(size=(4, 2))
    misfit[2] = np.nan
    return Innovation(
        time_ns=TIME_NS + 5,
        depth=np.array([10.0, 20.0, 30.0, 40.0]),
        innovation=misfit,
        innovation_std=np.abs(rng.normal(size=(4, 2))),
        residual=0.1 * misfit,
        prior_innovation=2.0 * misfit,
        nis=5.5,
        dof=6,
        accepted=True,
        error_inflation=1.5,
        flags=np.array([1, 1, 9, 1], dtype=np.int8),
        reasons=np.array([0, 0, 1, 0], dtype=np.int32),
        dive=2,
        source=Source(1, "/adcp", 4711, TIME_NS + 4),
        decision="softened",
        gate_statistic=12.5,
        gate=20.5,
        signal_dof=3.25,
        prior_inflation=1.75,
    )


@pytest.fixture
def plan() -> Plan:
    return Plan(
        status="reached",
        start=Place(5.0, 62.0, 0.0),
        goal=Place(5.1, 62.05, 100.0),
        start_time_ns=TIME_NS + 9,
        heading_deg=45.0,
        glide_angle_deg=20.0,
        speed=0.3,
        velocity_through_water=np.array([0.2, 0.2, 0.1]),
        duration=3_600.0,
        closest_approach=12.5,
        track_time=np.array([0.0, 1_800.0, 3_600.0]),
        track=np.array([[0.0, 0.0, 0.0], [500.0, 600.0, 50.0], [1_000.0, 1_200.0, 100.0]]),
        message="ok",
        statistics={"starts": 3, "iterations": 17, "return_status": "Solve_Succeeded"},
    )


@pytest.fixture
def failed_plan(plan: Plan) -> Plan:
    empty = np.empty((0, 3))
    return replace(plan, status="failed", closest_approach=np.inf, duration=np.nan, track=empty, track_time=empty[:, 0], message="no path")


@pytest.fixture
def weights() -> np.ndarray:
    return np.linspace(-1.0, 1.0, 12)


@pytest.fixture
def run(flow: FlowEstimate, state: VehicleState, innovation: Innovation, plan: Plan, weights: np.ndarray) -> Run:
    """Return a function that writes a small run and returns its path."""

    def write(path: Path) -> Path:
        with ResultWriter(path) as writer:
            writer.start(flow.grid.projection, state.time_ns - 1, METADATA, CONFIG)
            writer.log(state.time_ns - 1, "info", "begin")
            for step in range(300):
                writer.fix(replace(state, time_ns=state.time_ns + step))
                writer.innovation(replace(innovation, time_ns=innovation.time_ns + step))
                writer.estimate(innovation.time_ns + step, weights, flow.levels)
            writer.grids(plan.start_time_ns, flow, DEPTHS)
            writer.plan(plan, flow.grid.projection)
            writer.finish(flow)
        return path

    return write


@pytest.fixture
def result(run: Run, tmp_path: Path) -> dict[str, list[tuple[int, Any]]]:
    return decoded(run(tmp_path / "out.mcap"))
