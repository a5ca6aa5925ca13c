"""Plans in a current beside the estimate: what is expected of it moves the plan, what is not known of it spreads the samples."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, mission_odds, plan_mission
from planners.odds.flights import fly_mission
from planners.odds.mission import currents_of_estimate as currents_around
from planners.simulation.currents import (
    LocalSample,
    currents_of_samples,
    is_noticed,
    local_notes,
)
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.workflows.planning.currents import KnownCurrent
from tests.planners.flow_samples import place, uniform_flow
from tests.synthetic_flow import with_weights
from tests.workflows.planning.test_currents import evolving

HOUR = 3600 * 10**9
NOON = 1_767_268_800 * 10**9
BEGIN, SECONDS = NOON + 2 * HOUR, 20 * 3600.0


def local(mean, std, cov=0.0) -> LocalCurrent:
    one = np.ones(1)
    return LocalCurrent(
        one, std * one, 24.0 * 3600.0 * one, np.array([mean]), cov * np.eye(2)[None], NOON
    )


def estimate(beside) -> FlowEstimate:
    flow = uniform_flow(0.05, 0.0)
    modes = flow.latent[:, :1]
    covariance = 1e-4 * np.eye(flow.levels.size)
    return with_weights(replace(flow, time_ns=NOON, local=beside), modes, covariance)


def water(currents, time_ns, count=1):
    """The current of each flow at a place and a time."""
    weights = currents.weights(np.array([20.0]))[0]
    return currents.velocity(np.zeros((count, 2)), weights, currents.clock(time_ns))


def test_an_expected_current_is_planned_with_and_forgotten():
    known = KnownCurrent((estimate(local([0.0, 0.1], 0.1)),), 6 * 3600.0)
    flows = known.flow(BEGIN, SECONDS)
    assert known.changes
    assert len(flows) > 1
    for flow in flows:
        np.testing.assert_allclose(
            flow.velocity(0.0, 0.0, 20.0) - known.first.velocity(0.0, 0.0, 20.0),
            known.local.velocity(flow.time_ns),
            atol=2e-3,
        )
    (note,) = local_notes(known.local, NOON)
    assert "10 cm/s towards 0 degrees" in note
    assert "plan and the samples" in note


@pytest.mark.parametrize("beside", [None, local([0.004, 0.0], 0.0)])
def test_without_an_expected_current_the_estimate_is_planned_on_as_it_is(beside):
    known = KnownCurrent((estimate(beside),), 6 * 3600.0)
    assert known.flow(BEGIN, SECONDS) is known.first
    assert local_notes(known.local, NOON) == ()


@pytest.mark.parametrize(("east", "noticed"), [(0.009, False), (0.011, True)])
def test_a_centimetre_a_second_beside_the_estimate_is_planned_with(east, noticed):
    assert is_noticed(local([east, 0.0], 0.0)) == noticed


@pytest.mark.parametrize("make", [estimate, lambda beside: replace(evolving(), local=beside)])
@pytest.mark.parametrize("mean", [[0.0, 0.0], [0.05, -0.08]])
def test_samples_have_the_mean_and_the_spread_of_estimate_and_current_beside_it(make, mean):
    beside, count = local(mean, 0.1, 1e-3), 400
    known = KnownCurrent((make(beside),), 6 * 3600.0)
    flow, samples = known.flow(BEGIN, SECONDS), known.samples(BEGIN, SECONDS, count, 3)
    currents = currents_around(flow, samples)
    alone = KnownCurrent((make(None),), 6 * 3600.0)
    without = currents_around(alone.flow(BEGIN, SECONDS), alone.samples(BEGIN, SECONDS, count, 3))
    for time_ns in (BEGIN, BEGIN + 7 * HOUR, BEGIN + 18 * HOUR):
        difference = water(currents, time_ns, count) - water(without, time_ns, count)
        error = beside.standard_error(time_ns)
        np.testing.assert_allclose(
            difference.mean(axis=0),
            beside.velocity(time_ns),
            atol=4.0 * error / np.sqrt(count) + 2e-3,
        )
        np.testing.assert_allclose(difference.std(axis=0), error, rtol=0.2)
    shifted = currents.since(BEGIN)
    np.testing.assert_allclose(
        water(shifted.since(0), 0, count), water(currents, BEGIN, count), rtol=1e-9
    )


def test_odds_and_ellipses_know_of_it():
    sure, unsure = (
        KnownCurrent((estimate(beside),), 6 * 3600.0)
        for beside in (None, local([0.0, 0.0], 0.1, 0.01))
    )
    request = MissionRequest(
        place(sure.first, -4e3, 0.0, 0.0),
        (place(sure.first, 3e3, 0.0, 0.0),),
        settings=MissionSettings(depth=390.0),
        start_time_ns=BEGIN,
    )
    plan = plan_mission(sure.first, request)
    widths = []
    for known in (sure, unsure):
        drawn = known.samples(BEGIN, SECONDS, 30, 1)
        odds = mission_odds(known.first, drawn, plan, request)
        ends = fly_mission(drawn, plan).place[:, -1]
        widths.append((odds.next_surfacing[2], ends.std(axis=0).min()))
    hours = plan.duration / 3600.0
    assert widths[1][0] > widths[0][0] + 90.0 * plan.surfacing_times[0] / 3600.0
    assert widths[1][1] > widths[0][1] + 90.0 * hours


def test_courses_that_do_not_go_together_are_refused():
    flow, times = uniform_flow(0.1, 0.0), np.array([NOON, BEGIN])
    with_course = LocalSample(replace(flow, time_ns=NOON), times, np.zeros((2, 2)))
    with pytest.raises(PlanError, match="draw all of them together"):
        currents_of_samples([with_course, replace(flow, time_ns=NOON)])
    with pytest.raises(PlanError, match="draw all of them together"):
        currents_of_samples([with_course, replace(with_course, times_ns=times + HOUR)])
    with pytest.raises(PlanError, match="needs the time"):
        currents_of_samples([replace(with_course, flow=replace(flow, time_ns=None))])
