"""A mission of ten dives here, in rockit and in do-mpc: the same legs, or each peer's own way from the same flow.

The peers are LGPL and only of use here, so they are not installed with the tests: ``pip install '.[peers]'``. Rows of absent peers say so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np

from planners import Glider, MissionSettings
from planners.flow import field_function
from planners.mission.task import leg_depths, steps_needed
from planners.shooting.functions import MissionCase
from planners.shooting.layout import Layout
from planners.shooting.program import MissionGuess, _programs, mission_program, solve_mission
from planners.shooting.schedule import schedule_of
from planners.shooting.spline import _splines, spline_of
from planners.solver import HOUR, KM, OPTIONS
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
    """Return our times against each peer's, the same missions for all: medians of building and solving."""
    cases = [draw_case(flow, np.random.default_rng(seed)) for seed in range(count)]
    peers = {
        ("rockit, its own RK4 over the flow", "rockit", 4.0): by_rockit,
        ("do-mpc, the same map of a leg", "do_mpc", 1.2): by_do_mpc,
    }
    here = [
        (find_spec(module) is not None, name, asked, solve)
        for (name, module, asked), solve in peers.items()
    ]
    measured: dict[str, list[tuple[float, Solved]]] = {"ours": []} | {
        name: [] for there, name, _, _ in here if there
    }
    again = []
    for case in cases:
        measured["ours"].append(seconds(lambda: _anew(case), 1 if tiny else 3))  # noqa: B023
        again.append(seconds(measured["ours"][-1][1].again)[0])
        for there, name, _, solve in here:
            if there:
                measured[name].append(seconds(lambda: solve(case), 1 if tiny else 2))  # noqa: B023
    cold = [took for took, _ in measured["ours"]]
    more = {"cold_asked_s": 0.5, "warm_median_s": float(np.median(again)), "warm_asked_s": 0.1}
    return [
        _row(
            f"mission of {N} dives, {count} goals, {len(flow.nodes)} nodes, against {name}",
            cold,
            measured,
            name,
            asked,
            more,
        )
        for _, name, asked, _ in here
    ]


def _row(
    title: str,
    cold: list[float],
    measured: dict[str, list[tuple[float, Solved]]],
    name: str,
    asked: float,
    more: dict[str, float],
) -> Row:
    if name not in measured:
        return row(title, float(np.median(cold)), f"{name}: not installed", **more)
    pairs = [
        (ours, theirs)
        for (_, ours), (_, theirs) in zip(measured["ours"], measured[name], strict=True)
    ]
    late = max(abs(ours.hours / theirs.hours - 1.0) for ours, theirs in pairs)
    turned = max(
        float(np.abs(np.rad2deg(np.angle(np.exp(1j * np.deg2rad(a.headings - b.headings))))).max())
        for a, b in pairs
    )
    ratios = [peer / ours for ours, (peer, _) in zip(cold, measured[name], strict=True)]
    theirs = float(np.median(cold)) * float(np.median(ratios))
    return row(
        title,
        float(np.median(cold)),
        name,
        theirs,
        asked,
        {"late_share": late, "turned_degrees": turned},
        **more,
    )


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


def by_do_mpc(case: Case) -> Solved:
    """Return what do-mpc finds, given the same map of a leg as its discrete model."""
    import do_mpc

    model = do_mpc.model.Model("discrete", "MX")
    place, hours = model.set_variable("_x", "place", (2, 1)), model.set_variable("_x", "hours")
    heading, angle = (model.set_variable("_u", name) for name in ("heading", "angle"))
    places, duration = case.leg(place * KM, 0.0, heading, angle, case.depths, 0.0, case.latent)
    model.set_rhs("place", places[:, -1] / KM)
    model.set_rhs("hours", hours + duration / HOUR)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    first = np.append(case.start / KM, 0.0)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = N, 1.0, True
    mpc.settings.nlpsol_opts = {"print_time": False, "ipopt": _IPOPT}
    mpc.set_objective(mterm=mpc.model.x["hours"], lterm=ca.DM(0))
    mpc.set_rterm(heading=0, angle=0)
    for side, angle in zip(("lower", "upper"), _VEHICLE.angles, strict=True):
        mpc.bounds[side, "_u", "angle"] = angle
        mpc.terminal_bounds[side, "place"] = case.goal / KM
    mpc.setup()

    def solve() -> None:
        mpc.x0, mpc.u0 = first, np.array([case.heading, _FIRST])
        mpc.set_initial_guess()
        way = np.vstack([case.start, case.places]) / KM
        for k in range(N + 1):
            mpc.opt_x_num["_x", k, 0, -1] = np.append(way[k], k * case.first_hours)
        mpc.make_step(first)

    solve()
    headings = np.rad2deg([float(mpc.opt_x_num["_u", k, 0][0]) for k in range(N)])
    return Solved(float(mpc.opt_x_num["_x", N, 0, -1][2]), headings, solve)


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
