"""A mission of ten dives here and in rockit, which goes its own way in the same flow.

The peer is LGPL and of use here alone, so the tests do not install it: ``pip install '.[peers]'``. Where it is absent the row says so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from planners.flow import field_function
from planners.shooting.functions import MissionCase
from planners.shooting.layout import Layout
from planners.shooting.program import MissionGuess, _programs, mission_program, solve_mission
from planners.shooting.schedule import schedule_of
from planners.shooting.spline import _splines, spline_of

from planners import Glider, MissionSettings
from planners.solver import HOUR, KM, OPTIONS
from planners.task import leg_depths, steps_needed
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from tests.benchmarks.measure import Row, row, seconds
from tests.reference.leg import leg_function, stage_latent

N = 10
_FIRST = float(np.deg2rad(20.0))
_VEHICLE = Glider()
_IPOPT = {
    name.removeprefix("ipopt."): value
    for name, value in OPTIONS.items()
    if name.startswith("ipopt.")
}


@dataclass(frozen=True, eq=False)
class Case:
    """One mission: where from, where to, how deep, in what."""

    flow: FlowEstimate
    start: Array
    goal: Array
    deepest: float
    depths: Array
    latent: Array

    @property
    def places(self) -> Array:
        """Straight from start to goal."""
        return self.start + np.outer(np.arange(1, N + 1) / N, self.goal - self.start)

    @property
    def heading(self) -> float:
        """Of the straight way [rad]."""
        return float(np.arctan2(*(self.goal - self.start)))

    @property
    def leg(self) -> ca.Function:
        """The map of one leg, as our program takes it."""
        return leg_function(self.flow, _VEHICLE, self.depths.size - 1, None, False)

    @property
    def first_hours(self) -> float:
        """A leg's at the first angle."""
        return 2.0 * self.deepest / float(_VEHICLE.speeds(np, _FIRST)[1]) / HOUR


@dataclass(frozen=True)
class Solved:
    """What a solver found: total time [h], headings [degrees], and a call that solves once more from there."""

    hours: float
    headings: Array
    again: Callable[[], Any]


def rows(flow: FlowEstimate, count: int, tiny: bool) -> list[Row]:
    """Return our times beside the peer's, the same missions for both: medians of building and solving."""
    cases = [draw_case(flow, np.random.default_rng(seed)) for seed in range(count)]
    ours = [seconds(lambda: _anew(case), 1 if tiny else 3) for case in cases]  # noqa: B023
    cold = np.array([took for took, _ in ours])
    title, name = f"mission of {N} dives, {count} goals, {len(flow.nodes)} nodes", "rockit"
    more = {
        "cold_asked_s": 0.5,
        "warm_median_s": float(np.median([seconds(one.again)[0] for _, one in ours])),
        "warm_asked_s": 0.1,
    }
    if find_spec(name) is None:
        return [row(title, float(np.median(cold)), f"{name}: not installed", **more)]
    theirs = [seconds(lambda: by_rockit(case), 1 if tiny else 2) for case in cases]  # noqa: B023
    pairs = [(one, other) for (_, one), (_, other) in zip(ours, theirs, strict=True)]
    late = max(abs(one.hours / other.hours - 1.0) for one, other in pairs)
    turned = max(
        float(np.abs((a.headings - b.headings + 180.0) % 360.0 - 180.0).max()) for a, b in pairs
    )
    ratio = float(np.median(np.array([took for took, _ in theirs]) / cold))
    took = float(np.median(cold))
    error = {"late_share": late, "turned_degrees": turned}
    return [
        row(title, took, f"{name}, its own RK4 over the flow", took * ratio, 4.0, error, **more)
    ]


def draw_case(flow: FlowEstimate, rng: np.random.Generator) -> Case:
    """Return a mission whose goal ten dives of random headings and angles reach."""
    deepest = min(500.0, 0.95 * float(flow.levels[-1]))
    yo_depths = (0.0, deepest, 0.0)
    depths = leg_depths(yo_depths, flow.levels, steps_needed(yo_depths, flow.levels, 1))
    latent = stage_latent(flow.latent, flow.levels, flow.depth_functions, depths)
    leg = leg_function(flow, _VEHICLE, depths.size - 1, None, False)
    half = 0.5 * np.array([flow.grid.east.max(), flow.grid.north.max()])
    while True:
        start = rng.uniform(-half, half)
        headings = rng.uniform(0.0, 2.0 * np.pi) + rng.normal(0.0, 0.3, N)
        at = start
        for heading, angle in zip(headings, np.deg2rad(rng.uniform(16.0, 25.0, N)), strict=True):
            at = np.asarray(leg(at, 0.0, heading, angle, depths, 0.0, latent)[0])[:, -1]
        if np.all(np.abs(at) < 2.0 * half):
            return Case(flow, start, at, deepest, depths, latent)


def _anew(case: Case) -> Solved:
    _programs.clear()
    _splines.clear()
    return solve_here(case)


def solve_here(case: Case) -> Solved:
    """Return what our program finds, its graph built first where it is not yet."""
    flow, drifts = case.flow, np.zeros(N)
    schedule = schedule_of(
        [case.depths] * N, drifts, False, flow.levels, flow.depth_functions, None
    )
    layout = Layout(N, ((N - 1, 0),), case.depths.size - 1, 0, False, False)
    corners = flow.nodes.min(axis=0), flow.nodes.max(axis=0)

    def solve(guess: MissionGuess, warm_start: bool) -> Any:
        numbers = MissionCase(
            spline_of(flow, flow.latent, MissionSettings().spline, *corners),
            schedule,
            drifts,
            case.start,
            0.0,
            case.goal[None],
            None,
            time_weight=1.0,
            miss_weights=(0.0, 0.0, 50.0),
            plane_cost=200.0,
            reference=None,
        )
        program = mission_program(flow.grid.projection, _VEHICLE, layout)
        return solve_mission(program, _VEHICLE, numbers, guess, warm_start=warm_start)

    answer = solve(MissionGuess(case.places, np.full(N, case.heading), np.full(N, _FIRST)), False)
    return Solved(
        answer.objective, np.rad2deg(answer.guess.headings), lambda: solve(answer.guess, True)
    )


def by_rockit(case: Case) -> Solved:
    """Return what rockit finds by its multiple shooting with RK4, as many flow evaluations as ours, given the flow with its derivatives."""
    import rockit

    ocp = rockit.Ocp(t0=0, T=float(N))
    place, hours, heading, angle = ocp.state(2), ocp.state(), ocp.control(), ocp.control()
    rate = _rate(
        case, place, case.deepest * (1 - ca.fabs(1 - 2 * ca.fmod(ocp.t, 1.0))), heading, angle
    )
    ocp.set_der(place, rate[:2])
    ocp.set_der(hours, rate[2])
    ocp.subject_to(ocp.at_t0(place) == case.start / KM)
    ocp.subject_to(ocp.at_t0(hours) == 0)
    ocp.subject_to(ocp.at_tf(place) == case.goal / KM)
    ocp.subject_to(_VEHICLE.angles[0] <= (angle <= _VEHICLE.angles[1]), include_last=False)
    ocp.add_objective(ocp.at_tf(hours))
    ocp.set_initial(heading, case.heading)
    ocp.set_initial(angle, _FIRST)
    ocp.set_initial(place, np.vstack([case.start, case.places]).T / KM)
    ocp.set_initial(hours, np.arange(N + 1) * case.first_hours)
    ocp.solver("ipopt", {"print_time": False, "ipopt": _IPOPT})
    ocp.method(rockit.MultipleShooting(N=N, M=(case.depths.size - 1) // 2, intg="rk"))
    found = ocp.solve()
    headings = np.rad2deg(np.asarray(found.sample(heading, grid="control")[1])[:N])
    return Solved(float(found.sample(hours, grid="control")[1][-1]), headings, ocp.solve)


def _rate(case: Case, place: Any, depth: Any, heading: Any, angle: Any) -> Any:
    """Return what changes in a leg of unit length: place [km], time [h]."""
    flow = case.flow
    field = field_function(flow)
    along, down = _VEHICLE.speeds(ca, angle)
    lasts = 2.0 * case.deepest / down
    ground = along * ca.vertcat(ca.sin(heading), ca.cos(heading)) + field(
        ca.vertcat(place * KM, depth), flow.latent
    )
    return ca.vertcat(lasts / KM * ground, lasts / HOUR)
