"""Headings by place and time: where they lead in the estimate and in others, flown by the simulator, and their files."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planners import MissionSettings, plan_mission
from planners.mission.policy import policy_of
from planners.output.mission import policy_json, policy_text
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
    request_between,
    still_flow,
    uniform_flow,
)
from tests.reference.vehicle import Sea, follow_policy, planned_current

SETTINGS = MissionSettings(depth=300.0, surface_time=600.0)


def uncertain(flow, speed):
    """A flow whose errors are those of four other eddying flows, alike at all levels, of some RMS speed [m/s]."""
    others = [eddying_flow(100 + k, speed=speed).latent.mean(axis=1) for k in range(4)]
    n_levels = flow.levels.size
    covariance = np.kron(np.ones((n_levels, n_levels)), np.eye(4)) / 4.0
    return replace(flow, modes=np.column_stack(others), covariance=covariance)


def test_in_still_water_every_heading_leads_to_the_goal():
    flow = still_flow()
    plan = plan_mission(flow, request_between(flow, (-8e3, 0.0), (8e3, 2e3), settings=SETTINGS))
    policy = policy_of(flow, plan)
    at = np.column_stack(to_local(flow.grid.projection, policy.longitude, policy.latitude))
    way = np.array([8e3, 2e3]) - at
    far = np.linalg.norm(way, axis=1) > policy.table.near
    off = np.rad2deg(np.arctan2(*way.T)) - policy.headings_deg[0]
    # the front's ways are made of pieces in 80 directions, which are 11 degrees apart at most
    apart = np.abs((off[far] + 180.0) % 360.0 - 180.0)
    assert apart.max() < np.rad2deg(np.arctan(1.0 / 5.0))
    assert np.median(apart) < 2.0
    hours = np.linalg.norm(way, axis=1) / 3600.0 / (0.3 * np.cos(np.deg2rad(15.0)))
    assert np.median(policy.hours_left[0] / hours) == pytest.approx(1.06, abs=0.04)


def test_the_simulator_arrives_where_the_table_is_flown_in_samples():
    flow = uncertain(eddying_flow(7), 0.05)
    plan = plan_mission(flow, request_between(flow, (-9e3, -6e3), (8e3, 3e3), settings=SETTINGS))
    samples = flow.sample(12, 0)
    policy = policy_of(flow, plan, samples=samples)
    assert policy.risk.reached > 0.8
    assert policy.risk.violating == 0.0
    given = json.loads(policy_text(policy, Path("a.json")))
    assert given["samples"]["reached"] == policy.risk.reached
    goal = np.array(to_local(flow.grid.projection, *given["goal"]))
    sea = Sea((flow,), plan.start_time_ns)
    arrived = [
        np.linalg.norm(
            follow_policy(Sea((one,), 0), plan, given, planned_current(sea, plan))[-1, :2] - goal
        )
        <= given["radius_m"]
        for one in (flow, *samples[:2])
    ]
    assert sum(arrived) >= 2


def test_headings_lead_round_an_area_and_follow_a_current_that_turns():
    flow = still_flow()
    area = forbidden(flow, -1e3, -6e3, 1e3, 6e3)
    request = request_between(flow, (-8e3, 0.0), (8e3, 0.0), settings=SETTINGS)
    plan = plan_mission(flow, replace(request, no_go=(area,)))
    policy = policy_of(flow, plan, no_go=(area,))
    begin = np.array([[-6e3, 1e3], [-6e3, -1e3]])
    north, south = np.cos(policy.table.at(begin, np.zeros(2)))
    assert north > 0.3
    assert south < -0.3
    # a current that first sets north and then south is met by heading south first, then north
    turning = [
        replace(uniform_flow(0.0, speed), time_ns=10**18 + k * 8 * 3600 * 10**9)
        for k, speed in enumerate((0.1, 0.1, -0.1, -0.1))
    ]
    times = policy_of(turning, replace(plan, start_time_ns=10**18, goals=request.goals)).table
    first, last = np.cos(times.at(np.array([[-6e3, 0.0]] * 2), times.times[[0, -1]]))
    assert first < -0.2
    assert last > 0.2


@pytest.mark.parametrize("first", [0.1, -0.1])
def test_the_way_through_a_current_that_turns_takes_the_time_of_both_its_parts(first):
    plan = plan_mission(
        still_flow(), request_between(still_flow(), (-8e3, 0.0), (8e3, 0.0), settings=SETTINGS)
    )

    def hours_of(flow):
        policy = policy_of(flow, replace(plan, start_time_ns=10**18))
        away = policy.longitude - plan.start.longitude, policy.latitude - plan.start.latitude
        return policy.hours_left[0, np.argmin(np.hypot(*away))]

    flows = [uniform_flow(speed, 0.0) for speed in (first, -first)]
    before, after = (hours_of(one) for one in flows)
    turning = [
        replace(flows[hours > 10], time_ns=10**18 + hours * 3600 * 10**9)
        for hours in range(0, 60, 4)
    ]
    # it turns at ten hours: a share of the way is made by then
    made = min(10.0 / before, 1.0)
    # arrivals are tried three hours apart, and the way is of the one that leaves next to the time
    assert hours_of(turning) == pytest.approx(made * before + (1.0 - made) * after, abs=2.5)


def test_files_hold_the_same_headings_and_what_has_no_policy_is_refused():
    flow = still_flow()
    request = request_between(flow, (-6e3, 0.0), (6e3, 0.0), settings=SETTINGS)
    plan = plan_mission(flow, request)
    policy = policy_of(flow, plan)
    rows = list(csv.DictReader(io.StringIO(policy_text(policy, Path("a.csv")))))
    assert [float(row["heading_deg"]) for row in rows] == [
        row["heading_deg"] for row in policy_json(policy)["headings"]
    ]
    arrows = json.loads(policy_text(policy, Path("a.geojson")))["features"]
    assert len(arrows) == len(rows)
    assert {one["geometry"]["type"] for one in arrows} == {"LineString"}
    with pytest.raises(PlanError, match=r"one of \.csv"):
        policy_text(policy, Path("a.txt"))
    for other in (
        replace(plan, headings_deg=np.zeros(0)),
        replace(plan, goals=(place(flow, 6e3, 0.0, 100.0),)),
    ):
        with pytest.raises(PlanError, match="a policy leads to one goal at the surface"):
            policy_of(flow, other)
