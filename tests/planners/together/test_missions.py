"""Who goes to which goal, and missions that keep apart, against all ways to assign and flights looked at densely."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
import shapely

from planners import MissionRequest, MissionSettings, plan_mission
from planners.several import (
    Motion,
    area_between,
    assign,
    motion_of,
    nearest_approach,
    plan_missions,
    share_of_nearer,
    times_to_goals,
)
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import place
from tests.planners.uncertain import static

SETTINGS = MissionSettings(depth=280.0, tolerance=400.0)


def request(begin, end):
    """A mission between two places [m]."""
    flow = static()
    return MissionRequest(place(flow, *begin, 0.0), (place(flow, *end, 0.0),), settings=SETTINGS)


CROSSING = request((-9e3, 0.0), (9e3, 0.0)), request((0.0, -9e3), (0.0, 9e3))


@pytest.mark.parametrize("shape", [(3, 3), (2, 4), (4, 2), (1, 1)])
def test_as_many_goals_as_can_be_are_reached_in_the_least_total_time(shape):
    rng, (count, goals) = np.random.default_rng(shape[0]), shape
    for _ in range(20):
        times = rng.uniform(1.0, 9.0, shape)
        times[rng.random(shape) < 0.4] = np.inf
        # a vehicle without a goal costs more than all times
        costs = np.hstack([np.minimum(times, 1e3), np.full((count, count), 1e3)])
        best = min(
            costs[range(count), one].sum() for one in permutations(range(goals + count), count)
        )
        found = sum(1e3 if goal is None else times[k, goal] for k, goal in enumerate(assign(times)))
        assert found == pytest.approx(best)


def test_a_front_is_at_a_goal_no_later_than_a_mission_and_never_at_one_behind_the_longest():
    flow, goals = static(), tuple(one.goals[0] for one in CROSSING)
    times = times_to_goals(flow, CROSSING, goals)
    for k, one in enumerate(CROSSING):
        assert times[k, k] <= 1.03 * plan_mission(flow, one).duration
    short = [replace(one, settings=replace(SETTINGS, max_duration=3600.0)) for one in CROSSING]
    assert np.isinf(times_to_goals(flow, short, goals)).all()


def test_the_least_distance_of_two_motions_is_that_of_a_dense_look():
    rng = np.random.default_rng(0)
    motions = []
    for n in (5, 9):
        times = np.sort(rng.uniform(0.0, 10.0, n))
        motions.append(Motion(times, rng.normal(size=(3, n)) + 1j * rng.normal(size=(3, n))))
    distances, when = nearest_approach(*motions)
    dense = np.linspace(-1.0, 11.0, 200_001)
    for k in range(3):
        apart = np.abs(
            np.subtract(*(np.interp(dense, one.times, one.places[k]) for one in motions))
        )
        assert distances[k] == pytest.approx(apart.min(), abs=1e-4)
        at = [np.interp(when[k], one.times, one.places[k]) for one in motions]
        assert abs(at[0] - at[1]) == pytest.approx(distances[k])


@pytest.mark.full
def test_one_of_two_goes_round_and_what_is_stated_is_what_the_tracks_show():
    flow = static()
    free = plan_missions(flow, (), CROSSING)
    assert [plan.status for plan in free.plans] == ["reached", "reached"]
    separation = 1.3 * free.nearness[0].distance
    apart = plan_missions(flow, (), CROSSING, separation)
    assert apart.nearness[0].distance >= separation > free.nearness[0].distance
    assert [plan.status for plan in apart.plans] == ["reached", "reached"]
    assert sum(one.duration for one in apart.plans) >= sum(one.duration for one in free.plans) - 1.0
    motions = [motion_of(plan, flow.grid.projection) for plan in apart.plans]
    assert nearest_approach(*motions)[0][0] == pytest.approx(apart.nearness[0].distance)
    # whoever goes round is not a matter of the order
    other = plan_missions(flow, (), CROSSING[::-1], separation)
    assert [one.duration for one in other.plans[::-1]] == pytest.approx(
        [one.duration for one in apart.plans], rel=1e-6
    )


def test_what_one_keeps_out_of_is_one_area_about_all_of_the_other_s_way():
    frame = static().grid.projection
    # short pieces in a wide buffer, beside which a sliver is left for every eighth of these ways
    for seed in range(25, 35):
        rng, times = np.random.default_rng(seed), np.arange(12.0)
        way = np.cumsum(rng.uniform(1.0, 60.0, 12)) + 1j * np.cumsum(rng.normal(0.0, 12.0, 12))
        stays, goes = (Motion(times, (way + off)[None]) for off in (0.0, 500.0))
        area = area_between(stays, goes, 7200.0, frame)
        ring = shapely.Polygon(np.column_stack(to_local(frame, *np.array(area.polygon).T)))
        away = shapely.distance(ring.exterior, shapely.points(way.real, way.imag))
        assert ring.is_valid
        assert 0.9 * 7200.0 < away.min() <= 7200.0


def test_a_separation_that_starts_or_goals_break_is_told_and_the_missions_stay():
    flow = static()
    near = CROSSING[0], request((-9e3, 300.0), (9e3, 5e3))
    made = plan_missions(flow, (), near, 2000.0)
    assert made.nearness[0].distance <= 300.0 + 1e-3
    assert all(plan.status == "reached" for plan in made.plans)


def test_shares_of_samples_are_those_of_flights_together():
    flow = static()
    samples = flow.sample(3, 0)
    joint = plan_missions(flow, samples, CROSSING)
    assert joint.nearness[0].share == 0.0
    shares = [share_of_nearer(flow, samples, joint, (0, 1), near) for near in (1e3, 3e3, 1e6)]
    assert sorted(shares) == shares
    assert shares[-1] == 1.0
    # a sample flown by itself counts for one
    each = [share_of_nearer(flow, [one], joint, (0, 1), 3e3) for one in samples]
    assert np.mean(each) == pytest.approx(shares[1])


def test_after_the_deadline_of_all_no_way_round_is_tried():
    late = [replace(one, settings=replace(SETTINGS, deadline=0.0)) for one in CROSSING]
    joint = plan_missions(static(), (), late, 3000.0)
    assert joint.requests == tuple(late)
    assert all("the time limit" in plan.message for plan in joint.plans)
