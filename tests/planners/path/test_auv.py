"""Free paths against Zermelo's solutions, their depth, their energy, and what they may not cross."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from planners import Auv, AuvPlan, AuvSettings, PathRequest, plan_path
from planners.path.plan import _crossed
from planners.route.bottom import bottom_of
from planners.route.region import region_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from tests.planners.flow_samples import eddying_flow, fitted_flow, place, still_flow
from tests.planners.mission.test_mission import _area
from tests.planners.route.all_rings import all_rings
from tests.reference.zermelo import (
    most_frugal_speed,
    time_in_jet,
    time_in_solid_rotation,
    time_in_uniform_current,
)

BEGIN, END = np.array([-20e3, -12e3]), np.array([18e3, 14e3])
CURRENT, RATE = np.array([0.3, -0.4]), 1.2e-5


def _jet(north: Array | float) -> Array:
    return np.asarray(0.6 * np.cos(2.0 * np.pi * north / 6e4))


CASES = {
    "uniform": (
        lambda x, y: (0.0 * x + CURRENT[0], 0.0 * y + CURRENT[1]),
        lambda: time_in_uniform_current(END - BEGIN, CURRENT, 1.0),
    ),
    "rotation": (
        lambda x, y: (RATE * y, -RATE * x),
        lambda: time_in_solid_rotation(BEGIN, END, RATE, 1.0),
    ),
    "jet": (
        lambda x, y: (_jet(y), 0.0 * x),
        lambda: time_in_jet(BEGIN, END, lambda y: float(_jet(y)), 1.0),
    ),
}


def _path(flow: FlowEstimate, begin: Array, end: Array, **options: object) -> AuvPlan:
    return plan_path(flow, PathRequest(place(flow, *begin), place(flow, *end), **options))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", CASES)
def test_as_quick_as_zermelo(name: str):
    velocity, exact = CASES[name]
    found = _path(fitted_flow(velocity), np.append(BEGIN, 50.0), np.append(END, 50.0))
    assert found.status == "reached"
    assert found.duration == pytest.approx(exact(), rel=1e-3)
    assert found.closest_approach < 5.0
    assert np.linalg.norm(found.velocity_through_water, axis=1).max() <= 1.0 + 1e-6


def test_as_quick_as_can_be_in_a_uniform_current_that_changes():
    hour, base = 3600 * 10**9, 10**15
    velocities = np.array([[0.3, -0.4], [-0.5, 0.3], [-0.5, 0.3]])
    flows = [
        replace(
            fitted_flow(lambda x, y, u=u, v=v: (0.0 * x + u, 0.0 * y + v)),
            time_ns=base + k * 8 * hour,
        )
        for k, (u, v) in enumerate(velocities)
    ]
    begins = base + 2 * hour
    asked = PathRequest(
        place(flows[0], *BEGIN, 50.0), place(flows[0], *END, 50.0), start_time_ns=begins
    )
    found = plan_path(flows, asked)

    def carried(seconds: float) -> Array:
        # the integral of a current that is linear from the second hour on until the eighth, and constant afterwards
        clock = np.linspace(7200.0, 7200.0 + seconds, 4001)
        current = np.column_stack(
            [np.interp(clock, 8 * 3600.0 * np.arange(3), values) for values in velocities.T]
        )
        return np.trapezoid(current, clock, axis=0)

    exact = brentq(
        lambda seconds: np.linalg.norm(END - BEGIN - carried(seconds)) - seconds, 1e4, 2e5
    )
    assert found.status == "reached"
    assert found.duration == pytest.approx(exact, rel=2e-3)
    assert found.closest_approach < 20.0
    # in the current of its start it is slower, or quicker, by far
    assert abs(plan_path(flows[0], asked).duration / exact - 1.0) > 0.03
    with pytest.raises(PlanError, match="expected increasing times"):
        plan_path(flows[::-1], asked)
    with pytest.raises(PlanError, match="not on the nodes"):
        plan_path([flows[0], replace(still_flow(), time_ns=base + hour)], asked)


def test_least_energy_goes_at_the_most_frugal_speed():
    begin, way = np.array([-9e3, 0.0, 50.0]), np.array([20e3, 4e3, 150.0])
    for vehicle in (Auv(), Auv(hotel=5.0)):
        settings = AuvSettings(objective="energy", free_depth=False)
        found = _path(still_flow(), begin, begin + way, vehicle=vehicle, settings=settings)
        speed = most_frugal_speed(vehicle.hotel, vehicle.drag)
        assert np.linalg.norm(way) / found.duration == pytest.approx(speed, rel=1e-3)
        assert found.energy == pytest.approx(
            (vehicle.hotel + vehicle.drag * speed**3) * found.duration, rel=1e-3
        )


@pytest.mark.full
def test_free_depths_are_no_slower():
    flow = eddying_flow(5, speed=0.4)
    ask = (flow, np.array([-15e3, -8e3, 40.0]), np.array([12e3, 9e3, 300.0]))
    bound, free = (_path(*ask, settings=AuvSettings(free_depth=free)) for free in (False, True))
    assert bound.status == free.status == "reached"
    assert free.duration <= bound.duration * (1.0 + 1e-6)


@pytest.mark.full
def test_an_area_is_gone_round_by_the_shortest_way():
    flow, settings = still_flow(), AuvSettings(free_depth=False)
    area, other = _area(flow, -2e3, -8e3, 2e3, 3e3), _area(flow, 4e3, -2e3, 7e3, 9e3)
    begin, end = np.array([-12e3, 0.0, 20.0]), np.array([12e3, 1e3, 20.0])
    corners = [(-2e3, 3e3), (2e3, 3e3), (4e3, -2e3), (7e3, -2e3)]
    found = _path(flow, begin, end, no_go=(area, other), settings=settings)
    taut = np.sum(np.linalg.norm(np.diff([begin[:2], *corners, end[:2]], axis=0), axis=1))
    assert found.status == "reached"
    # a metre takes a second; at each corner at most a quarter of a circle of the margin, 50 m and twice doubled, is more
    assert taut <= found.duration < taut + len(corners) * np.pi / 2.0 * 200.0


def test_a_way_round_an_area_goes_down_as_steadily_as_the_straight_one():
    flow = still_flow()
    ask = (flow, np.array([-9e3, 0.0, 20.0]), np.array([9e3, 0.0, 220.0]))
    found = _path(
        *ask, no_go=(_area(flow, -2e3, -8e3, 2e3, 2e3),), settings=AuvSettings(free_depth=False)
    )
    assert found.status == "reached"
    np.testing.assert_allclose(
        found.track[:, 2], 20.0 + 200.0 * found.track_time / found.duration, atol=20.0
    )


@pytest.mark.parametrize("backward", [False, True])
def test_a_crossing_between_two_points_of_a_track_is_seen_in_its_first_and_its_last_part(
    backward: bool,
):
    flow = still_flow()
    region, area = region_of(flow.grid), _area(flow, -2e3, -8e3, 2e3, 3e3)
    rings = all_rings(region, 20.0, (area,))
    # six kilometres between the points, of which the area takes four
    track = np.array([[-9e3, 0.0, 20.0], [-3e3, 0.0, 20.0], [3e3, 0.0, 20.0]])
    past = track + np.array([0.0, 4e3, 0.0])
    assert (
        _crossed(bottom_of(region, None, 20.0), rings, track[::-1] if backward else track)
        == "range"
    )
    assert _crossed(bottom_of(region, None, 20.0), rings, past[::-1] if backward else past) is None


def test_what_it_may_not_cross_and_what_it_cannot_reach_is_said():
    flow = still_flow()
    wall = _area(flow, -2e3, -60e3, 2e3, 60e3)
    begin, end, settings = (
        np.array([-9e3, 0.0, 20.0]),
        np.array([9e3, 0.0, 20.0]),
        AuvSettings(free_depth=False),
    )
    crossing = _path(flow, begin, end, no_go=(wall,), settings=settings)
    assert crossing.status in ("unsafe", "unreachable")
    assert "range" in crossing.message or "current" in crossing.message
    late = _path(flow, begin, end, settings=AuvSettings(free_depth=False, max_duration=6e3))
    assert (late.status, late.closest_approach) == ("unreachable", pytest.approx(12e3, rel=1e-3))
    with pytest.raises(PlanError, match="outside the forecast"):
        _path(flow, begin, np.array([9e6, 0.0, 20.0]))
