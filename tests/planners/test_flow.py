"""The CasADi flow: the NumPy field, its exact derivatives, its divergence."""

from typing import Literal

import casadi as ca
import numpy as np
import pytest

from planners.flow import flow_function_of
from tests.planners.flow_samples import eddying_flow, random_points

CASES = [("hat", (5.0, 40.0, 110.0, 230.0, 400.0)), ("gaussian", (5.0, 40.0, 110.0, 230.0, 400.0)), ("hat", (50.0,)), ("gaussian", (50.0,))]
Kind = Literal["hat", "gaussian"]


@pytest.mark.parametrize(("kind", "levels"), CASES)
def test_equals_the_numpy_field(kind: Kind, levels: tuple[float, ...]) -> None:
    flow = eddying_flow(3, kind, levels=levels)
    points = np.vstack([random_points(flow, 200, 1), [[0.0, 0.0, level] for level in levels]])
    expected = flow.velocity(*points.T)
    function = flow_function_of(flow)
    actual = np.array([[float(value) for value in function(*point, flow.latent)] for point in points])
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_divergence_is_zero_and_derivatives_are_those_of_the_field(kind: Kind) -> None:
    flow = eddying_flow(4, kind)
    position, latent = ca.MX.sym("position", 3), ca.MX.sym("latent", *flow.latent.shape)
    u, v = flow_function_of(flow)(position[0], position[1], position[2], latent)
    jacobian = ca.Function("jacobian", [position, latent], [ca.jacobian(ca.vertcat(u, v), position)])
    for point in random_points(flow, 30, 2):
        exact = np.asarray(jacobian(point, flow.latent))
        assert abs(exact[0, 0] + exact[1, 1]) <= 1e-13 * np.abs(exact[:, :2]).max()
        if np.min(np.abs(flow.levels - point[2])) > 1.0:  # hats have no derivative in depth at a level
            shifts = np.diag([1.0, 1.0, 0.05])
            slopes = [(flow.velocity(*(point + d)) - flow.velocity(*(point - d))) / (2 * d.max()) for d in shifts]
            np.testing.assert_allclose(exact, np.transpose(slopes), rtol=1e-5, atol=1e-8 * np.abs(exact).max())


def test_a_new_latent_needs_no_new_function() -> None:
    first, second = eddying_flow(5), eddying_flow(6)
    u, v = flow_function_of(first)(1e3, -2e3, 70.0, second.latent)
    np.testing.assert_allclose([float(u), float(v)], second.velocity(1e3, -2e3, 70.0), rtol=1e-12)
