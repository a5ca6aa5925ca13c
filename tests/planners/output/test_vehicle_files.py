"""Files for vehicles hold what the list of waypoints does: each is read back."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from planners import waypoints_of
from planners.output import waypoint_text
from replay_kit.core.plan import Area
from tests.planners.test_waypoints import FLOW, PLAN, REQUEST
from tests.reference.vehicle import read_mission_arguments, read_targets

FEW = waypoints_of(FLOW, PLAN, REQUEST, 50.0)[0]
# on the way a wider radius than at the goals
FEW = replace(FEW, radius=np.linspace(800.0, 200.0, FEW.times.size))
PLACES = np.column_stack([FEW.longitude, FEW.latitude])


def test_a_qgroundcontrol_plan_has_each_waypoint_and_its_radius():
    read = json.loads(waypoint_text(FEW, Path("mission.plan")))
    mission = read["mission"]
    assert (read["fileType"], mission["version"]) == ("Plan", 2)
    home, items = mission["plannedHomePosition"], mission["items"]
    # waypoints, at an altitude above home
    assert {(item["command"], item["frame"]) for item in items} == {(16, 3)}
    params = np.array([item["params"] for item in items], dtype=float)
    np.testing.assert_allclose(params[:, [5, 4]], PLACES, atol=6e-8)
    np.testing.assert_array_equal(
        params[:, [1, 6]], np.column_stack([FEW.radius, 0.0 * FEW.radius])
    )
    np.testing.assert_allclose(home, [*PLACES[0, ::-1], 0.0], atol=6e-8)


def test_a_qgroundcontrol_plan_has_the_fence_and_the_areas_that_hold_at_any_depth():
    corners = ((152.0, -40.0), (152.1, -40.0), (152.1, -39.9))
    areas = (
        Area("range", False, corners),
        Area("lane", True, corners),
        Area("bay", False, corners[::-1], fence=True),
    )
    read = json.loads(waypoint_text(replace(FEW, areas=areas), Path("mission.plan")))
    polygons = read["geoFence"]["polygons"]
    assert [one["inclusion"] for one in polygons] == [False, True]
    assert polygons[0]["polygon"] == [[y, x] for x, y in corners]


def test_a_kml_has_each_waypoint_and_the_way():
    # across the antimeridian
    longitude = (FEW.longitude - FEW.longitude.mean() + 360.0) % 360.0 - 180.0
    text = waypoint_text(replace(FEW, longitude=longitude), Path("mission.KML"))
    read = ElementTree.fromstring(text)
    space = "{http://www.opengis.net/kml/2.2}"
    points = [point.findtext(f"{space}coordinates") for point in read.iter(f"{space}Point")]
    np.testing.assert_allclose(
        np.loadtxt(points, delimiter=","),
        np.column_stack([longitude, FEW.latitude, 0.0 * longitude]),
        atol=6e-8,
    )
    (way,) = read.iter(f"{space}LineString")
    assert way.findtext(f"{space}coordinates").split() == points


def test_a_slocum_s_goto_list_has_each_waypoint():
    behaviour, arguments, places = read_mission_arguments(waypoint_text(FEW, Path("goto_l10.ma")))
    assert behaviour == "goto_list"
    assert arguments == {
        "num_waypoints(nodim)": len(PLACES),
        "num_legs_to_run(nodim)": -2.0,
        "start_when(enum)": 0.0,
        "list_stop_when(enum)": 7.0,
        # one for all: a glider that stops at the wider radius misses the goal
        "list_when_wpt_dist(m)": 200.0,
        "initial_wpt(enum)": 0.0,
    }
    assert len(places) == len(PLACES)


def test_a_slocum_s_yo_has_the_dives():
    behaviour, arguments, places = read_mission_arguments(waypoint_text(FEW, Path("yo10.ma")))
    assert (behaviour, places.size) == ("yo", 0)
    pitch = -np.deg2rad(FEW.pitches_deg.mean())
    said = {
        "d_target_depth(m)": FEW.depths.min(),
        "num_half_cycles_to_do(nodim)": 2 * FEW.yos,
        "d_pitch_value(X)": pitch,
        "c_pitch_value(X)": -pitch,
        "d_target_altitude(m)": PLAN.settings.clearance,
    }
    assert {name: arguments[name] for name in said} == pytest.approx(said, abs=5e-5)


@pytest.mark.parametrize(
    ("depth", "rows"),
    [
        (200.0, ["50 5 1 60", "200 10 1 120"]),
        (612.5, ["50 5 1 60", "200 10 1 120", "612.5 20 1 180"]),
    ],
)
def test_a_seaglider_samples_down_to_its_deepest_dive(depth, rows):
    deepest = replace(FEW, depths=np.array([20.0, depth, 25.0]))
    comment, *lines = waypoint_text(deepest, Path("science")).splitlines()
    assert (comment[0], lines) == ("/", rows)


def test_a_seaglider_s_targets_lead_from_each_waypoint_to_the_next():
    targets = read_targets(waypoint_text(FEW, Path("targets")))
    assert [one["radius"] for one in targets.values()] == FEW.radius.tolist()
    names = list(targets)
    assert [one["goto"] for one in targets.values()] == [*names[1:], names[-1]]


@pytest.mark.parametrize(
    "degrees", [-179.9999999, -70.5, -0.00001, 0.0, 0.99999999, 7.05, 152.9876543, 180.0]
)
def test_minutes_are_read_as_they_were_written(degrees):
    # to a tenth of a thousandth of a minute
    there = replace(FEW, longitude=FEW.longitude * 0.0 + degrees)
    for places in (
        read_mission_arguments(waypoint_text(there, Path("goto_l10.ma")))[2],
        [
            [one["lon"], one["lat"]]
            for one in read_targets(waypoint_text(there, Path("a.targets"))).values()
        ],
    ):
        np.testing.assert_allclose(
            places, np.column_stack([there.longitude, FEW.latitude]), atol=0.5e-4 / 60.0 + 1e-12
        )
