"""Replanning in twin missions: legs flown against closed forms and against the planner's own path, and the figures over missions."""

import math

import numpy as np
import pytest

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator import embed_member
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.legs import Leg, distance_to, fly_leg, measured, plan_legs
from replay_kit.studies.planning.replanning import summarise
from replay_kit.studies.planning.twin_missions import Outcome, ReplanRow, run_replanning
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.reachable import place_at
from replay_kit.studies.twins.vehicle import EPOCH_NS
from replay_kit.workflows.planning import MissionPlanner
from tests import synthetic
from tests.studies.twins.truths import CENTRE, make_truth

PLANNER = MissionPlanner.of(PlannerConfig(kind="mission", depth=300.0))
UNIFORM = build_field(
    make_truth(
        lambda east, north, depth: (0.12 + 0.0 * (east + depth), -0.07 + 0.0 * (east + depth))
    )
)


def test_a_leg_in_a_uniform_current_ends_where_the_velocities_add_up():
    leg = Leg(
        heading_deg=60.0, along=0.28, down=0.1, depths=(0.0, 300.0, 0.0, 200.0, 0.0), drift=700.0
    )
    flight = fly_leg(UNIFORM, np.array([2e3, -3e3]), EPOCH_NS, leg)
    under, current = 1000.0 / 0.1, np.array([0.12, -0.07])
    bearing = np.arctan2(*flight.through_water)
    # at the centre's meridian the axes are true; 2 km off they turn by 0.02 degrees
    assert np.rad2deg(bearing) == pytest.approx(60.0, abs=0.03)
    expected = np.array([2e3, -3e3]) + under * (flight.through_water + current) + 700.0 * current
    np.testing.assert_allclose(flight.place[-1], expected, atol=1e-6)
    np.testing.assert_allclose(flight.place[flight.surfaced], expected - 700.0 * current, atol=1e-6)
    assert flight.end_ns == EPOCH_NS + int((under + 700.0) * 1e9)
    assert np.hypot(*flight.through_water) == pytest.approx(0.28)


def test_a_leg_is_measured_where_it_went_and_its_mean_current_is_the_water_s():
    flight = fly_leg(
        UNIFORM, np.zeros(2), EPOCH_NS, Leg(200.0, 0.28, 0.1, (0.0, 300.0, 0.0), 900.0)
    )
    given = measured(UNIFORM, flight, 1e-6, np.random.default_rng(0))
    true = np.array(
        rotate_to_geographic(CENTRE, CENTRE.longitude, CENTRE.latitude, 0.12, -0.07)
    ).ravel()
    profiles = [one for one in given if isinstance(one, Observation)]
    assert len(profiles) == 10
    for profile in profiles:
        seen = np.isfinite(profile.velocity).all(axis=1)
        # the axes turn by some hundredths of a degree over the leg
        np.testing.assert_allclose(
            profile.velocity[seen], np.tile(true, (seen.sum(), 1)), atol=3e-4
        )
        assert seen.sum() > 10
    (mean,) = (one for one in given if isinstance(one, PathMean))
    np.testing.assert_allclose(mean.velocity, true, atol=1e-4)


def test_a_leg_out_of_the_truth_s_water_is_said():
    edge = np.array([UNIFORM.grid.east.max() - 1e3, 0.0])
    with pytest.raises(ForecastError, match="out of the truth's water"):
        fly_leg(UNIFORM, edge, EPOCH_NS, Leg(90.0, 0.28, 0.1, (0.0, 500.0) * 20))


def test_a_plan_made_on_the_truth_ends_where_it_says_when_it_is_flown_in_the_truth():
    truth = make_truth(rows=9, columns=9, cell=9000.0)
    field, flow = build_field(truth), embed_member(truth, 0, EstimatorConfig())
    begin = np.array([-1e4, -5e3])
    start, goal = place_at(field.grid, begin), place_at(field.grid, np.array([3e3, 7e3]))
    planned = plan_legs(PLANNER, flow, (start, goal), EPOCH_NS, 40)
    at, now, off = begin, EPOCH_NS, []
    for leg, end in zip(planned.legs, planned.ends, strict=True):
        flight = fly_leg(field, at, now, leg)
        at, now = flight.place[-1], flight.end_ns
        off.append(distance_to(field, at, end))
    # what the kernel's field cannot show of the truth, over 18 km
    assert max(off) < 10.0
    assert distance_to(field, at, goal) < 10.0 + planned.miss
    # no more legs than are left may be planned
    few = plan_legs(PLANNER, flow, (start, goal), EPOCH_NS, 2, planned)
    assert len(few.legs) <= 2
    assert few.miss > 5e3


@pytest.mark.full
def test_two_missions_end_nearer_to_the_goal_when_they_are_replanned():
    ensemble = synthetic.ensemble(seed=3, n_members=9, shape=(7, 8))
    config = RunConfig(estimator=EstimatorConfig(modes=20, sample_share=0.5))
    reported = []
    job = PlanningJob(("replanning",), replans=2, legs=4, depth=300.0)
    rows = run_replanning(
        [ensemble], config, job, (0, 4), PLANNER, lambda what, steps=1: reported.append(what)
    )
    assert [row.member for row in rows] == [0, 4]
    assert [row.seed for row in rows] == [0, 1]
    assert reported == ["replanning, mission 0, member 0", "replanning, mission 1, member 4"]
    for row in rows:
        assert row.replanned.miss < 0.5 * row.single.miss
        assert row.replanned.closest <= row.replanned.miss
        assert len(row.prediction_errors) == row.replanned.legs <= 6
        # the first leg is flown by the same plan in both
        assert row.prediction_errors[-1] < row.prediction_errors[0]


def flown(miss: float, hours: float) -> Outcome:
    return Outcome(miss, miss**0.5, hours * 3600.0, 5, "arrived")


def test_the_figures_count_every_mission_and_compare_times_only_where_both_arrive():
    pairs = [(1000.0, 100.0), (400.0, 200.0), (2000.0, 600.0), (450.0, 450.0)]
    hours = [(10.0, 9.0), (10.0, 12.0), (10.0, 5.0), (10.0, 10.0)]
    rows = [
        ReplanRow(0, 0, 1e4, 1e5, flown(a, p), flown(b, q), ())
        for (a, b), (p, q) in zip(pairs, hours, strict=True)
    ]
    found = summarise(rows)
    assert found["both_near"] == 2
    # ratios 0.1, 0.5, 0.3, 1.0
    assert found["ratio_median"] == pytest.approx(0.4)
    assert found["ratio_90"] == 1.0
    assert found["closest_ratio_median"] == pytest.approx((0.3**0.5 + 0.5**0.5) / 2.0)
    assert found["closest_ratio_90"] == 1.0
    assert found["time_ratio_median"] == pytest.approx(1.1)
    assert (found["single_near"], found["replanned_near"]) == (0.5, 0.75)
    assert (found["single_median"], found["replanned_median"]) == (725.0, 325.0)
    assert math.isnan(summarise([rows[0]])["time_ratio_median"])
