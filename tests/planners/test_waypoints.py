"""Waypoints: how few tell a mission's way, how a glider fares that heads for them, and the files that it reads."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners import MissionSettings, plan_mission, plan_mooring
from planners.waypoint_output import _minutes, waypoint_json, waypoint_text
from planners.waypoints import _reckoned, heading_for, kept_surfacings, waypoints_of
from replay_kit.errors import PlanError
from replay_kit.geodesy import to_local
from tests.planners.flow_samples import eddying_flow, place, still_flow, uniform_flow
from tests.reference.guide import farthest_left_out

SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)
FLOW = eddying_flow(7)
PLAN = plan_mission(
    FLOW, place(FLOW, -8e3, -6e3, 0.0), (place(FLOW, -1e3, 4e3, 0.0), place(FLOW, 8e3, 1e3, 0.0)), settings=replace(SETTINGS, legs=8)
)
PLACES = np.column_stack(to_local(FLOW.grid.projection, *np.vstack([[PLAN.start.longitude, PLAN.start.latitude], PLAN.surfacings]).T))


TIMES = np.concatenate([[0.0], PLAN.surfacing_times])


def test_what_is_left_out_is_within_the_tolerance_and_goals_are_kept():
    counts = []
    for tolerance in (20.0, 200.0, 1e5):
        kept = kept_surfacings(PLAN, PLACES, tolerance)
        assert farthest_left_out(kept, TIMES, PLACES) <= tolerance
        assert set(PLAN.goal_legs) <= set(kept)
        counts.append(len(kept))
    assert counts[0] > counts[1] >= counts[2] == 2


@pytest.mark.parametrize("depth", [0.0, 120.0])
def test_in_a_uniform_current_one_waypoint_loses_nothing(depth: float):
    flow = uniform_flow(0.1, 0.05)
    plan = plan_mission(flow, place(flow, -6e3, -3e3, depth), place(flow, 6e3, 3e3, 0.0), settings=SETTINGS)
    one = waypoints_of(flow, plan)
    assert one.times.size == 1
    assert one.off_end < 20.0
    assert one.off_track < 20.0
    # a minute of the whole day: the current is uniform to a fraction of a percent
    assert abs(one.delay) < 60.0
    assert one.times[-1] == pytest.approx(plan.duration + one.delay)
    assert "1 waypoints for" in one.message


def test_what_eddies_and_another_flow_cost_is_measured_by_flying():
    few = waypoints_of(FLOW, PLAN)
    assert np.all(np.diff(few.times) > 0.0)
    last = np.column_stack(to_local(FLOW.grid.projection, *few.surfacings[-1]))[0]
    assert np.linalg.norm(last - PLACES[-1]) == pytest.approx(few.off_end, abs=1e-3)
    assert few.off_end <= few.radius
    assert few.times[-1] - PLAN.duration == pytest.approx(few.delay)
    against = waypoints_of(uniform_flow(-0.4, 0.0), PLAN)
    assert np.isnan(against.times[-1])
    assert "; 0 reached within" in against.message
    assert json.loads(json.dumps(waypoint_json(against), allow_nan=False))["waypoints"][-1]["reached_s"] is None


def test_in_a_somewhat_stronger_current_a_wider_radius_is_better():
    found = waypoints_of(replace(FLOW, latent=1.1 * FLOW.latent), PLAN)
    assert found.radius == 2.0 * PLAN.settings.tolerance
    assert np.all(np.isfinite(found.times))


def test_a_heading_is_held_off_against_the_current_and_a_near_waypoint_ends_a_dive_early():
    angle, plan = np.deg2rad(20.0), replace(PLAN, settings=replace(PLAN.settings, surface_time=0.0))
    speed = 0.3 * np.cos(angle)
    heading, share = heading_for(plan, np.array([5e4, 0.0]), angle, np.array([0.0, 0.1]))
    assert heading == pytest.approx(np.pi / 2 + np.arcsin(0.1 / speed))
    assert share == 1.0
    lasts = 600.0 / 0.3 / np.sin(angle)
    assert heading_for(plan, np.array([0.0, 0.4 * speed * lasts]), angle, np.zeros(2)) == pytest.approx((0.0, 0.4))
    # no dive is shallower than a tenth of the depth
    assert heading_for(plan, np.array([0.0, 0.02 * speed * lasts]), angle, np.zeros(2)) == pytest.approx((0.0, 0.1))


def test_the_current_reckoned_of_a_leg_is_the_one_that_carried_it():
    angle, heading, lasts, current = 0.4, 1.1, 9000.0, np.array([0.05, -0.12])
    under = lasts - PLAN.settings.surface_time
    way = 0.3 * np.cos(angle) * under * np.array([np.sin(heading), np.cos(heading)]) + current * lasts
    np.testing.assert_allclose(_reckoned(PLAN, way, lasts, heading, angle), current, rtol=1e-12)


def test_files_hold_the_waypoints():
    few = waypoints_of(FLOW, PLAN, 50.0)
    rows = list(csv.DictReader(io.StringIO(waypoint_text(few, Path("a.csv")))))
    assert [float(row["longitude"]) for row in rows] == pytest.approx(few.longitude.tolist(), abs=1e-6)
    features = json.loads(waypoint_text(few, Path("a.geojson")))["features"]
    assert len(features) == 1 + len(rows)
    assert json.loads(waypoint_text(few, Path("a.json")))["off_end_m"] == few.off_end
    slocum = waypoint_text(few, Path("goto_l10.ma"))
    listed = slocum.split("<start:waypoints>\n")[1].split("<end")[0].splitlines()[1:]
    assert f"num_waypoints(nodim) {len(listed)}" in slocum
    np.testing.assert_allclose([_degrees(text) for text in listed[0].split()], [few.longitude[0], few.latitude[0]], atol=1e-6)
    targets = waypoint_text(few, Path("targets")).splitlines()[1:]
    words = dict(word.split("=") for word in targets[-1].split()[1:])
    assert (_degrees(words["lat"]), words["goto"]) == (pytest.approx(few.latitude[-1], abs=1e-6), targets[-1].split()[0])
    with pytest.raises(PlanError, match=r"one of \.csv"):
        waypoint_text(few, Path("a.txt"))


def _degrees(text: str) -> float:
    value = abs(float(text))
    return float(np.sign(float(text)) * (value // 100 + value % 100 / 60.0))


@given(st.floats(-180.0, 180.0))
def test_degrees_and_minutes_are_read_back(degrees: float):
    text = _minutes(degrees)
    assert _degrees(text) == pytest.approx(degrees, abs=1e-6)
    assert float(text.split(".")[0][-2:]) < 60


def test_a_mooring_and_a_mission_without_legs_have_no_waypoints():
    flow = still_flow()
    here = place(flow, 0.0, 0.0, 0.0)
    with pytest.raises(PlanError, match="a mooring has no waypoints"):
        waypoints_of(flow, plan_mooring(flow, here, here, 2e3, 6e3, settings=SETTINGS))
    with pytest.raises(PlanError, match="without legs"):
        waypoints_of(flow, replace(PLAN, headings_deg=np.zeros(0)))
