"""Missions: still water, a uniform current, forbidden areas, what cannot be reached, what cannot be asked."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    Glider,
    MissionRequest,
    MissionSettings,
    NoGo,
    Weights,
    plan_mission,
)
from planners.clearance import bends
from planners.hazards.areas import no_go_rings
from planners.simulation.fly import Flight
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import Place
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    plan_between,
    request_between,
    still_flow,
    uniform_flow,
)

GLIDER = Glider()
SETTINGS = MissionSettings(depth=300.0)
FLAT, STEEP = np.deg2rad([15.0, 35.0])


def _local(flow, plan):
    return np.column_stack(to_local(flow.grid.projection, *plan.surfacings.T))


def test_still_water_is_crossed_straight_at_the_shallowest_angle_that_fits():
    flow = still_flow()
    result = plan_between(flow, (-12e3, 0.0), (4e3, 9e3), settings=SETTINGS)
    way, legs = float(np.hypot(16e3, 9e3)), len(result.headings_deg)
    # n dives to 300 m at the glide angle a lead 600 n / tan(a) metres far
    assert result.status == "reached"
    assert legs == np.ceil(way / (600.0 / np.tan(FLAT)))
    assert result.duration == pytest.approx(
        way / 0.3 / np.cos(np.arctan(600.0 * legs / way)), rel=1e-4
    )
    np.testing.assert_allclose(
        result.glide_angles_deg, np.rad2deg(np.arctan(600.0 * legs / way)), atol=0.1
    )
    assert result.closest_approach[0] < 1.0
    assert result.energy == pytest.approx(
        GLIDER.hotel * result.duration + legs * GLIDER.pump_work(300.0), rel=1e-12
    )
    assert result.surfacing_times[-1] == result.duration == result.track_time[-1]


def test_a_uniform_current_is_headed_off():
    flow, begin, end = uniform_flow(0.08, -0.04), np.array([-10e3, -2e3]), np.array([6e3, 4e3])
    result = plan_between(flow, begin, end, settings=SETTINGS)
    made_good = (end - begin) / result.duration - [0.08, -0.04]
    along = 600.0 * len(result.headings_deg) / result.duration
    assert result.status == "reached"
    assert np.hypot(np.hypot(*made_good), along) == pytest.approx(0.3, rel=2e-3)


def test_a_warm_start_ends_where_the_cold_one_does_and_goes_on_from_the_next_surfacing():
    flow = eddying_flow(6)
    asked = request_between(flow, (-9e3, -6e3), (9e3, 6e3), settings=SETTINGS)
    cold = plan_mission(flow, asked)
    again = plan_mission(flow, asked, warm=cold)
    assert again.duration == pytest.approx(cold.duration, rel=1e-4)
    assert again.statistics["attempts"] == 1
    here = Place(*(float(x) for x in cold.surfacings[1]), 0.0)
    then = replace(asked, start=here, start_time_ns=int(cold.surfacing_times[1] * 1e9))
    later = plan_mission(flow, then, warm=cold)
    assert len(later.headings_deg) == len(cold.headings_deg) - 2
    assert later.duration == pytest.approx(cold.duration - cold.surfacing_times[1], rel=1e-3)


@pytest.mark.full
def test_goals_are_met_in_order_at_the_surface_on_the_way_down_or_up_and_at_the_end():
    flow = eddying_flow(7)
    goals = (-4e3, 8e3), (2e3, 4e3, 120.0), (10e3, 2e3, 200.0)
    settings = replace(SETTINGS, surface_time=600.0)
    asked = request_between(flow, (-12e3, -4e3, 40.0), *goals, settings=settings)
    result = plan_mission(flow, asked)
    assert result.status == "reached"
    # thirteen dives of the optimiser's coarser steps
    assert np.all(result.closest_approach < 3.0)
    assert result.yo_depths[0][0] == 40.0
    assert result.track[-1, 2] == result.yo_depths[-1][-1] == 200.0
    assert (
        result.goal_legs[0] < result.goal_legs[1] < result.goal_legs[2] == len(result.headings_deg)
    )
    # at its time the track is at the second goal's depth, within a leg
    met = [
        np.interp(result.goal_times, result.track_time, result.track[:, axis]) for axis in range(3)
    ]
    np.testing.assert_allclose(met[2], [0.0, 120.0, 200.0], atol=1e-6)
    assert np.hypot(met[0][1] - 2e3, met[1][1] - 4e3) == pytest.approx(
        result.closest_approach[1], abs=0.1
    )
    assert result.goal_times[1] not in result.surfacing_times
    # from the surfacing after the first goal, at the same steps of the legs that are left
    begun = result.goal_legs[0]
    here = Place(*(float(x) for x in result.surfacings[begun - 1]), 0.0)
    now = result.surfacing_times[begun - 1]
    left = replace(asked, start=here, goals=asked.goals[1:], start_time_ns=int(now * 1e9))
    later = plan_mission(flow, left, warm=result)
    assert later.status == "reached"
    np.testing.assert_allclose(later.goal_times + now, result.goal_times[1:], rtol=1e-3)


@pytest.mark.parametrize(("worth_of_a_kilometre", "comes_close"), [(0.8, False), (1.2, True)])
def test_coming_close_is_weighed_against_time(worth_of_a_kilometre, comes_close):
    flow = still_flow()
    # a kilometre more at the glide angle a takes cos(a) / 0.3 / 3.6 hours: for less it is not gone, and no second dive is worth it
    angle = np.arccos(0.8 * 0.3 * 3.6)
    weights = Weights(time=1.0, closest=worth_of_a_kilometre)
    request = request_between(
        flow, (-2e3, 0.0), (2e3, 0.0), settings=replace(SETTINGS, objective=weights)
    )
    result = plan_mission(flow, request)
    assert (result.status == "reached") == comes_close
    assert len(result.headings_deg) == (2 if comes_close else 1)
    assert result.closest_approach[0] == pytest.approx(
        0.0 if comes_close else 4e3 - 600.0 / np.tan(angle), abs=15.0
    )
    assert ("limit: the weights" in result.message) != comes_close


def test_weights_are_a_sum_and_cannot_be_anything():
    weights = Weights(time=2.0, energy=0.1, closest=0.5)
    assert weights.cost(7200.0, 5e3, 3e3) == pytest.approx(2.0 * 2.0 + 0.1 * 5.0 + 0.5 * 3.0)
    for wrong in ({"time": -1.0}, {"time": 0.0}, {"energy": float("nan")}, {"closest": 0.0}):
        with pytest.raises(PlanError, match="expected numbers of 0 or more"):
            Weights(**wrong)


def test_a_flow_that_changes_is_planned_in_as_it_will_be():
    first = replace(uniform_flow(0.0, 0.0), time_ns=0)
    later = replace(uniform_flow(0.0, 0.12), time_ns=int(6e4 * 1e9))
    asked = request_between(first, (-8e3, 0.0), (8e3, 0.0), settings=SETTINGS)
    result = plan_mission((first, later), asked)
    drift = 0.12 * result.duration**2 / 2.0 / 6e4
    assert result.status == "reached"
    east, north = 0.3 * np.cos(np.deg2rad(result.glide_angles_deg)), np.deg2rad(result.headings_deg)
    assert np.mean(east * np.cos(north)) * result.duration == pytest.approx(-drift, rel=0.02)


@pytest.mark.parametrize(
    ("goals", "settings", "words"),
    [
        ((), SETTINGS, "needs a goal"),
        (
            (Place(152.5, -40.0, 0.0),),
            replace(SETTINGS, depth=801.0),
            "twice the deepest level, 400 m",
        ),
        ((Place(152.5, -40.0, 350.0),), SETTINGS, "deeper than the dives"),
        (
            (Place(152.5, -40.0, 310.0), Place(152.55, -40.0, 0.0)),
            SETTINGS,
            "deeper than the dives",
        ),
        (
            (Place(152.5, -40.0, 0.0), Place(152.55, -40.0, 0.0)),
            replace(SETTINGS, legs=1),
            "2 goals need as many legs",
        ),
        ((Place(152.5, -40.1, 0.0),), SETTINGS, "goal is in a forbidden area: range"),
        ((Place(160.0, -40.0, 0.0),), SETTINGS, "outside the forecast"),
        (
            (Place(152.5, -40.0, 0.0),),
            replace(SETTINGS, objective=Weights(time=1.0, closest=0.0)),
            "a weight of 0",
        ),
    ],
)
def test_missions_that_cannot_be_asked_for(goals, settings, words):
    flow = still_flow()
    area = forbidden(flow, -5e3, -16e3, 5e3, -6e3)
    with pytest.raises(PlanError, match=words):
        plan_mission(
            flow, MissionRequest(Place(152.4, -40.0, 0.0), goals, settings=settings, no_go=(area,))
        )


@pytest.mark.parametrize(
    "wrong", [{"depth": 0.0}, {"legs": 0}, {"surface_time": -1.0}, {"tolerance": float("nan")}]
)
def test_settings_that_cannot_be_are_refused(wrong):
    with pytest.raises(PlanError, match="expected"):
        MissionSettings(**wrong)
    with pytest.raises(PlanError, match="three pairs"):
        no_go_rings(still_flow().grid.projection, NoGo(((152.0, -40.0), (152.1, -40.0)), "line"))


def test_a_step_without_a_duration_bends_no_path():
    time, places = np.array([0.0, 10.0, 10.0, 20.0]), np.array([[0.0, 0.0]] * 4)
    places[1:3, 0], places[3, 0] = 3.0, 6.0
    flight = Flight(
        time[None], np.array([0.0, 9.0, 9.0, 0.0]), places[None], np.zeros(4, int), np.array([3])
    )
    np.testing.assert_array_equal(bends(flight), np.zeros(3))
