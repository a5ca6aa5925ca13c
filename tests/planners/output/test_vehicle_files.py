"""Files for vehicles hold what the list of waypoints does: each is read back."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from planners import waypoints_of
from planners.output.waypoints import waypoint_text
from tests.planners.mission.test_waypoints import FLOW, PLAN

FEW = waypoints_of(FLOW, PLAN, 50.0)
PLACES = np.column_stack([FEW.longitude, FEW.latitude])


def test_a_qgroundcontrol_plan_has_each_waypoint_and_its_radius():
    read = json.loads(waypoint_text(FEW, Path("mission.plan")))
    assert (read["fileType"], read["version"], read["mission"]["version"]) == ("Plan", 1, 2)
    items = read["mission"]["items"]
    assert [(item["command"], item["frame"], item["doJumpId"], item["type"]) for item in items] == [
        (16, 3, k, "SimpleItem") for k in range(1, len(PLACES) + 1)
    ]
    parameters = [item["params"] for item in items]
    np.testing.assert_allclose([[p[5], p[4]] for p in parameters], PLACES, atol=6e-8)
    assert {(p[0], p[1], p[2], p[3], p[6]) for p in parameters} == {(0.0, FEW.radius, 0.0, None, 0.0)}
    np.testing.assert_allclose(read["mission"]["plannedHomePosition"], [PLACES[0, 1], PLACES[0, 0], 0.0], atol=6e-8)


def test_a_kml_has_each_waypoint_and_the_way():
    read = ElementTree.fromstring(waypoint_text(FEW, Path("mission.KML")))
    space = "{http://www.opengis.net/kml/2.2}"
    points = [point.findtext(f"{space}coordinates") for point in read.iter(f"{space}Point")]
    np.testing.assert_allclose(
        [[float(part) for part in text.split(",")] for text in points], np.column_stack([PLACES, 0.0 * PLACES[:, 0]]), atol=6e-8
    )
    (way,) = read.iter(f"{space}LineString")
    assert way.findtext(f"{space}coordinates").split() == points
    assert next(read.iter(f"{space}description")).text == FEW.message


def test_a_slocum_s_yo_has_the_dives():
    text = waypoint_text(FEW, Path("yo10.ma"))
    values = {name: float(value) for name, value in re.findall(r"b_arg: (\w+)\(\w+\) (-?[\d.]+)", text)}
    assert text.startswith("behavior_name=yo\n")
    assert (values["d_target_depth"], values["num_half_cycles_to_do"]) == (FEW.depths.min(), 2 * FEW.yos)
    assert values["d_pitch_value"] == pytest.approx(-np.deg2rad(FEW.pitches_deg.mean()), abs=5e-5)
    assert values["c_pitch_value"] == -values["d_pitch_value"]
    assert waypoint_text(FEW, Path("goto_l10.ma")).startswith("behavior_name=goto_list\n")
