"""Missions flown in other currents, the ellipses of their surfacings, and their tables."""

import csv
import io
import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from planners import MissionSettings, fly_mission
from planners.odds.mission import ellipse_factor, ellipses_of
from planners.output import as_plan, legs_table, places_table, to_csv, to_json
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import heading_deg, rotate_to_geographic, to_local
from replay_kit.core.grid import Projection
from tests.planners.flow_samples import eddying_flow, plan_between

FLOW = eddying_flow(11)
SETTINGS = MissionSettings(depth=390.0, surface_time=600.0)


@cache
def planned(scale=1.0):
    flow = replace(FLOW, latent=scale * FLOW.latent)
    return plan_between(flow, (-6e3, -4e3), (5e3, 4e3, 100.0), settings=SETTINGS)


def test_a_mission_flown_in_its_own_flow_goes_as_planned():
    with pytest.raises(PlanError, match="without legs"):
        fly_mission(FLOW, planned(np.nan))
    flown, miss = fly_mission(FLOW, planned())
    assert miss[0, -1] == pytest.approx(planned().closest_approach[-1], abs=0.1)
    assert flown.time[0, -1] == pytest.approx(planned().duration, rel=1e-12)
    # headings are of true north: another projection makes nothing of them but rounding and the turn within a leg
    moved = replace(FLOW, grid=replace(FLOW.grid, projection=Projection(152.7, -40.2)))
    still, here = (
        fly_mission(replace(flow, latent=0.0 * FLOW.latent), planned())[1][0, -1]
        for flow in (moved, FLOW)
    )
    assert still == pytest.approx(here, abs=3.0)


def test_an_ellipse_lies_where_the_surfacings_do_and_its_bearing_is_of_true_north():
    # along a meridian east of the antimeridian, where the local frame's north leans; a little to either side
    frame, latitudes = Projection(178.5, -60.0), -60.0 + 0.01 * np.linspace(-1.0, 1.0, 9)
    longitudes = 180.0 + 1e-3 * (-1.0) ** np.arange(9)
    places = np.column_stack(to_local(frame, longitudes, latitudes))
    ((longitude, latitude, major, minor, bearing),) = ellipses_of(frame, places[:, None])
    assert (abs(longitude), latitude) == pytest.approx((180.0, -60.0), abs=1e-3)
    assert min(bearing, 180.0 - bearing) < 1.0
    assert major > 5.0 * minor


def test_tables_say_what_the_plan_says():
    rows = legs_table(planned(), None)
    assert [row["surfacing_s"] for row in rows] == planned().surfacing_times.tolist()
    assert (rows[-1]["depth_m"], rows[0]["speed_m_s"]) == (max(planned().yo_depths[-1]), 0.3)
    off = np.tile([-20.0, np.nan], (len(rows), 1))
    odds = SimpleNamespace(ellipses=np.ones((len(rows), 5)), forgiving=off, count=7)
    first = next(csv.DictReader(io.StringIO(to_csv(planned(), odds))))
    assert (first["leg"], first["heading_to_deg"], first["ellipse_major_m"]) == ("1", "", "1.0")
    heading, least = (float(first[f"heading_{name}deg"]) for name in ("", "from_"))
    told = np.mod(planned().headings_deg[0] - [0.0, 20.0], 360.0)
    assert [heading, least] == pytest.approx(told, abs=1e-6)
    goal = places_table(planned(), None)[0]
    assert (goal["met_s"], goal["depth_m"]) == (planned().goal_times[0], 100.0)
    assert to_json(planned(), None)["goals"][0]["off_m"] == planned().closest_approach[0]


def test_a_mission_is_also_a_plan_for_the_result_s_messages():
    plan, frame = planned(), FLOW.grid.projection
    glide = as_plan(plan, frame)
    assert (glide.status, glide.heading_deg, glide.duration) == (
        "reached",
        plan.headings_deg[0],
        plan.duration,
    )
    assert np.linalg.norm(glide.velocity_through_water) == pytest.approx(0.3)
    at = frame, glide.start.longitude, glide.start.latitude
    true = rotate_to_geographic(*at, *glide.velocity_through_water[:2])
    assert heading_deg(*true) == pytest.approx(glide.heading_deg, abs=1e-6)
    none = as_plan(planned(np.nan), frame)
    assert (none.status, none.duration) == ("failed", 0.0)
    assert to_csv(planned(np.nan), None) == "leg\n"
    assert json.loads(json.dumps(to_json(planned(np.nan), None), allow_nan=False))["legs"] == []


@pytest.mark.parametrize("count", [3, 5, 10, 20, 50])
def test_an_ellipse_of_few_points_holds_nine_of_ten_others(count):
    rng, held = np.random.default_rng(count), []
    # two directions of different size that are correlated
    root = np.array([[300.0, 0.0], [120.0, 80.0]])
    for _ in range(1000):
        points = rng.standard_normal((count, 2)) @ root.T
        other = rng.standard_normal((40, 2)) @ root.T
        away = other - points.mean(axis=0)
        scaled = np.sum(away * np.linalg.solve(np.cov(points.T), away.T).T, axis=1)
        held.append(np.mean(scaled <= ellipse_factor(count) ** 2))
    assert 0.87 < np.mean(held) < 0.93
