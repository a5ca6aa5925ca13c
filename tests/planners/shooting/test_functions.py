"""The functions of a mission's program and their derivatives, against the graph that CasADi differentiates."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planners import Glider, SteadyFlight
from planners.flow import latent_over_time
from planners.mission.leg import leg_depths
from planners.mission.program import MissionData, MissionModel, MissionShape, _case
from planners.mission.reference_path import along_line
from planners.solver import HOUR, KM
from tests.planners.flow_samples import LEVELS, eddying_flow
from tests.reference.mission_program import parameters_of, program_graph

DIVES = ((0.0, 60.0, 0.0), (0.0, 100.0, 0.0))
GOAL_STEP = 2


def _mission(changing: bool, planes: int, guided: bool) -> tuple[MissionModel, MissionData]:
    """Return three legs of two depths past a goal on the way, in a flow of random eddies."""
    rng, flow, n_legs, n_steps = np.random.default_rng(5), eddying_flow(1, "gaussian" if changing else "hat"), 3, 6
    times, latent = None, flow.latent
    if changing:
        dated = [replace(eddying_flow(1 + k, "gaussian"), time_ns=10**15 + int(k * 2e12)) for k in range(3)]
        times, latent = latent_over_time(dated)
    shape = MissionShape(n_legs, n_steps, (2, 3), (0, 1, 0), planes, True, (GOAL_STEP, 0), guided)
    vehicle = Glider(flight=SteadyFlight()) if guided else Glider()
    places = (n_legs, shape.n_places)
    data = MissionData(
        np.array([2e3, -1e3]),
        900.0,
        rng.uniform(-3e3, 3e3, (2, 2)),
        tuple(leg_depths(dive, np.array(LEVELS), n_steps) for dive in DIVES),
        np.array([600.0, 300.0, 0.0]),
        np.concatenate([rng.standard_normal((*places, planes, 2)), rng.uniform(-2e3, 2e3, (*places, planes, 1))], axis=-1),
        0.7,
        0.3,
        40.0,
        latent,
        0.2,
    )
    if guided:
        line = along_line(np.zeros(2), np.array([2e3, 3e3]), 2.0, 900.0)
        weights, limits = rng.uniform(0.1, 1.0, places), rng.uniform(500.0, 2e3, places)
        data = replace(data, reference_path=line, reference_weights=weights, reference_limits=limits)
    return MissionModel(flow, vehicle, shape, times), data


@pytest.mark.parametrize(("changing", "planes", "guided"), [(False, 2, False), (True, 0, True), (True, 1, False)])
def test_the_functions_and_their_derivatives_are_those_of_the_graph(changing: bool, planes: int, guided: bool) -> None:
    model, data = _mission(changing, planes, guided)
    graph, numbers, rng = program_graph(model), parameters_of(model, data), np.random.default_rng(6)
    program = model.program
    functions, layout = program.functions, program.functions.layout
    functions.give(_case(model, data))
    legs = np.column_stack(
        [rng.uniform(-3.0, 3.0, (3, 2)), 900.0 / HOUR + np.arange(1.0, 4.0), rng.uniform(-3, 3, 3), rng.uniform(0.3, 0.6, 3)]
    )
    x = np.concatenate([legs.ravel(), rng.uniform(0.1, 1.0, layout.n_unknowns - 15)])
    multipliers = rng.standard_normal(layout.n_equal + layout.n_limited)
    lagrangian = 0.8 * graph["f"] + ca.dot(multipliers, graph["g"])
    wanted = [graph["f"], graph["g"], ca.gradient(graph["f"], graph["x"]), ca.jacobian(graph["g"], graph["x"])]
    evaluate = ca.Function("all", [graph["x"], graph["p"]], [*wanted, ca.hessian(lagrangian, graph["x"])[0]])
    cost, constraints, gradient, jacobian, hessian = (one.full() for one in evaluate(x, numbers))
    found_cost, found = functions.value(x)
    assert found_cost == pytest.approx(float(cost[0, 0]), rel=1e-11)
    np.testing.assert_allclose(found, constraints.ravel(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(functions.gradient(x), gradient.ravel(), rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(_dense(functions.jacobian.sparsity, functions.jacobian_entries(x)), jacobian, rtol=1e-7, atol=1e-9)
    upper = _dense(functions.hessian.sparsity, functions.hessian_entries(x, 0.8, multipliers))
    np.testing.assert_allclose(upper, np.triu(hessian), rtol=1e-6, atol=1e-7 * np.abs(hessian).max())
    # what is found at other unknowns does not stay
    assert functions.value(x + 1e-3)[0] != found_cost
    assert functions.value(x)[0] == found_cost
    assert np.abs(found[: layout.n_equal]).max() * KM > 1.0


def _dense(sparsity: ca.Sparsity, entries: np.ndarray) -> np.ndarray:
    return np.asarray(ca.DM(sparsity, entries.tolist()).full())
