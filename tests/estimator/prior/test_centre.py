"""The moved centre of the prior: against its slow twin, on a truth like a member, and on one like none."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build_estimator
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import leave_out
from replay_kit.workflows.replay.scoring import scored_points
from tests import synthetic
from tests.estimator.runs import after, rows_of
from tests.reference import centre as slow

GIVEN = synthetic.ensemble(n_members=7, shape=(6, 7), levels=np.array([5.0, 90.0, 220.0]))
ESTIMATOR = build_estimator(GIVEN, EstimatorConfig(modes=None, sample_share=0.6))
VARIANCES, WEIGHTS = (0.0, 0.03, 0.1, 0.3), (0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3)


@pytest.mark.parametrize("count", [1, 5, 12])
def test_it_is_the_mixture_of_dense_gaussians(count):
    observations = synthetic.random_profiles(GIVEN.grid, count, seed=count)
    state = after(ESTIMATOR, observations)
    design, values = rows_of(ESTIMATOR, observations)
    prior, basis = ESTIMATOR.prior, ESTIMATOR.basis
    factor = prior.factor[:-1].reshape(len(prior.factor) - 1, -1)
    mean, sample = basis.mean_weights.ravel(), factor.T @ factor
    rest = prior.covariance() - ESTIMATOR.mean_amplitude.variance * np.outer(mean, mean) - sample
    expected = slow.moved(
        basis.member_anomalies.reshape(7, -1),
        mean,
        sample,
        rest,
        design,
        values - design @ prior.mean,
        count,
        VARIANCES,
        WEIGHTS,
        ESTIMATOR.mean_amplitude.kernels,
    )
    found = state.posterior.prior.moved
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert len(state.mean_amplitude.shares) == 7


def error(estimator, truth, n):
    at, state = scored_points(GIVEN.grid, truth), estimator.initial()
    for observation in random_observations(build_field(truth), n, 0.05, 3):
        state, _ = estimator.step(state, observation)
    return np.sqrt(np.mean((estimator.flow(state).velocity(*at.place) - at.velocity) ** 2))


def both(case, truth, n):
    """Errors with a moving centre, and with one that rests as members without anomalies do not move it."""
    moving = build_estimator(case.ensemble, EstimatorConfig(modes=None))
    still = np.repeat(moving.basis.member_weights[:1], 3, axis=0)
    resting = replace(moving, basis=replace(moving.basis, member_weights=still))
    return error(moving, truth, n), error(resting, truth, n)


def test_a_truth_near_a_member_is_found_sooner_and_others_hardly_later():
    case = leave_out(GIVEN, 2)
    near = replace(case.truth, velocity=0.9 * GIVEN.velocity[5:6] + 0.1 * case.truth.velocity)
    moving, resting = both(case, near, 3)
    assert moving < 0.9 * resting
    each = np.array([both(leave_out(GIVEN, k), leave_out(GIVEN, k).truth, 3) for k in range(7)])
    assert np.exp(np.mean(np.log(each[:, 0] / each[:, 1]))) < 1.03
