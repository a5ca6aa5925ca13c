"""The B-spline of a flow's stream function: its error and order, its derivatives, missions planned in it."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, plan_mission
from planners.shooting.program import solve_mission
from planners.shooting.spline import FlowSpline, spline_of
from planners.shooting.stream import stream_of
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.flow.lattice import lattice_over
from tests.planners.flow_samples import eddying_flow, request_between

BOX = np.array([-3e4, -2.5e4]), np.array([2e4, 2.8e4])


def _on_lattice(flow, seed):
    """Return a flow of random coefficients on a lattice."""
    lattice = lattice_over(flow.horizontal.kernel, flow.nodes)
    latent = 300.0 * np.random.default_rng(seed).standard_normal((lattice.size, flow.levels.size))
    return replace(flow, horizontal=lattice, latent=latent, modes=np.empty((lattice.size, 0)))


def _flows():
    return [eddying_flow(3), _on_lattice(eddying_flow(3), 4)]


def _velocities(derivatives):
    return np.stack([derivatives[..., 0, 1], -derivatives[..., 1, 0]], axis=-1)


@pytest.mark.parametrize("flow", _flows(), ids=["nodes", "lattice"])
def test_stream_functions_have_the_velocity_of_their_flow_and_derivatives_as_differences_say(flow):
    stream, rng = stream_of(flow, flow.latent), np.random.default_rng(1)
    at = rng.uniform(*BOX, (6, 2))
    columns = rng.integers(0, 5, (6, 2))
    weights = rng.standard_normal((6, 1, 2))
    found = stream.derivatives(at, columns, weights)
    latent = np.stack(
        [flow.latent[:, pair] @ weight[0] for pair, weight in zip(columns, weights, strict=True)],
        axis=1,
    )
    expected = [
        flow.horizontal.velocity(at[k : k + 1], latent[:, k : k + 1])[:, 0, 0] for k in range(6)
    ]
    np.testing.assert_allclose(_velocities(found)[:, 0], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        stream.derivatives(at, columns, weights, 2), found[..., :2, :2], rtol=1e-12
    )
    for axis, step in ((0, np.array([10.0, 0.0])), (1, np.array([0.0, 10.0]))):
        difference = (
            stream.derivatives(at + step, columns, weights)
            - stream.derivatives(at - step, columns, weights)
        ) / 20.0
        below = np.moveaxis(difference, 2 + axis, 0)[:3], np.moveaxis(found, 2 + axis, 0)[1:]
        for order in range(3):
            np.testing.assert_allclose(
                below[0][order],
                below[1][order],
                rtol=1e-4,
                atol=2e-5 * np.abs(below[1][order]).max(),
            )


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_its_error_is_as_stated_and_falls_with_the_fifth_power(kind):
    flow = eddying_flow(3, kind=kind)
    rng, exact, errors = np.random.default_rng(9), stream_of(flow, flow.latent), []
    at = rng.uniform(*BOX, (400, 2))
    weights = depth_weights(flow.depth_functions, rng.uniform(-10.0, 500.0, 400), flow.levels)[
        :, None
    ]
    columns = np.tile(np.arange(flow.levels.size), (400, 1))
    for count in (3, 5):
        spline = spline_of(flow, flow.latent, count, *BOX)
        error = np.linalg.norm(
            _velocities(
                spline.derivatives(at, columns, weights) - exact.derivatives(at, columns, weights)
            ),
            axis=-1,
        )
        assert error.max() < 2.0 * spline.largest_error
        assert np.sqrt(np.mean(error**2)) == pytest.approx(spline.rms_error, rel=0.4)
        errors.append(spline.rms_error)
    assert 4.5 < np.log(errors[0] / errors[1]) / np.log(5 / 3) < 7.0


def test_its_derivatives_are_those_of_differences_and_its_current_vanishes_far_outside():
    flow = eddying_flow(3)
    spline = spline_of(flow, flow.latent, 4, *BOX)
    columns = np.array([[0, 2]])
    weights = np.array([[[0.4, 0.6]]])
    at = np.array([[3e3, -7e3]])
    found = spline.derivatives(at, columns, weights)[0, 0]
    for axis, step in ((0, np.array([1.0, 0.0])), (1, np.array([0.0, 1.0]))):
        ahead, back = (
            spline.derivatives(at + sign * step, columns, weights)[0, 0] for sign in (1.0, -1.0)
        )
        difference = np.moveaxis((ahead - back) / 2.0, axis, 0)[:3]
        np.testing.assert_allclose(
            difference, np.moveaxis(found, axis, 0)[1:], rtol=2e-3, atol=1e-13
        )
    assert np.all(spline.derivatives(np.array([[1e6, 0.0]]), columns, weights) == 0.0)
    assert not spline.covers(np.array([[1e6, 0.0]]))
    assert spline.covers(at)


@pytest.mark.parametrize("flow", _flows(), ids=["nodes", "lattice"])
def test_a_mission_planned_in_it_is_the_mission_planned_in_the_flow(flow):
    request = request_between(flow, (-6e3, -6e3), (2e3, 2e3))
    settings = MissionSettings(depth=300.0, surface_time=600.0, legs=8)
    exact, splined = (
        plan_mission(flow, replace(request, settings=replace(settings, spline=points)))
        for points in (0, 3)
    )
    assert splined.status == "reached"
    # an error of the current carries so far, and to make up for it takes so long at the horizontal speed that there is at least
    carried = splined.statistics["spline_error"] * exact.duration
    assert splined.duration == pytest.approx(
        exact.duration, abs=carried / (0.3 * np.cos(np.deg2rad(35.0)))
    )
    assert splined.closest_approach[0] < exact.closest_approach[0] + carried
    assert 0.0 < splined.statistics["spline_rms_error"] < splined.statistics["spline_error"] < 1e-3


def test_a_plan_that_a_coarse_spline_leads_astray_is_polished_in_the_flow_itself(monkeypatch):
    flow, solved_in = eddying_flow(6), list[bool]()

    def solve(program, vehicle, case, guess, **options):
        solved_in.append(isinstance(case.stream, FlowSpline))
        return solve_mission(program, vehicle, case, guess, **options)

    monkeypatch.setattr("planners.mission.solve.optimum.solve_mission", solve)
    request = request_between(flow, (-6e3, -6e3), (2e3, 2e3))
    exact, coarse = (
        plan_mission(
            flow, replace(request, settings=MissionSettings(depth=300.0, legs=8, spline=points))
        )
        for points in (0, 1)
    )
    assert coarse.statistics["spline_error"] * coarse.duration > 100.0
    assert solved_in == [False, True, False]
    assert coarse.duration == pytest.approx(exact.duration, rel=1e-6)


def test_a_flow_that_changes_is_planned_in_a_spline_too():
    flows = [replace(eddying_flow(6 + k), time_ns=10**15 + k * 10**14) for k in range(2)]
    request = request_between(flows[0], (-6e3, -6e3), (2e3, 2e3), start_time_ns=10**15 + 10**13)
    settings = MissionSettings(depth=300.0, legs=4)
    exact, splined = (
        plan_mission(flows, replace(request, settings=replace(settings, spline=points)))
        for points in (0, 4)
    )
    assert splined.duration == pytest.approx(exact.duration, rel=1e-6)
    assert splined.statistics["spline_error"] < 1e-4
