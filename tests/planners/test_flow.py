"""The CasADi flow: the NumPy field, its exact derivatives, its divergence."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planners.flow import field_function, latent_over_time
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.functions import HorizontalKernel, velocity_kernel
from tests.planners.flow_samples import eddying_flow, random_points

CASES = [
    ("hat", (5.0, 40.0, 110.0, 230.0, 400.0)),
    ("gaussian", (5.0, 40.0, 110.0, 230.0, 400.0)),
    ("hat", (50.0,)),
    ("gaussian", (50.0,)),
]


@pytest.mark.parametrize(("kind", "levels"), CASES)
def test_equals_the_numpy_field(kind, levels):
    flow = eddying_flow(3, kind, levels=levels)
    points = np.vstack([random_points(flow, 200, 1), [[0.0, 0.0, level] for level in levels]])
    expected = flow.velocity(*points.T)
    function = field_function(flow)
    actual = np.array([function(point, flow.latent).full().ravel() for point in points])
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_divergence_is_zero_and_derivatives_are_those_of_the_field(kind):
    flow = eddying_flow(4, kind)
    position, latent = ca.MX.sym("position", 3), ca.MX.sym("latent", *flow.latent.shape)
    velocity = field_function(flow)(position, latent)
    jacobian = ca.Function("jacobian", [position, latent], [ca.jacobian(velocity, position)])
    for point in random_points(flow, 30, 2):
        exact = np.asarray(jacobian(point, flow.latent))
        assert abs(exact[0, 0] + exact[1, 1]) <= 1e-13 * np.abs(exact[:, :2]).max()
        if (
            np.min(np.abs(flow.levels - point[2])) > 1.0
        ):  # hats have no derivative in depth at a level
            shifts = np.diag([1.0, 1.0, 0.05])
            slopes = [
                (flow.velocity(*(point + d)) - flow.velocity(*(point - d))) / (2 * d.max())
                for d in shifts
            ]
            np.testing.assert_allclose(
                exact, np.transpose(slopes), rtol=1e-5, atol=1e-8 * np.abs(exact).max()
            )


def test_a_new_latent_needs_no_new_function():
    first, second = eddying_flow(5), eddying_flow(6)
    found = field_function(first)([1e3, -2e3, 70.0], second.latent)
    np.testing.assert_allclose(found.full().ravel(), second.velocity(1e3, -2e3, 70.0), rtol=1e-12)


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_second_derivatives_are_those_of_the_jacobian(kind):
    flow = eddying_flow(8, kind)
    position = ca.MX.sym("position", 3)
    latent = ca.MX.sym("latent", *flow.latent.shape)
    weights = ca.MX.sym("weights", 2)
    velocity = field_function(flow)(position, latent)
    gradient = ca.gradient(ca.dot(weights, velocity), position)
    functions = [
        ca.Function("f", [position, weights, latent], [e])
        for e in (gradient, ca.jacobian(gradient, position))
    ]
    for point in [
        *random_points(flow, 20, 3),
        np.array([1e3, 2e3, -3.0]),
        np.array([1e3, 2e3, flow.levels[-1] + 9.0]),
    ]:
        if np.min(np.abs(flow.levels - point[2])) > 1.0:
            slope, bend = (np.asarray(f(point, [0.7, -1.3], flow.latent)) for f in functions[:2])
            steps = np.diag([10.0, 10.0, 0.05])
            moved = [
                [
                    np.asarray(functions[0](point + sign * step, [0.7, -1.3], flow.latent))
                    for sign in (1, -1)
                ]
                for step in steps
            ]
            slopes = np.hstack(
                [
                    (ahead - behind) / (2 * step.max())
                    for (ahead, behind), step in zip(moved, steps, strict=True)
                ]
            )
            np.testing.assert_allclose(
                bend, slopes, rtol=1e-4, atol=1e-5 * np.abs(slope).max() / 12e3 + 1e-15
            )
            np.testing.assert_array_equal(bend, bend.T)


def test_beyond_the_box_the_nearest_level_holds_and_far_away_nothing_flows():
    flow = eddying_flow(9)
    function = field_function(flow)
    position, latent = ca.MX.sym("position", 3), ca.MX.sym("latent", *flow.latent.shape)
    slope = ca.Function(
        "slope", [position, latent], [ca.jacobian(function(position, latent), position)]
    )
    for depth, level in ((-50.0, flow.levels[0]), (flow.levels[-1] + 500.0, flow.levels[-1])):
        np.testing.assert_array_equal(
            *(function([1e3, -4e3, at], flow.latent).full() for at in (depth, level))
        )
        assert np.all(np.asarray(slope([1e3, -4e3, depth], flow.latent))[:, 2] == 0.0)
    assert np.all(np.asarray(slope([1e7, 0.0, 60.0], flow.latent)) == 0.0)
    assert function([1e7, 0.0, 60.0], flow.latent).full().ravel().tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("kind", "levels"), CASES)
def test_a_flow_that_changes_is_linear_between_its_times(kind, levels):
    flows = [
        replace(eddying_flow(seed, kind, levels=levels), time_ns=int(hours * 3.6e12))
        for seed, hours in ((1, 5), (2, 6), (3, 8))
    ]
    times, latent = latent_over_time(flows)
    np.testing.assert_array_equal(times, [0.0, 3600.0, 10800.0])
    function = field_function(flows[0], times)
    point = np.array([2e3, -3e3, 47.0])
    for time, weights in (
        (-9.0, (1, 0, 0)),
        (900.0, (0.75, 0.25, 0)),
        (3600.0, (0, 1, 0)),
        (9000.0, (0, 0.25, 0.75)),
        (2e4, (0, 0, 1)),
    ):
        expected = sum(
            weight * flow.velocity(*point) for weight, flow in zip(weights, flows, strict=True)
        )
        np.testing.assert_allclose(
            function([*point, time], latent).full().ravel(), expected, rtol=1e-12
        )
    time, rest = ca.MX.sym("time"), ca.MX.sym("latent", *latent.shape)
    rate = ca.Function(
        "rate", [time, rest], [ca.jacobian(function(ca.vertcat(point, time), rest), time)]
    )
    expected = (flows[2].velocity(*point) - flows[1].velocity(*point)) / 7200.0
    np.testing.assert_allclose(np.asarray(rate(5000.0, latent)).ravel(), expected, rtol=1e-9)


def test_a_sequence_of_flows_that_cannot_be_one_is_refused():
    flow = replace(eddying_flow(1), time_ns=10)
    for flows, words in (
        ([flow], "two times or more"),
        ([flow, flow], "increasing"),
        ([flow, replace(flow, time_ns=None)], "increasing"),
        (
            [
                flow,
                replace(
                    flow,
                    time_ns=20,
                    horizontal=replace(flow.horizontal, kernel=HorizontalKernel(1e4, 1e4, 0.3)),
                ),
            ],
            "nodes",
        ),
    ):
        with pytest.raises(PlanError, match=words):
            latent_over_time(flows)


def test_the_hermite_sums_are_the_kernel():
    # The field of one node with one latent velocity is a column of the kernel.
    flow = eddying_flow(10, levels=(50.0,))
    latent = np.zeros_like(flow.latent)
    latent[[3, len(flow.nodes) + 7]] = 2.0
    matrix = velocity_kernel(flow.horizontal.kernel, np.array([[5e3, -7e3]]), flow.nodes)
    np.testing.assert_allclose(
        field_function(flow)([5e3, -7e3, 50.0], latent).full().ravel(),
        matrix @ latent[:, 0],
        rtol=1e-12,
    )
