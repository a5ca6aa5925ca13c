"""Missions of days in a sea that changes: each way of flying them at its smallest, and the figures over missions."""

from dataclasses import replace
from math import inf, isnan

import numpy as np
import pytest

from planners import Glider, MissionSettings, plan_mission
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.studies.planning.changing import Sailed, _around, figures, report_of, sail
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.voyages import (
    PASSED,
    Crossing,
    follow_plan,
    frozen,
    head_at_goal,
    replan,
    sea_of,
    with_error,
)
from replay_kit.workflows.planning.currents import uniform_currents
from tests import synthetic
from tests.command import invoke
from tests.planners.flow_samples import place, uniform_flow

NOON = 1_767_268_800 * 10**9
HOUR = 3600 * 10**9
SEA = tuple(
    replace(uniform_flow(*velocity), time_ns=NOON + k * 24 * HOUR)
    for k, velocity in enumerate([(0.1, 0.1), (-0.1, -0.1)])
)
SETTINGS = MissionSettings(depth=390.0)
CROSSING = Crossing(
    place(SEA[0], -8e3, 0.0, 0.0),
    place(SEA[0], 6e3, 0.0, 0.0),
    NOON,
    Glider(0.3, None, 15.0, 35.0),
    SETTINGS,
)
JOB = PlanningJob(("changing",), "1", crossings=1, crossing=(12e3, 14e3))


def series(members=4):
    """A forecast at two times, a day apart, whose members change."""
    made = (synthetic.ensemble(n_members=members, seed=seed, shape=(8, 9)) for seed in (0, 1))
    return tuple(replace(one, time_ns=NOON + k * 24 * HOUR) for k, one in enumerate(made))


def test_replanning_in_a_known_sea_passes_the_goal_when_its_first_plan_does_and_before_the_habit():
    plan = plan_mission(SEA, CROSSING.request(CROSSING.start, NOON))
    followed, again = follow_plan(SEA, CROSSING, plan), replan(SEA, SEA, CROSSING, plan, 1e6)
    habit = head_at_goal(SEA, CROSSING, plan, 1e6)
    assert followed.closest < 50.0
    assert 0.0 < followed.arrival < plan.duration
    assert again.arrival == pytest.approx(followed.arrival, rel=1e-3)
    assert (again.legs, again.plans) == (len(plan.headings_deg), len(plan.headings_deg))
    assert habit.arrival >= again.arrival * 0.999
    assert max(again.closest, habit.closest) <= PASSED
    # out of time before the first leg is over
    assert head_at_goal(SEA, CROSSING, plan, 0.0).legs == 0
    still = tuple(replace(uniform_flow(0.0, 0.0), time_ns=flow.time_ns) for flow in SEA)
    # 14 km less the last 1.5 at 0.29 m/s
    straight = head_at_goal(still, CROSSING, plan, 1e6).arrival
    assert straight == pytest.approx((14e3 - PASSED) / (0.3 * np.cos(np.deg2rad(15.0))), rel=0.02)


def test_the_error_of_a_leg_s_current_is_planned_with_for_a_day():
    sea, now = (*SEA, replace(SEA[1], time_ns=NOON + 60 * HOUR)), NOON + 12 * HOUR
    told = with_error(sea, uniform_currents(SEA[0]), np.array([0.05, -0.02]), now)
    assert [flow.time_ns for flow in told] == [
        now,
        NOON + 24 * HOUR,
        NOON + 36 * HOUR,
        NOON + 60 * HOUR,
    ]
    for flow, share in zip(told, (1.0, 0.5, 0.0, 0.0), strict=True):
        before = frozen(sea, flow.time_ns).velocity(0.0, 0.0, 100.0)
        np.testing.assert_allclose(
            flow.velocity(0.0, 0.0, 100.0) - before, share * np.array([0.05, -0.02]), atol=1e-3
        )


def test_a_frozen_current_is_that_between_its_times():
    held = frozen(SEA, NOON + 6 * HOUR)
    assert held.time_ns == NOON + 6 * HOUR
    np.testing.assert_allclose(held.latent, 0.75 * SEA[0].latent + 0.25 * SEA[1].latent, atol=1e-12)


def test_a_sea_is_the_mean_of_the_members_on_functions_that_all_share():
    config, two = EstimatorConfig(), series()
    alone = [
        sea_of([replace(one, velocity=one.velocity[k : k + 1]) for one in two], config)
        for k in range(4)
    ]
    mean = sea_of(two, config)
    for t in (0, 1):
        np.testing.assert_allclose(
            mean[t].latent, np.mean([sea[t].latent for sea in alone], axis=0), atol=1e-7
        )
    assert [flow.time_ns for flow in mean] == [one.time_ns for one in two]


@pytest.mark.full
def test_a_mission_is_flown_in_all_ways():
    row = sail(series(), EstimatorConfig(), JOB, 1, 3)
    assert 12e3 <= row.distance <= 14e3
    assert row.reachable
    assert row.perfect < 300.0
    assert row.held > row.perfect
    assert np.isfinite(row.known)
    # the plan is to surface at the goal, 1.5 km after the passage that counts: of 13 km that may cost a hundredth
    assert row.known <= row.known_habit * 1.01
    assert row.plans >= 1


def sailed(**how):
    base = {
        "earliest": 100.0,
        "perfect": 10.0,
        "held": 9e3,
        "replanned": 101.0,
        "habit": 104.0,
        "known": 99.0,
        "known_habit": 103.0,
    }
    return Sailed(1, 8e4, **{**base, **how})


def test_figures_count_what_arrives_and_what_is_later():
    rows = [
        sailed(),
        sailed(replanned=inf),
        sailed(replanned=106.0, perfect=20.0),
        sailed(habit=inf, known=104.0),
    ]
    found = figures(rows)
    assert (found["arrive"], found["habit_arrive"]) == (0.75, 0.75)
    assert found["over_earliest"] == pytest.approx(1.01)
    # the second does not arrive where the habit does, the third is 1.9 % later; only the last is later in the estimate
    assert (found["later"], found["later_known"]) == (0.5, 1.0)
    assert (found["perfect"], found["perfect_median"]) == (20.0, 10.0)
    assert figures([sailed(replanned=inf, habit=inf)])["later"] == 0.0
    assert isnan(figures([sailed(replanned=inf)])["over_earliest"])
    report = report_of([*rows, Sailed(2, 8e4, inf)])
    assert [one.met for one in report.criteria] == [False, True, True, False, False]
    assert "4 of 5 goals are within reach" in report.findings[0]
    assert report_of([Sailed(2, 8e4, inf)]).criteria == ()


@pytest.mark.full
def test_the_study_is_made_of_a_forecast_of_several_times_and_refuses_others(tmp_path):
    path = tmp_path / "one.nc"
    synthetic.dataset(n_members=4).to_netcdf(path, engine="h5netcdf")
    done = invoke(
        [
            "experiment",
            "planning",
            "--ensemble",
            str(path),
            "-o",
            str(tmp_path / "out"),
            "--study",
            "changing",
            "--json",
            "-",
        ]
    )
    assert "expected a forecast of several dated times" in (done.output + str(done.exception))


def test_a_mission_meets_the_times_around_it():
    days = NOON + 24 * HOUR * np.arange(6)
    assert _around(days, int(days[2]) + HOUR, 86400.0) == slice(2, 5)
    assert _around(days, int(days[2]), 86400.0) == slice(2, 4)
    assert _around(days, int(days[5]) + HOUR, 86400.0) == slice(4, 7)
    assert _around(days[:2], int(days[0]), 1e7) == slice(0, 3)


def test_a_region_too_small_for_its_missions_is_said():
    with pytest.raises(ConfigError, match="no start and goal 500 km apart lie inside the region"):
        sail(series(), EstimatorConfig(), replace(JOB, crossing=(500e3, 600e3)), 1, 3)
