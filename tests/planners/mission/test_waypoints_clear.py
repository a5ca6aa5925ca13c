"""Waypoints that keep clear: of single areas and shallows, and in random missions among hazards, their files read back."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from planners import MissionSettings, plan_mission, waypoints_of
from planners.flights import legs_of_plan
from planners.hazards.areas import no_go_rings
from planners.output.waypoints import waypoint_text
from planners.task import task_of
from planners.waypoint_flight import first_currents
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import forbidden, request_between, still_flow, uniform_flow
from tests.planners.hazardous import harm_done, harm_of_files, random_mission
from tests.planners.mission.test_bottom import bathymetry
from tests.reference.vehicle import (
    Sea,
    fly_commands,
    follow_waypoints,
    planned_current,
    read_csv_waypoints,
)
from tests.synthetic_flow import with_weights

FLOW = still_flow()
REQUEST = request_between(FLOW, (-7e3, 0.0), (7e3, 0.0), settings=MissionSettings(depth=300.0))


@pytest.mark.full
def test_a_long_tolerance_does_not_lead_through_an_area():
    area = forbidden(FLOW, -1e3, -9e3, 1e3, 2e3)
    plan = plan_mission(FLOW, replace(REQUEST, no_go=(area,)))
    assert plan.status == "reached"
    blind, clear = (waypoints_of(FLOW, plan, 1e5, no_go=areas) for areas in ((), (area,)))
    assert (blind.times.size, blind.violation) == (1, None)
    assert clear.times.size > 1
    assert clear.violation is None
    ring = no_go_rings(FLOW.grid.projection, area)[0]
    places = np.vstack(
        [[-7e3, 0.0], np.column_stack(to_local(FLOW.grid.projection, *clear.surfacings.T))]
    )
    dense = np.vstack([np.linspace(a, b, 4000) for a, b in pairwise(places)])
    assert not ring.forbids(dense).any()
    through = np.linspace(
        places[0], np.column_stack(to_local(FLOW.grid.projection, *blind.surfacings.T))[-1], 4000
    )
    assert ring.forbids(through).any()


def test_waypoints_that_cannot_be_headed_for_in_safety_say_so_first():
    plan = plan_mission(FLOW, REQUEST)
    late = forbidden(FLOW, -1e3, -1e3, 1e3, 1e3)
    found = waypoints_of(FLOW, plan, no_go=(late,))
    assert found.violation is not None
    assert found.violation.what == "range"
    assert found.message.startswith("not safe: heading for the waypoints crosses range at 152.4")


@pytest.mark.full
def test_dives_to_a_waypoint_are_as_deep_as_the_shallowest_planned_on_the_way():
    sill = bathymetry(lambda x, y: np.where(np.abs(x - 152.5) < 0.02, 150.0, 900.0))
    plan = plan_mission(FLOW, replace(REQUEST, bathymetry=sill))
    assert {min(map(max, plan.yo_depths)), max(map(max, plan.yo_depths))} == {130.0, 300.0}
    few = waypoints_of(FLOW, plan, 1e5, bathymetry=sill)
    assert few.depths.tolist() == [130.0]
    assert few.violation is None


def test_waypoints_that_are_never_reached_are_not_called_safe_beside_an_area():
    # the plan's way is undone by a current of the vehicle's own speed
    plan, adverse = plan_mission(FLOW, REQUEST), uniform_flow(-0.3, 0.0)
    far = forbidden(FLOW, 12e3, 10e3, 13e3, 11e3)
    without, beside = (waypoints_of(adverse, plan, no_go=areas) for areas in ((), (far,)))
    assert (without.violation, without.arrives) == (None, False)
    assert without.message.startswith(
        "not reliable: ends farther than 250 m from the plan's end if the glider expects "
    )
    assert beside.violation is not None
    assert "water that was not checked, as waypoint 1 is not reached in" in beside.message
    assert beside.violation.leg == len(beside.surfacings)
    # where the last of these legs ended
    assert (beside.violation.longitude, beside.violation.latitude) == pytest.approx(
        tuple(beside.surfacings[-1]), abs=1e-9
    )


def with_errors(flow, std):
    """Return a flow of the kernel of ``uniform_flow`` whose error is a uniform current of some standard deviation [m/s]."""
    modes = np.column_stack([uniform_flow(*one).latent[:, 0] for one in np.eye(2)])
    n_levels = flow.levels.size
    return with_weights(flow, modes, std**2 * np.kron(np.ones((n_levels, n_levels)), np.eye(2)))


def test_a_list_that_leads_through_an_area_where_the_first_current_is_not_known_is_not_called_clear():
    # a glider that knows the current holds off against it; one that expects none is set two kilometres to the north by its first dive
    northward, area = uniform_flow(0.0, 0.2), forbidden(FLOW, -6e3, 3e2, -2e3, 2.5e3)
    plan = plan_mission(northward, replace(REQUEST, no_go=(area,)))
    assert plan.status == "reached"
    few, sea = waypoints_of(northward, plan, no_go=(area,)), Sea([northward], 0)
    rows = read_csv_waypoints(waypoint_text(few, Path("few.csv")))
    places = np.array([[row["longitude"], row["latitude"]] for row in rows])
    inside = [
        no_go_rings(FLOW.grid.projection, area)[0]
        .forbids(follow_waypoints(sea, plan, rows, places, current)[:, :2])
        .any()
        for current in (planned_current(sea, plan), np.zeros(2))
    ]
    assert inside == [False, True]
    assert few.violation is not None
    assert few.violation.leg == 1
    assert "crosses range at" in few.message
    assert "if the glider expects no current in its first dive" in few.message


def test_a_list_is_flown_with_the_first_currents_that_the_estimate_allows():
    sure = uniform_flow(0.0, 0.0)
    plan = plan_mission(sure, REQUEST)
    # a kilometre beside the first dive
    area = forbidden(FLOW, -6e3, 8e2, -2e3, 2.5e3)
    for std, clear in ((0.01, True), (0.1, False)):
        found = waypoints_of(with_errors(sure, std), plan, no_go=(area,))
        assert (found.violation is None) == clear
    assert "crosses range at" in found.message
    assert "if the glider expects a current of" in found.message


def test_first_currents_are_spread_over_those_of_samples():
    flow, std = with_errors(uniform_flow(0.1, -0.05), 0.04), 0.04
    plan = plan_mission(flow, REQUEST)
    task = task_of(flow, REQUEST)
    planned, none, *others = first_currents(task, plan, legs_of_plan(plan))
    np.testing.assert_allclose(planned, planned_current(Sea([flow], 0), plan), atol=1e-3)
    np.testing.assert_array_equal(none, np.zeros(2))
    away = np.linalg.norm(np.array(others) - planned, axis=1) / std
    met = np.array([one.velocity(-5e3, 0.0, 100.0) for one in flow.sample(2000, 0)])
    held = np.linalg.norm(met - flow.velocity(-5e3, 0.0, 100.0), axis=1) / std
    # the outermost of them at the edge of what holds 95 of 100 samples, and as many in each quarter of that area
    assert np.mean(held < away.max()) == pytest.approx(0.95, abs=0.015)
    assert np.histogram(away**2, 4, (0.0, -2.0 * np.log(0.05)))[0].tolist() == [6, 6, 6, 6]
    np.testing.assert_allclose(np.mean(others, axis=0), planned, atol=0.2 * std)


# 39 goes by an island to a goal over a shoal
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.full) for seed in (39, *range(1, 14)))]
)
def test_what_is_called_reached_crosses_nothing_when_it_is_flown(seed):
    mission = random_mission(seed)
    plan = plan_mission(mission.flow, mission.request)
    assert plan.status == "reached"
    assert harm_done(mission, plan.track) is None
    assert harm_done(mission, fly_commands(mission.sea, plan)) is None
    few = waypoints_of(
        mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry
    )
    harms = harm_of_files(mission, plan, few)
    assert (
        few.violation is not None
        or not few.arrives
        or all(harm == {None} for harm in harms.values())
    )


def test_dives_beside_an_island_are_as_deep_as_the_water_and_too_few_legs_end_short_of_the_goal():
    mission = random_mission(39)
    plan = plan_mission(mission.flow, mission.request)
    # the limit is that of the goal, 250 m, for the last leg alone
    assert len(plan.yo_depths) <= 8
    short = replace(mission.request, settings=replace(mission.request.settings, max_legs=3))
    ended = plan_mission(mission.flow, short)
    assert ended.status == "unreachable"
    assert harm_done(mission, ended.track) is None
