"""The values of a small run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Source, VehicleState
from replay_kit.core.plan import Place, Plan
from replay_kit.results import ResultWriter
from tests.results.cases import failed
from tests.results.result_samples import CONFIG, DEPTHS, METADATA, Run, decoded
from tests.synthetic_flow import TIME_NS

PLAN = Plan(
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
def state() -> VehicleState:
    return VehicleState(TIME_NS, 5.01, 62.02, 12.5, True, Source(0, "/gps", 77, TIME_NS))


# as results hold values of bins
_MISFIT, _STD = np.random.default_rng(3).normal(size=(2, 4, 2)).astype(np.float32).astype(float)
_MISFIT[2] = np.nan
INNOVATION = Innovation(
    time_ns=TIME_NS + 5,
    depth=np.array([10.0, 20.0, 30.0, 40.0]),
    innovation=_MISFIT,
    innovation_std=np.abs(_STD),
    residual=(0.1 * _MISFIT).astype(np.float32).astype(float),
    prior_innovation=2.0 * _MISFIT,
    nis=5.5,
    dof=6,
    accepted=True,
    error_inflation=1.5,
    flags=np.array([1, 1, 9, 1], dtype=np.int8),
    reasons=np.array([0, 0, 1, 0], dtype=np.int32),
    dive=2,
    source=Source(1, "/adcp", 4711, TIME_NS + 4),
    decision="accepted",
    gate_statistic=12.5,
    gate=20.5,
    signal_dof=3.25,
)


@pytest.fixture
def innovation() -> Innovation:
    return INNOVATION


@pytest.fixture
def plan() -> Plan:
    return PLAN


@pytest.fixture
def failed_plan(plan: Plan) -> Plan:
    return replace(failed(plan), closest_approach=np.inf, duration=np.nan)


@pytest.fixture
def run(flow: FlowEstimate, state: VehicleState, innovation: Innovation, plan: Plan) -> Run:
    """Return a function that writes a small run and returns its path."""

    def write(path: Path) -> Path:
        with ResultWriter(path) as writer:
            writer.start(flow.grid.projection, state.time_ns - 1, METADATA, CONFIG)
            writer.log(state.time_ns - 1, "info", "begin")
            for step in range(300):
                writer.fix(replace(state, time_ns=state.time_ns + step))
                writer.innovations([replace(innovation, time_ns=innovation.time_ns + step)])
            writer.grids(plan.start_time_ns, flow, DEPTHS)
            writer.plan(plan, flow.grid.projection)
            writer.finish(flow)
        return path

    return write


@pytest.fixture
def result(run: Run, tmp_path: Path) -> dict[str, list[tuple[int, Any]]]:
    return decoded(run(tmp_path / "out.mcap"))
