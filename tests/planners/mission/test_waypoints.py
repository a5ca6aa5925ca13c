"""Waypoints: how few tell a mission's way, how a glider fares that heads for them, and the files that it reads."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, plan_mission
from planners.output.waypoints import waypoint_json, waypoint_text
from planners.waypoint_flight import heading_for
from planners.waypoints import _distance_to_legs, kept_surfacings, waypoints_of
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
    plan_between,
    still_flow,
    uniform_flow,
)
from tests.reference.reference_path import farthest_left_out
from tests.synthetic_flow import with_weights

SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)
FLOW = eddying_flow(7)
PLAN = plan_between(FLOW, (-8e3, -6e3), (-1e3, 4e3), (8e3, 1e3), settings=replace(SETTINGS, legs=8))
PLACES = np.column_stack(
    to_local(
        FLOW.grid.projection,
        *np.vstack([[PLAN.start.longitude, PLAN.start.latitude], PLAN.surfacings]).T,
    )
)


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
def test_in_a_uniform_current_one_waypoint_loses_nothing(depth):
    flow = uniform_flow(0.1, 0.05)
    plan = plan_between(flow, (-6e3, -3e3, depth), (6e3, 3e3), settings=SETTINGS)
    one = waypoints_of(flow, plan)
    assert one.times.size == 1
    assert one.off_end < 20.0
    assert one.off_track < 20.0
    # a minute of the whole day: the current is uniform to a fraction of a percent
    assert abs(one.delay) < 60.0
    assert one.times[-1] == pytest.approx(plan.duration + one.delay)
    assert "1 waypoints for" in one.message


def test_in_a_somewhat_stronger_current_a_wider_radius_is_better():
    found = waypoints_of(replace(FLOW, latent=1.2 * FLOW.latent), PLAN)
    assert found.radius == 4.0 * PLAN.settings.tolerance
    assert np.all(np.isfinite(found.times))


def test_files_hold_the_waypoints():
    few = waypoints_of(FLOW, PLAN, 50.0)
    rows = list(csv.DictReader(io.StringIO(waypoint_text(few, Path("a.csv")))))
    assert [float(row["longitude"]) for row in rows] == pytest.approx(
        few.longitude.tolist(), abs=1e-6
    )
    assert [row["waypoint"] for row in rows] == [str(k + 1) for k in range(len(rows))]
    features = json.loads(waypoint_text(few, Path("a.geojson")))["features"]
    points = [
        feature["properties"] for feature in features if feature["geometry"]["type"] == "Point"
    ]
    assert {type(properties[name]) for properties in points for name in ("waypoint", "dives")} == {
        int
    }
    assert len(features) == 1 + len(rows)
    assert json.loads(waypoint_text(few, Path("a.json")))["off_end_m"] == few.off_end
    with pytest.raises(PlanError, match=r"one of \.csv"):
        waypoint_text(few, Path("a.txt"))


def test_a_heading_counts_the_drift_at_the_surface_on_the_way_and_the_current_ahead_in_the_last_dive():
    angle = np.deg2rad(20.0)
    speed, under = 0.3 * np.cos(angle), 2.0 * 300.0 / 0.3 / np.sin(angle)
    way = 0.5 * (speed + 0.05) * under
    ways = np.array([[5e4, 0.0], [0.0, way], [0.0, 1.0], [0.0, 500.0], [0.0, 5e4], [0.0, 5e4]])
    currents = np.array(
        [[0.0, -0.1], [0.0, 0.05], [0.0, 0.0], [0.0, -0.5], [0.5, 0.0], [-0.5, 0.0]]
    )
    given = ways, np.full(6, angle), currents, np.full(6, 300.0)
    headings, shares = heading_for(PLAN, *given)
    across = np.pi / 2 - np.arcsin(0.1 * (under + 600.0) / (speed * under))
    # through water only the time under it counts: the mean speed is less by the share of the drift. The last dive surfaces at the waypoint:
    # no drift after it, and a current ahead shortens it. Never shallower than a tenth; against a current that is too strong, with all of a
    # dive. A current across that is faster than the glider is met head-on, on either side
    assert headings == pytest.approx([across, 0.0, 0.0, 0.0, -np.pi / 2, np.pi / 2])
    assert shares == pytest.approx([1.0, 0.5, 0.1, 1.0, 1.0, 1.0])
    twice = replace(PLAN, settings=replace(PLAN.settings, yos=2))
    assert heading_for(twice, *given)[1][1] == pytest.approx(0.25)


def test_a_goal_below_the_surface_keeps_both_ends_of_its_leg():
    deep = replace(PLAN, goals=(replace(PLAN.goals[0], depth=120.0), PLAN.goals[1]))
    passed = PLAN.goal_legs[0]
    assert set(kept_surfacings(deep, PLACES, 1e5)) == {passed - 1, passed, PLAN.goal_legs[1]}
    assert set(kept_surfacings(PLAN, PLACES, 1e5)) == set(PLAN.goal_legs)


def test_the_distance_to_legs_is_to_the_nearest_and_no_farther_than_their_ends():
    corners = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 50.0], [100.0, 50.0]])
    points = np.array([[50.0, 7.0], [-3.0, -4.0], [90.0, 40.0], [103.0, 54.0]])
    np.testing.assert_allclose(_distance_to_legs(points, corners), [7.0, 5.0, 10.0, 5.0])


def test_a_dive_that_begins_below_the_surface_ends_at_it_and_the_last_drift_is_not_waited_for():
    flow = still_flow()
    here, there = place(flow, 0.0, 0.0, 60.0), place(flow, 0.0, 3e3)
    plan = plan_mission(flow, MissionRequest(here, (there,), settings=replace(SETTINGS, legs=2)))
    few = waypoints_of(flow, plan)
    assert few.times.size == 1
    # 540 m of depth in the first dive and, after a drift, what is left of the way in the second, at the mean glide angle
    angle = np.mean(np.deg2rad(plan.glide_angles_deg))
    first = 540.0 / 0.3 / np.sin(angle)
    second = (3e3 - 0.3 * np.cos(angle) * first) / (0.3 * np.cos(angle))
    surfaced = np.column_stack(to_local(flow.grid.projection, *few.surfacings.T))
    np.testing.assert_allclose(surfaced, [[0.0, 0.3 * np.cos(angle) * first], [0.0, 3e3]], atol=5.0)
    assert few.times[0] == pytest.approx(first + 600.0 + second, rel=1e-3)
    assert few.delay == pytest.approx(few.times[0] - plan.duration, abs=1e-6)
    assert few.off_end < 5.0


def test_a_list_is_judged_in_samples_with_and_without_the_gliders_own_correction():
    # an error of a uniform current of 6 cm/s each way, of which the glider knows nothing before its first surfacing
    flow = uniform_flow(0.0, 0.05)
    modes = np.column_stack([uniform_flow(*one).latent[:, 0] for one in np.eye(2)])
    n_levels = flow.levels.size
    covariance = 0.06**2 * np.kron(np.ones((n_levels, n_levels)), np.eye(2))
    flow = with_weights(flow, modes, covariance)
    plan = plan_between(flow, (-6e3, -3e3), (6e3, 3e3), settings=SETTINGS)
    found = waypoints_of(flow, plan, samples=flow.sample(12, 0))
    assert found.risk.count == 12
    assert found.risk.violating == 0.0
    assert found.risk.reached > 0.5
    assert found.message.endswith(found.risk.text())
    assert waypoint_json(found)["samples"]["reached"] == found.risk.reached
    # an area beside the way is entered where the first current is not the one expected
    area = forbidden(flow, -4e3, -9e3, 6e3, -3e3)
    beside = waypoints_of(flow, plan, samples=flow.sample(12, 0), no_go=(area,))
    assert beside.risk.violating > 0.0
