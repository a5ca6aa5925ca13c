"""The spread over few members, by hand: every estimator's prior divides by one less than their number.

Members are one field times 1, 2 and 6, so the variance is ((1 - 3)^2 + (2 - 3)^2 + (6 - 3)^2) / 2 = 7 times the field's square; divided
by the number of members it would be 4.67.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planners.mission.flights import surfacing_ellipses
from planners.mission.solve.optimum import SafetyMargin, tolerance_factor
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build_estimator
from replay_kit.estimator.baselines.whole_flows import build_naive
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.basis.slices import ensemble_slices
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.prior.hybrid import (
    PriorSettings,
    diagonal_prior,
    hybrid_prior,
)
from tests import synthetic

TIMES = np.array([1.0, 2.0, 6.0])
VARIANCE = 7.0
ONE = synthetic.ensemble(n_members=2, shape=(4, 5), levels=np.array([5.0, 90.0]))
MEMBERS = replace(ONE, velocity=TIMES[:, None, None, None, None] * ONE.velocity[:1])
FIELD = ensemble_slices(MEMBERS)[0]
PLAIN = EstimatorConfig(sample_share=1.0, shift_distance=0.0, mean_variance=0.0)


def test_the_paper_s_prior():
    weights = TIMES[:, None, None] * np.array([[[1.0, -2.0], [0.5, 3.0]]])
    prior = diagonal_prior(weights)
    np.testing.assert_allclose(prior.mean, [3.0, -6.0, 1.5, 9.0])
    np.testing.assert_allclose(prior.variance, [[7.0, 28.0], [1.75, 63.0]])


def test_the_sample_part_of_the_default_prior():
    weight = np.array([[1.0, -2.0], [0.5, 3.0]])
    modes = ShiftedModes.by(np.eye(4)[:, :2], np.zeros((2, 2)), 0.0)
    prior = hybrid_prior(TIMES[:, None, None] * weight, modes, PriorSettings(1.0, 0.0, 1.0))
    np.testing.assert_allclose(
        prior.covariance(), VARIANCE * np.outer(weight.ravel(), weight.ravel())
    )


@pytest.mark.parametrize("evolving", [False, True])
def test_the_estimate_before_any_observation(evolving):
    estimator = (
        build_evolving([MEMBERS], PLAIN, TimeConfig(scale="static"))
        if evolving
        else build_estimator(MEMBERS, PLAIN)
    )
    first, second, _ = estimator.basis.member_weights
    field = (second - first).ravel()
    np.testing.assert_allclose(
        estimator.flow(estimator.initial()).weight_cov,
        VARIANCE * np.outer(field, field),
        atol=1e-10,
    )


def test_the_naive_filter():
    naive = build_naive(MEMBERS, EstimatorConfig())
    variance = np.einsum("ij,i...,j...->...", naive.initial().cov, naive.velocity, naive.velocity)
    np.testing.assert_allclose(variance, VARIANCE * FIELD**2, atol=1e-12)


def test_the_margin_of_a_plan_for_samples():
    """Three flights that are off by 1, 2 and 6 m towards a boundary."""
    deviations = np.zeros((3, 1, 2))
    deviations[:, 0, 0] = TIMES
    margin = SafetyMargin(deviations, 0.9, 0.5).margins(np.array([[[1.0, 0.0]]]))
    assert margin == pytest.approx(3.0 + tolerance_factor(3, 0.9) * np.sqrt(VARIANCE) + 0.5)


def test_the_ellipse_of_a_surfacing():
    """Three flights that surface 1, 2 and 6 km east, and as far north, of a place: Hotelling's factor of three is the root of 264."""
    place = 1e3 * np.stack([TIMES, TIMES], axis=1)[:, None]
    flights = SimpleNamespace(place=place, time=np.array([0.0]), projection=MEMBERS.grid.projection)
    ((_, _, major, minor, _),) = surfacing_ellipses(
        flights, SimpleNamespace(surfacing_times=np.array([0.0]))
    )
    assert major == pytest.approx(np.sqrt(264.0) * 1e3 * np.sqrt(2.0 * VARIANCE))
    assert minor == pytest.approx(0.0, abs=0.1)
