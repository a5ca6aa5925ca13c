"""Waypoints: how few tell a mission's way, how a glider fares that heads for them, and what it keeps clear of."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners import MissionSettings, plan_mission, waypoints_of
from planners.hazards.areas import no_go_rings
from planners.output import waypoint_text
from planners.waypoints import kept_surfacings
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    request_between,
    still_flow,
    uniform_flow,
)
from tests.planners.hazardous import harm_done, harm_of_files, random_mission
from tests.planners.mission.test_bottom import bathymetry
from tests.planners.uncertain import uncertain
from tests.reference.reference_path import farthest_left_out
from tests.reference.vehicle import fly_commands
from tests.synthetic_flow import with_weights

SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)
FLOW = eddying_flow(7)
REQUEST = request_between(
    FLOW, (-8e3, -6e3), (-1e3, 4e3), (8e3, 1e3), settings=replace(SETTINGS, legs=8)
)
PLAN = plan_mission(FLOW, REQUEST)
PLACES = np.column_stack(
    to_local(
        FLOW.grid.projection,
        *np.vstack([[PLAN.start.longitude, PLAN.start.latitude], PLAN.surfacings]).T,
    )
)
TIMES = np.append(0.0, PLAN.surfacing_times)
STILL = still_flow()
ACROSS = request_between(STILL, (-7e3, 0.0), (7e3, 0.0), settings=MissionSettings(depth=300.0))


def listed(flow, request, tolerance=None, plan=None, samples=()):
    plan = plan or plan_mission(flow, request)
    return plan, *waypoints_of(flow, plan, request, tolerance, samples)


def test_what_is_left_out_is_within_the_tolerance_and_goals_are_kept():
    counts = []
    for tolerance in (20.0, 200.0, 1e5):
        kept = kept_surfacings(PLAN, PLACES, tolerance)
        assert farthest_left_out(kept, TIMES, PLACES) <= tolerance
        assert set(PLAN.goal_legs) <= set(kept)
        counts.append(len(kept))
    assert counts[0] > counts[1] >= counts[2] == 2
    deep = replace(PLAN, goals=(replace(PLAN.goals[0], depth=120.0), PLAN.goals[1]))
    passed = PLAN.goal_legs[0]
    assert set(kept_surfacings(deep, PLACES, 1e5)) == {passed - 1, passed, PLAN.goal_legs[1]}


@pytest.mark.parametrize("depth", [0.0, 120.0])
def test_in_a_uniform_current_one_waypoint_loses_little(depth):
    flow = uniform_flow(0.1, 0.05)
    request = request_between(flow, (-6e3, -3e3, depth), (6e3, 3e3), settings=SETTINGS)
    plan, one, none = listed(flow, request)
    assert (one.times.size, one.arrives, none) == (1, True, None)
    assert one.off_end < PLAN.settings.tolerance
    # a drift more or less
    assert abs(one.delay) < 1200.0
    assert one.times[-1] == pytest.approx(plan.duration + one.delay)


def test_files_hold_the_waypoints():
    _, few, _ = listed(FLOW, REQUEST, 50.0, PLAN)
    rows = list(csv.DictReader(io.StringIO(waypoint_text(few, Path("a.csv")))))
    written = [float(row["longitude"]) for row in rows]
    assert written == pytest.approx(few.longitude, abs=1e-6)
    assert [float(row["radius_m"]) for row in rows] == few.radius.tolist()
    way, *features = json.loads(waypoint_text(few, Path("a.geojson")))["features"]
    assert len(features) == len(rows)
    # a glider that has arrived surfaces no more
    assert np.diff(few.surfacings, axis=0).all()
    told = next(one["properties"] for one in (way, *features) if "dives" in one["properties"])
    assert [type(told[name]) for name in ("waypoint", "dives")] == [int, int]
    assert json.loads(waypoint_text(few, Path("a.json")))["off_end_m"] == few.off_end
    with pytest.raises(PlanError, match=r"one of \.csv"):
        waypoint_text(few, Path("a.txt"))


def test_a_list_has_the_odds_of_a_glider_that_heads_for_it():
    flow = uncertain(eddying_flow(7, speed=0.1), 0.04)
    request = request_between(flow, (-6e3, -3e3), (6e3, 3e3), settings=SETTINGS)
    _, few, odds = listed(flow, request, samples=flow.sample(20, 0))
    assert odds.count == 20
    assert odds.safe == 1.0
    assert odds.reached > 0.5
    assert odds.radius == SETTINGS.tolerance == few.radius[-1] == few.radius.min()
    # an area beside the way is entered in some
    area = forbidden(flow, -5e3, -9e3, 6e3, -1.9e3)
    plan = plan_mission(flow, request)
    _, _, beside = listed(flow, replace(request, no_go=(area,)), 1e5, plan, flow.sample(20, 0))
    assert beside.safe < 1.0


@pytest.mark.full
def test_a_long_tolerance_does_not_lead_through_an_area():
    area = forbidden(STILL, -1e3, -9e3, 1e3, 2e3)
    asked = replace(ACROSS, no_go=(area,))
    plan, clear, _ = listed(STILL, asked, 1e5)
    _, blind, _ = listed(STILL, ACROSS, 1e5, plan)
    assert plan.status == "reached"
    assert (blind.times.size, blind.violation) == (1, None)
    assert clear.times.size > 1
    assert clear.violation is None
    # what is left out without the area leads through it
    ring = no_go_rings(STILL.grid.projection, area)[0]
    crossed = []
    for few in (clear, blind):
        ends = np.column_stack(to_local(STILL.grid.projection, *few.surfacings.T))
        track = np.linspace([[-7e3, 0.0], *ends[:-1]], ends, 4000).reshape(-1, 2)
        crossed.append(ring.forbids(track).any())
    assert crossed == [False, True]


def test_waypoints_that_cannot_be_headed_for_in_safety_say_so_first():
    plan = plan_mission(STILL, ACROSS)
    late = forbidden(STILL, -1e3, -1e3, 1e3, 1e3)
    _, found, _ = listed(STILL, replace(ACROSS, no_go=(late,)), plan=plan)
    assert found.violation.what == "range"
    assert found.message.startswith("not safe: heading for the waypoints crosses range at 152.")


def test_a_list_is_judged_for_currents_that_a_glider_may_remember():
    northward, area = uniform_flow(0.0, 0.2), forbidden(STILL, -6e3, 3e2, -2e3, 2.5e3)
    mode, alike = northward.latent[:, :1], np.ones((STILL.levels.size,) * 2)
    still = uniform_flow(0.0, 0.0)
    known, guessed = (with_weights(still, share * mode, alike) for share in (0.01, 0.5))
    # where none is remembered, as after launch, or one to the south, the first dive leads two kilometres to the north
    for flow, leg in ((northward, 1), (known, None), (guessed, 1)):
        _, few, _ = listed(flow, replace(ACROSS, no_go=(area,)))
        assert getattr(few.violation, "leg", None) == leg


def test_waypoints_that_are_never_reached_are_not_called_safe_beside_an_area():
    # the plan's way is undone by a current of the vehicle's own speed
    plan, adverse = plan_mission(STILL, ACROSS), uniform_flow(-0.3, 0.0)
    far = forbidden(STILL, 12e3, 10e3, 13e3, 11e3)
    _, without, _ = listed(adverse, ACROSS, plan=plan)
    _, beside, _ = listed(adverse, replace(ACROSS, no_go=(far,)), plan=plan)
    assert (without.violation, without.arrives) == (None, False)
    assert without.message.startswith("not reliable: not all waypoints are reached")
    assert beside.violation is not None
    assert "unchecked water, as waypoint 1 is not reached in" in beside.message


@pytest.mark.full
def test_dives_to_a_waypoint_are_as_deep_as_the_shallowest_planned_on_the_way():
    sill = bathymetry(lambda x, y: np.where(np.abs(x - 152.5) < 0.02, 150.0, 900.0))
    _, few, _ = listed(STILL, replace(ACROSS, bathymetry=sill), 1e5)
    assert few.depths.tolist() == [130.0]


# 39 goes by an island to a goal over a shoal
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.full) for seed in (39, *range(1, 14)))]
)
def test_what_is_called_reached_crosses_nothing_when_it_is_flown(seed):
    mission = random_mission(seed)
    plan, few, _ = listed(mission.flow, mission.request)
    assert plan.status == "reached"
    assert harm_done(mission, plan.track) is None
    assert harm_done(mission, fly_commands(mission.sea, plan)) is None
    harms = harm_of_files(mission, plan, few)
    assert few.violation is not None or not few.arrives or harms == {None}


def test_dives_beside_an_island_are_as_deep_as_the_water_and_too_few_legs_end_short_of_the_goal():
    mission = random_mission(39)
    plan = plan_mission(mission.flow, mission.request)
    # the limit is that of the goal, 250 m, for the last leg alone
    assert len(plan.yo_depths) <= 8
    short = replace(mission.request, settings=replace(mission.request.settings, max_legs=3))
    ended = plan_mission(mission.flow, short)
    assert ended.status == "unreachable"
    assert harm_done(mission, ended.track) is None
