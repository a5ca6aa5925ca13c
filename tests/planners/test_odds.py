"""Odds, stated and flown by another pilot in other draws; missions ranked by them; how forgiving a leg is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from planners import (
    MissionRequest,
    MissionSettings,
    Mooring,
    fly_mission,
    mission_odds,
    next_surfacing,
    plan_by_odds,
    plan_mission,
    with_odds,
)
from planners.odds.mission import currents_of_estimate
from planners.odds.rank import most_violations_allowed, passes_binomial_test
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import share_interval
from replay_kit.core.surfacing import Ellipse
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
    request_between,
    uniform_flow,
)
from tests.planners.hazardous import harm_done, random_mission
from tests.planners.pilot import drawn, fly_steered
from tests.planners.uncertain import uncertain

FLOW = uniform_flow(0.02, 0.0)
START, GOAL = place(FLOW, -5e3, -3e3), place(FLOW, 6e3, -3e3)
SETTINGS = MissionSettings(depth=390.0, legs=5)
FREE = MissionRequest(START, (GOAL,), settings=SETTINGS)
EDDIES = uncertain(eddying_flow(7), 0.08)
AMONG = request_between(
    EDDIES, (-8e3, -5e3), (7e3, 5e3), settings=MissionSettings(depth=300.0, surface_time=600.0)
)
COUNT = 100


@cache
def judged(seed):
    """A random mission among hazards with its odds, and flights of it by another pilot in other draws."""
    mission = random_mission(seed, speeds=(0.03, 0.25))
    flow, radius = mission.flow[0], (250.0, 500.0, 1000.0)[seed % 3]
    settings = replace(mission.request.settings, radius=radius)
    request = replace(mission.request, settings=settings)
    plan = plan_mission(flow, request)
    odds = mission_odds(flow, flow.sample(COUNT, seed), plan, request)
    flown = fly_steered(flow, drawn(flow, COUNT, 500 + seed), plan, radius, odds.deadline)
    return flow, plan, odds, flown


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(40), marks=pytest.mark.full)])
def test_odds_and_times_that_are_stated_are_those_flown(seeds):
    differences, variances, outside, in_time = [], [], 0, []
    for seed in seeds:
        _, _, odds, flown = judged(seed)
        share = float(np.mean(np.isfinite(flown.when)))
        mean = 0.5 * (share + odds.reached)
        # half a flight of either beside the interval of the difference, as shares are whole flights
        variances.append(2.0 * mean * (1.0 - mean) / COUNT)
        interval = 1.96 * np.sqrt(variances[-1]) + 1.0 / COUNT
        differences.append(share - odds.reached)
        outside += abs(differences[-1]) > interval
        if np.isfinite(odds.arrival_90_percent):
            in_time.append(np.mean(flown.when <= odds.arrival_90_percent))
    # of few missions the sampling error of both sides
    many = len(seeds) > 10
    error = 2.5 * np.sqrt(np.sum(variances)) / len(seeds)
    assert abs(np.mean(differences)) < (0.02 if many else error)
    assert outside <= len(seeds) // 10
    error = 2.5 * np.sqrt(2.0 * 0.9 * 0.1 / COUNT / len(in_time))
    assert abs(np.mean(in_time) - 0.9) < (0.03 if many else error)


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(40), marks=pytest.mark.full)])
def test_ellipses_hold_nine_of_ten_surfacings_of_other_draws(seeds):
    def held(flow, ellipse, places):
        at = np.column_stack(to_geographic(flow.grid.projection, *places.T))
        around = Ellipse(*ellipse.tolist())
        return np.mean([around.holds(*one) for one in at.tolist()])

    first, each = [], []
    for seed in seeds:
        flow, _, odds, flown = judged(seed)
        first.append(held(flow, odds.next_surfacing, flown.up[0]))
        ends = [flown.ends[min(k, len(flown.ends) - 1)] for k in range(len(odds.ellipses))]
        each += [held(flow, *pair) for pair in zip(odds.ellipses, ends, strict=True)]
    assert 0.87 < np.mean(first) < 0.93
    assert 0.87 < np.mean(each) < 0.93


GOALS = {
    "there and back": ((6e3, 4e3, 0.0), (-8e3, -6e3, 0.0)),
    "three": ((0.0, 5e3, 0.0), (5e3, 0.0, 0.0), (-2e3, -2e3, 0.0)),
    "passed below": ((0.0, 3e3, 150.0), (6e3, 4e3, 0.0)),
    "two dives": ((6e3, 4e3, 0.0),),
}


@pytest.mark.parametrize("name", GOALS)
def test_a_pilot_who_is_right_flies_the_plan(name):
    flow = eddying_flow(3, speed=0.1)
    settings = MissionSettings(depth=250.0, surface_time=300.0, yos=2 if name == "two dives" else 1)
    request = request_between(flow, (-8e3, -6e3), *GOALS[name], settings=settings)
    plan = plan_mission(flow, request)
    odds = mission_odds(flow, [flow] * 3, plan, request)
    assert plan.status == "reached"
    assert (odds.reached, odds.safe, odds.violations) == (1.0, 1.0, {})
    assert odds.arrival_median == pytest.approx(plan.duration, rel=0.02)
    np.testing.assert_allclose(odds.flights.met[0], plan.goal_times, rtol=0.1)


def test_a_wider_radius_and_a_later_deadline_never_cost_odds_or_headings():
    plan = plan_mission(EDDIES, AMONG)
    samples, before = EDDIES.sample(24, 1), (0.0, np.zeros((len(plan.headings_deg), 2)))
    for radius, by in ((200.0, 1.0), (600.0, 1.0), (2e3, 1.0), (2e3, 1.3)):
        settings = replace(plan.settings, radius=radius, arrive_by=by * plan.duration)
        odds = mission_odds(EDDIES, samples, replace(plan, settings=settings), AMONG)
        wide = np.nan_to_num(odds.forgiving)
        assert odds.reached >= before[0]
        assert np.all(wide[:, 0] <= before[1][:, 0])
        assert np.all(wide[:, 1] >= before[1][:, 1])
        before = odds.reached, wide
    assert odds.reached > 0.9
    # a heading that leads back at first costs more than the one dive that is left
    assert wide[-1].tolist() == [-90.0, 90.0] or wide[0, 1] - wide[0, 0] > 0.0
    with pytest.raises(PlanError, match="no samples"):
        mission_odds(EDDIES, [], plan, AMONG)


def test_below_the_deepest_level_the_current_is_as_there_and_its_error_grows_by_the_shear():
    samples, at = EDDIES.sample(400, 3), np.array([2e3, -1e3])
    deeper = currents_of_estimate(EDDIES, samples, 600.0)
    places = np.tile(at, (400, 1))
    upper, last, below = (
        deeper.velocity(places, deeper.weights(np.array([z]))[0], 0.0)
        for z in (230.0, 400.0, 600.0)
    )
    np.testing.assert_allclose(last, [one.velocity(*at, 400.0) for one in samples], atol=1e-9)
    apart = (below - last) / ((last - upper) * 200.0 / 170.0)
    np.testing.assert_allclose(apart[:, 0], apart[:, 1], rtol=1e-6)
    assert abs(np.mean(apart)) < 0.15
    assert np.std(apart) == pytest.approx(1.0, rel=0.1)


def test_the_next_surfacing_alone_is_that_of_the_odds():
    plan, samples = plan_mission(EDDIES, AMONG), EDDIES.sample(12, 1)
    odds = mission_odds(EDDIES, samples, plan, AMONG)
    alone = next_surfacing(EDDIES, samples, plan, AMONG)
    np.testing.assert_array_equal(alone, odds.next_surfacing)
    assert odds.ellipses.shape == (len(plan.headings_deg), 5)


def test_flights_are_safe_that_cross_nothing_at_steps_of_a_metre():
    harmed = []
    # one enters areas, one goes below the bottom beside an island
    for seed in (7, 10):
        mission = random_mission(seed, speeds=(0.15, 0.3))
        flow = mission.flow[0]
        plan = plan_mission(flow, mission.request)
        odds = mission_odds(flow, flow.sample(30, seed), plan, mission.request)
        flights = odds.flights
        tracks = np.concatenate([flights.place, flights.depth[..., None]], axis=-1)
        harms = [harm_done(mission, track) for track in tracks]
        harmed.append(np.mean([one is not None for one in harms]))
        # the bottom between four points counts as the shallowest of them
        assert 1.0 - odds.safe > harmed[-1] - 0.04
        for area in mission.request.no_go:
            share = np.mean([one == area.name for one in harms])
            assert odds.violations.get(area.name, 0.0) >= share - 1e-9
            assert share > 0.0 or area.name not in odds.violations
    assert min(harmed) > 0.0


def test_near_a_mooring_those_arrive_that_stay_within_its_radius():
    flow = uncertain(eddying_flow(7), 0.02)
    request = request_between(flow, (0.0, 0.0), (0.0, 0.0), settings=replace(SETTINGS, legs=None))
    plan = plan_mission(flow, replace(request, shape=Mooring(3e3, 12 * 3600.0)))
    samples = flow.sample(20, 1)
    odds = mission_odds(flow, samples, plan, request)
    for radius, share in ((odds.miss_median, 0.5), (odds.miss_90_percent, 0.9)):
        within = replace(plan, shape=Mooring(radius, 12 * 3600.0))
        assert mission_odds(flow, samples, within, request).reached == pytest.approx(share)


def _drawn(n, seed, speed=0.01):
    rng = np.random.default_rng(seed)
    parts = np.stack([uniform_flow(speed, 0.0).latent, uniform_flow(0.0, speed).latent], axis=-1)
    return [replace(FLOW, latent=FLOW.latent + parts @ rng.standard_normal(2)) for _ in range(n)]


def test_margins_widen_until_the_samples_keep_clear():
    area = forbidden(FLOW, -0.7e3, -6e3, 0.7e3, -1e3)
    asked, searched, fresh = replace(FREE, no_go=(area,)), _drawn(20, 1, 0.05), 60
    plan, narrow = plan_by_odds(FLOW, searched, asked, 0.1), plan_mission(FLOW, asked)
    wide, before = (
        mission_odds(FLOW, _drawn(fresh, 2, 0.05), one, asked) for one in (plan, narrow)
    )
    assert plan.status == narrow.status == "reached"
    assert before.safe < 0.9 <= wide.safe
    assert before.violations == {"range": pytest.approx(1.0 - before.safe)}
    assert plan.statistics["extra_margin_m"] > 0.0
    later = (plan.duration - narrow.duration) / 3600.0
    assert plan.statistics["risk_costs_h"] == pytest.approx(later, abs=1e-6)


def test_more_legs_are_taken_where_clearly_more_arrive():
    settings = replace(AMONG.settings, arrive_by=1.1 * plan_mission(EDDIES, AMONG).duration)
    asked, searched, fresh = (
        replace(AMONG, settings=settings),
        *(EDDIES.sample(24, k) for k in (1, 2)),
    )
    quickest, best = plan_mission(EDDIES, asked), plan_by_odds(EDDIES, searched, asked)
    odds = [mission_odds(EDDIES, fresh, one, asked).reached for one in (quickest, best)]
    assert odds[1] >= odds[0] - 0.05
    assert best.statistics["odds_costs_h"] >= 0.0
    sure = uncertain(eddying_flow(7), 0.001)
    same = plan_by_odds(sure, sure.sample(10, 1), AMONG)
    assert same.statistics["odds_costs_h"] == 0.0
    np.testing.assert_array_equal(same.headings_deg, plan_mission(sure, AMONG).headings_deg)


@pytest.mark.parametrize(("count", "most"), [(20, 0), (200, 15), (5, 0)])
def test_few_samples_that_trespass_tell_little(count, most):
    assert most_violations_allowed(count, 0.1) == most
    assert passes_binomial_test(most, count, 0.1)
    assert not passes_binomial_test(most + 1, count, 0.1)


def test_samples_that_change_are_flown_as_they_change_and_on_the_clock_of_the_mission():
    day = 86400 * 10**9
    first, other = replace(FLOW, time_ns=day), replace(uniform_flow(-0.05, 0.04), time_ns=2 * day)
    changing, begin = [first, other], day + day // 4
    request = replace(FREE, start_time_ns=begin)
    plan = plan_mission(changing, request)
    # in the changing current that was planned on a mission with held headings arrives; in the first one alone it does not
    still = [first, replace(first, time_ns=2 * day)]
    told, frozen = (fly_mission([sample], plan)[1][0, 0] for sample in (changing, still))
    assert told < 50.0 < 500.0 < frozen
    steered = mission_odds(changing, [changing], plan, request)
    assert steered.miss_median < 100.0
    # the same where the clock of the samples begins later than that of the estimate
    middle = replace(first, latent=0.9 * first.latent + 0.1 * other.latent, time_ns=day + day // 10)
    later = mission_odds(changing, [[middle, other]], plan, request)
    assert later.miss_median == pytest.approx(steered.miss_median, abs=1.0)
    alien = [replace(eddying_flow(1), time_ns=time) for time in (day, 2 * day)]
    for samples, words in (
        ([changing, changing[1:]], "sample 1 holds for other times"),
        ([alien], "not on the nodes"),
    ):
        with pytest.raises(PlanError, match=words):
            mission_odds(changing, samples, plan, request)


def test_the_interval_of_a_share_holds_the_probabilities_under_which_it_is_not_unlikely():
    # the ends solve |share - p| = 1.645 sqrt(p (1 - p) / n)
    for share, count in ((0.45, 40), (1.0, 40), (0.0, 7), (0.5, 1)):
        p = np.linspace(0.0, 1.0, 100_001)
        held = p[np.abs(share - p) <= 1.6448536 * np.sqrt(p * (1.0 - p) / count) + 1e-12]
        assert share_interval(share, count) == pytest.approx((held[0], held[-1]), abs=2e-5)


@pytest.mark.parametrize(
    ("reached", "safe", "status"),
    [(0.95, 1.0, "reached"), (0.5, 1.0, "unreachable"), (0.95, 0.8, "unsafe")],
)
def test_flights_that_arrive_decide_where_the_plan_itself_misses(reached, safe, status):
    plan = plan_mission(FLOW, FREE)
    odds = mission_odds(FLOW, [FLOW] * 3, plan, FREE)
    missed, found = replace(plan, status="unreachable"), replace(odds, reached=reached, safe=safe)
    assert with_odds(missed, found, 0.9, 0.1).status == status
