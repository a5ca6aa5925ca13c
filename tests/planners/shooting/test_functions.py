"""The functions of a mission's program and their derivatives, against the graph that CasADi differentiates."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planners import Glider, SteadyFlight
from planners.flow import latent_over_time
from planners.hazards.areas import NearRings, Ring
from planners.mission.task import leg_depths
from planners.shooting.functions import MissionCase, Reference
from planners.shooting.layout import Layout
from planners.shooting.program import along_line, mission_program
from planners.shooting.schedule import schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from tests.planners.flow_samples import LEVELS, eddying_flow
from tests.reference.mission_program import Mission, parameters_of, program_graph

DIVES = ((0.0, 60.0, 0.0), (0.0, 100.0, 0.0))
GOAL_STEP = 2


def _mission(changing, planes, guided):
    """Return three legs of two depths past a goal on the way, in a flow of random eddies, and its numbers."""
    rng = np.random.default_rng(5)
    flow = eddying_flow(1, "gaussian" if changing else "hat")
    n_legs = 3
    n_steps = 6
    times, latent = None, flow.latent
    if changing:
        dated = [
            replace(eddying_flow(1 + k, "gaussian"), time_ns=10**15 + int(k * 2e12))
            for k in range(3)
        ]
        times, latent = latent_over_time(dated)
    layout = Layout(n_legs, ((1, GOAL_STEP), (2, 0)), n_steps + 1, planes, guided, changing)
    places = (n_legs, layout.n_places)
    half_planes = np.concatenate(
        [rng.standard_normal((*places, planes, 2)), rng.uniform(-2e3, 2e3, (*places, planes, 1))],
        axis=-1,
    )
    goals = rng.uniform(-3e3, 3e3, (2, 2))
    depths = [leg_depths(DIVES[k], np.array(LEVELS), n_steps) for k in (0, 1, 0)]
    drifts, reference = np.array([600.0, 300.0, 0.0]), None
    if guided:
        line = along_line(np.zeros(2), np.array([2e3, 3e3]), 2.0, 900.0)
        weights, limits = rng.uniform(0.1, 1.0, places), rng.uniform(500.0, 2e3, places)
        reference = Reference(line.origin / KM, line.across, weights, limits / KM, 8.0, 0.0)
    case = MissionCase(
        stream_of(flow, latent),
        schedule_of(depths, drifts, True, flow.levels, flow.depth_functions, times),
        drifts,
        np.array([2e3, -1e3]),
        900.0,
        goals,
        Walls(np.ones(half_planes.shape[:3]), half_planes) if planes else None,
        0.7,
        (0.3, 0.2, 1e-6),
        160.0,
        reference,
    )
    vehicle = Glider(flight=SteadyFlight()) if guided else Glider()
    return Mission(flow, vehicle, layout, depths, latent, times), case


def _functions(mission, case):
    program = mission_program(mission.flow.grid.projection, mission.vehicle, mission.layout)
    program.functions.give(case)
    return program.functions


@pytest.mark.parametrize(
    ("changing", "planes", "guided"), [(False, 2, False), (True, 0, True), (True, 1, False)]
)
def test_the_functions_and_their_derivatives_are_those_of_the_graph(changing, planes, guided):
    mission, case = _mission(changing, planes, guided)
    graph, numbers = program_graph(mission), parameters_of(mission, case)
    functions, layout, rng = _functions(mission, case), mission.layout, np.random.default_rng(6)
    legs = np.column_stack(
        [
            rng.uniform(-3.0, 3.0, (3, 2)),
            900.0 / HOUR + np.arange(1.0, 4.0),
            rng.uniform(-3, 3, 3),
            rng.uniform(0.3, 0.6, 3),
        ]
    )
    x = np.concatenate([legs.ravel(), rng.uniform(0.1, 1.0, layout.n_unknowns - 15)])
    multipliers = rng.standard_normal(layout.n_equal + layout.n_limited)
    lagrangian = 0.8 * graph["f"] + ca.dot(multipliers, graph["g"])
    wanted = [
        graph["f"],
        graph["g"],
        ca.gradient(graph["f"], graph["x"]),
        ca.jacobian(graph["g"], graph["x"]),
    ]
    evaluate = ca.Function(
        "all", [graph["x"], graph["p"]], [*wanted, ca.hessian(lagrangian, graph["x"])[0]]
    )
    cost, constraints, gradient, jacobian, hessian = (one.full() for one in evaluate(x, numbers))
    found_cost, found = functions.value(x)
    assert found_cost == pytest.approx(float(cost[0, 0]), rel=1e-11)
    np.testing.assert_allclose(found, constraints.ravel(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(functions.gradient(x), gradient.ravel(), rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(
        _dense(functions.jacobian.sparsity, functions.jacobian_entries(x)),
        jacobian,
        rtol=1e-7,
        atol=1e-9,
    )
    upper = _dense(functions.hessian.sparsity, functions.hessian_entries(x, 0.8, multipliers))
    np.testing.assert_allclose(
        upper, np.triu(hessian), rtol=1e-6, atol=1e-7 * np.abs(hessian).max()
    )
    # what is found at other unknowns does not stay
    assert functions.value(x + 1e-3)[0] != found_cost
    assert functions.value(x)[0] == found_cost
    assert np.abs(found[: layout.n_equal]).max() * KM > 1.0


def test_half_planes_that_follow_the_places_have_the_derivatives_of_their_distances():
    mission, case = _mission(True, 3, False)
    square = np.array([[0.0, 0.0], [900.0, 0.0], [900.0, 900.0], [0.0, 900.0]])
    rings = (
        Ring(square, False, "square"),
        Ring(square + np.array([-2e3, 500.0]), False, "another"),
        Ring(20.0 * square - 9e3, True, "edge"),
    )
    rng, size = np.random.default_rng(8), (3, mission.layout.n_places, 3)
    # at the end of a step, or on the way there; one of the places has no ring
    near = NearRings(rings, rng.integers(0, 3, size).ravel(), 50.0)
    near.which[4] = -1
    walls = Walls(np.where(np.arange(3) < 2, 1.0, rng.uniform(0.1, 0.9, size)), obstacles=near)
    functions = _functions(mission, replace(case, walls=walls))
    at = np.vstack([case.start / KM, rng.uniform(-3.0, 3.0, (2, 2))])
    legs = np.column_stack(
        [
            np.roll(at, -1, axis=0),
            0.25 + np.arange(1.0, 4.0),
            rng.uniform(-3, 3, 3),
            rng.uniform(0.3, 0.6, 3),
        ]
    )
    x = np.concatenate([legs.ravel(), rng.uniform(0.1, 1.0, functions.layout.n_unknowns - 15)])
    found = functions.value(x)[1]
    first = 9 + 2 * len(case.goals)
    places = functions.places(x)
    begins = np.concatenate(
        [np.vstack([case.start, legs[:-1, :2] * KM])[:, None], places[:, :-1]], axis=1
    )
    for number, beyond in enumerate(found[first:]):
        leg, place_, plane = np.unravel_index(number, size)
        point = begins[leg, place_] + walls.shares[leg, place_, plane] * (
            places[leg, place_] - begins[leg, place_]
        )
        which = near.which[number]
        expected = -1e6 if which < 0 else (50.0 - rings[which].clearance(point[None])[0]) / KM
        assert beyond + x[-1] == pytest.approx(expected, abs=1e-9)
    multipliers = rng.standard_normal(found.size)
    multipliers[first + 4] = 0.0

    def slope(x):
        entries = _dense(functions.jacobian.sparsity, functions.jacobian_entries(x))
        return np.asarray(0.8 * functions.gradient(x) + multipliers @ entries)

    steps = 1e-6 * np.eye(x.size)
    rows = np.column_stack(
        [(functions.value(x + step)[1] - functions.value(x - step)[1]) / 2e-6 for step in steps]
    )
    # what has no ring is a thousand kilometres inside, too far for differences
    kept = np.arange(found.size) != first + 4
    np.testing.assert_allclose(
        _dense(functions.jacobian.sparsity, functions.jacobian_entries(x))[kept],
        rows[kept],
        atol=1e-6,
    )
    upper = _dense(functions.hessian.sparsity, functions.hessian_entries(x, 0.8, multipliers))
    bends = np.column_stack([(slope(x + step) - slope(x - step)) / 2e-6 for step in steps])
    np.testing.assert_allclose(upper, np.triu(bends), rtol=1e-5, atol=1e-5 * np.abs(bends).max())


def _dense(sparsity, entries):
    return np.asarray(ca.DM(sparsity, entries.tolist()).full())
