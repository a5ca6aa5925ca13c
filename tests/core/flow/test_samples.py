"""Samples of an estimate: drawn from one factor of its covariance, whatever its rank."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import EstimatorError


def test_the_factor_is_that_of_the_covariance_and_is_kept(flow):
    np.testing.assert_allclose(
        flow.weight_factor @ flow.weight_factor.T, flow.weight_cov, atol=1e-14
    )
    assert flow.weight_factor is flow.weight_factor
    first, second = flow.sample(2, 5), flow.sample(2, 5)
    np.testing.assert_array_equal([one.latent for one in first], [one.latent for one in second])
    # its twin: each weight of each sample is a sum over the factor's columns
    weights = flow.weight_factor @ np.random.default_rng(5).standard_normal(
        (flow.weight_factor.shape[1], 2)
    )
    for k, sample in enumerate(first):
        for level in range(flow.levels.size):
            own = weights[level * flow.n_modes : (level + 1) * flow.n_modes, k]
            np.testing.assert_allclose(
                sample.latent[:, level],
                flow.latent[:, level] + flow.modes @ own,
                rtol=1e-12,
                atol=1e-15,
            )


@pytest.mark.parametrize("rank", [0, 2])
def test_a_covariance_without_full_rank_has_a_factor(flow, rank):
    size = flow.weight_cov.shape[0]
    half = np.random.default_rng(rank).standard_normal((size, rank))
    low = replace(flow, covariance=half @ half.T)
    factor = low.weight_factor
    assert factor.shape[1] <= rank + 1
    np.testing.assert_allclose(factor @ factor.T, half @ half.T, atol=1e-12)
    if rank == 0:
        np.testing.assert_array_equal(low.sample(1, 0)[0].latent, flow.latent)


def test_a_covariance_that_is_not_a_number_is_refused(flow):
    with pytest.raises(EstimatorError, match="covariance is not a number everywhere"):
        replace(flow, covariance=np.full_like(flow.weight_cov, np.nan)).sample(3, 0)
