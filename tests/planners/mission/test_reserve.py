"""Missions for the odds: more legs where more samples arrive with them, and the quickest mission where none do."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, Pilot, fly_scenarios, plan_for_odds, plan_mission
from replay_kit.core.plan import share_interval
from tests.planners.flow_samples import eddying_flow, request_between
from tests.planners.uncertain import uncertain

FLOW = uncertain(eddying_flow(7), 0.08)
REQUEST = request_between(
    FLOW, (-8e3, -5e3), (7e3, 5e3), settings=MissionSettings(depth=300.0, surface_time=600.0)
)


def arrives(plan, samples):
    return fly_scenarios(FLOW, samples, plan, pilot=Pilot()).succeeded


@pytest.mark.full
def test_more_legs_are_taken_where_more_samples_arrive_also_of_fresh_ones():
    searched, fresh = FLOW.sample(16, 1), FLOW.sample(40, 2)
    quickest, odds = plan_mission(FLOW, REQUEST), plan_for_odds(FLOW, searched, REQUEST)
    assert arrives(odds, searched) > arrives(quickest, searched) + 0.04
    assert arrives(odds, fresh) > arrives(quickest, fresh) + 0.1
    assert len(odds.headings_deg) > len(quickest.headings_deg)
    assert odds.status == "reached"
    later = (odds.duration - quickest.duration) / 3600.0
    assert odds.statistics["odds_costs_h"] == pytest.approx(later)
    # an arrival after the latest one does not count, and no plan lasts longer
    asked = replace(REQUEST.settings, arrive_by=quickest.duration * 1.001)
    asked = replace(asked, max_duration=asked.arrive_by)
    hurried = plan_for_odds(FLOW, searched, replace(REQUEST, settings=asked))
    assert hurried.duration <= asked.arrive_by
    by_then = fly_scenarios(FLOW, searched, hurried, pilot=Pilot())
    assert by_then.reached < arrives(odds, searched)
    assert not by_then.arrival_90_percent <= asked.arrive_by


def test_where_all_arrive_or_the_number_of_legs_is_given_the_quickest_mission_stays():
    sure = uncertain(eddying_flow(7), 0.001)
    quickest = plan_mission(sure, REQUEST)
    odds = plan_for_odds(sure, sure.sample(10, 1), REQUEST)
    assert odds.statistics["odds_costs_h"] == 0.0
    np.testing.assert_array_equal(odds.headings_deg, quickest.headings_deg)
    given = replace(REQUEST, settings=replace(REQUEST.settings, legs=len(quickest.headings_deg)))
    fixed = plan_for_odds(FLOW, FLOW.sample(10, 1), given)
    assert len(fixed.headings_deg) == len(quickest.headings_deg)


def test_the_interval_of_a_share_holds_the_probabilities_under_which_it_is_not_unlikely():
    # the ends solve |share - p| = 1.645 sqrt(p (1 - p) / n)
    for share, count in ((0.45, 40), (1.0, 40), (0.0, 7), (0.5, 1)):
        p = np.linspace(0.0, 1.0, 100_001)
        held = p[np.abs(share - p) <= 1.6448536 * np.sqrt(p * (1.0 - p) / count) + 1e-12]
        assert share_interval(share, count) == pytest.approx((held[0], held[-1]), abs=2e-5)
