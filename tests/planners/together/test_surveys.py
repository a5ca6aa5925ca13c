"""A box that several vehicles survey: the search's errors against those of all rows at once, and its bound against the best found."""

from dataclasses import replace

import numpy as np
import pytest

from planners.learning.maps import mapping_of, plan_map
from planners.learning.rows import rows_at, stacked
from planners.learning.values import Box, LearnRequest, LearnSettings, OtherProfiles
from planners.together.surveys import _one_more, plan_joint_survey
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic
from tests.planners.flow_samples import place
from tests.planners.learning.scenes import DEPTH, static, through_time

SETTINGS = LearnSettings(depth=DEPTH, samples=30)


def box_of(flow):
    """A box in the middle of the region."""
    west, south = to_geographic(flow.grid.projection, -20e3, -15e3)
    east, north = to_geographic(flow.grid.projection, 20e3, 15e3)
    return Box(float(west), float(south), float(east), float(north))


def asked(flow, *begins):
    """Requests of vehicles that begin at some places [m]."""
    begin_ns = flow.time_ns or 0
    return [
        LearnRequest(
            place(flow, *one, 0.0), (), settings=SETTINGS, profiles=3, start_time_ns=begin_ns
        )
        for one in begins
    ]


@pytest.fixture(
    scope="module", params=["static", pytest.param("through time", marks=pytest.mark.full)]
)
def made(request):
    """A joint survey of two vehicles that begin side by side, and its flow."""
    flow = static() if request.param == "static" else through_time()
    return flow, plan_joint_survey(flow, asked(flow, (-5e3, 0.0), (-4e3, 500.0)), box_of(flow))


def test_together_they_leave_less_than_each_for_itself_and_lawn_mowers(made):
    _, joint = made
    predicted = {one.name: one.predicted for one in joint.candidates}
    assert joint.after == predicted["this plan"] == joint.plans[1].after
    assert joint.after < predicted["each for itself"] < joint.before
    assert joint.after < predicted["lawn-mowers"]
    assert "at least" in joint.plans[0].message


def test_the_error_is_that_of_one_vehicle_whose_others_profiles_are_given(made):
    flow, joint = made
    request = asked(flow, (-5e3, 0.0))[0]
    one, other = joint.plans
    middles = []
    before = (other.request.start.longitude, other.request.start.latitude, 0.0)
    for leg in other.legs:
        after = (*leg.ends_at, leg.ends_s)
        middles.append([0.5 * (a + b) for a, b in zip(before, after, strict=True)])
        before = after
    longitude, latitude, seconds = np.array(middles).T
    times = (flow.time_ns + seconds * 1e9).astype(np.int64)
    alone = plan_map(
        flow, replace(request, others=OtherProfiles(longitude, latitude, times)), box_of(flow)
    )
    # its search may find another way, about as good
    assert alone.before == pytest.approx(one.before, rel=2e-3)
    assert joint.after < 1.05 * alone.after


def test_the_bound_holds_for_what_is_found(made):
    _, joint = made
    assert 0.0 < joint.share_of_bound < 1.0


def test_the_worth_of_one_more_profile_is_that_of_all_rows_at_once():
    flow = static()
    _, mapping, _ = mapping_of(flow, asked(flow, (0.0, 0.0))[0], box_of(flow))
    rng = np.random.default_rng(0)
    measured = rows_at(mapping.known, rng.uniform(-15e3, 15e3, (4, 2)), np.zeros(4))
    places = rng.uniform(-15e3, 15e3, (5, 2))
    gains = _one_more(mapping, measured, places, 0.0)
    before = float(mapping.left_by(measured)) ** 2
    for at, gain in zip(places, gains, strict=True):
        more = stacked(rows_at(mapping.known, at[None], np.zeros(1)), measured)
        assert gain == pytest.approx(before - float(mapping.left_by(more)) ** 2, rel=1e-6)


def test_vehicles_that_differ_in_more_than_their_start_are_refused():
    flow = static()
    one, other = asked(flow, (0.0, 0.0), (5e3, 0.0))
    with pytest.raises(PlanError, match="same settings"):
        plan_joint_survey(flow, [one, replace(other, profiles=4)], box_of(flow))
    with pytest.raises(PlanError, match="two vehicles or more"):
        plan_joint_survey(flow, [one], box_of(flow))
