"""The B-spline of a flow: its error and order, its derivatives, missions planned in it."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, plan_mission
from planners.spline import spline_of
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import eddying_flow, place, random_points, uniform_flow


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_its_error_is_as_stated_and_falls_with_the_fourth_power(kind: str):
    flow = eddying_flow(3, kind=kind)  # type: ignore[arg-type]
    points = random_points(flow, 400, 9)
    exact, errors = flow.velocity(*points.T), []
    for count in (2, 3):
        spline = spline_of(flow, count)
        error = np.linalg.norm(np.asarray(spline.function.map(len(points))(points.T)).T - exact, axis=1)
        # above and below the levels it is as good as between them
        assert error.max() < 1.5 * spline.largest_error
        assert np.sqrt(np.mean(error**2)) == pytest.approx(spline.rms_error, rel=0.3)
        errors.append(spline.rms_error)
    assert 3.5 < np.log(errors[0] / errors[1]) / np.log(3 / 2) < 5.5


def test_its_derivatives_are_those_of_differences_and_vanish_outside():
    flow, at = eddying_flow(3), np.array([3e3, -7e3, 170.0])
    function, place_ = spline_of(flow).function, ca.MX.sym("place", 3)
    first = ca.Function("first", [place_], [ca.jacobian(function(place_), place_)])
    for axis, step in enumerate((1.0, 1.0, 0.1)):
        way = step * np.eye(3)[axis]
        difference = (np.asarray(function(at + way)) - np.asarray(function(at - way))).ravel() / 2.0 / step
        np.testing.assert_allclose(np.asarray(first(at))[:, axis], difference, rtol=1e-5, atol=1e-10)
    assert np.all(np.asarray(first([1e6, 0.0, 170.0]))[:, 0] == 0.0)


def test_a_mission_planned_in_it_is_the_mission_planned_in_the_flow():
    flow = eddying_flow(6)
    request = MissionRequest(place(flow, -6e3, -6e3, 0.0), (place(flow, 2e3, 2e3, 0.0),))
    settings = MissionSettings(depth=300.0, surface_time=600.0, legs=8)
    exact, splined = (plan_mission(flow, replace(request, settings=replace(settings, spline=points))) for points in (0, 3))
    assert splined.status == "reached"
    # an error of the current carries so far, and to make up for it takes so long at the horizontal speed that there is at least
    carried = splined.statistics["spline_error"] * exact.duration
    assert splined.duration == pytest.approx(exact.duration, abs=carried / (0.3 * np.cos(np.deg2rad(35.0))))
    assert splined.closest_approach[0] < exact.closest_approach[0] + carried
    assert 0.0 < splined.statistics["spline_rms_error"] < splined.statistics["spline_error"] < 1e-3
    changing = (replace(uniform_flow(0.0, 0.0), time_ns=0), replace(uniform_flow(0.1, 0.0), time_ns=10**14))
    with pytest.raises(PlanError, match="one estimate"):
        plan_mission(changing, replace(request, settings=replace(settings, spline=3)))
