"""The estimator against a Kalman filter that nobody here wrote: filterpy's."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.estimator import build_estimator
from tests.estimator.baselines.small import DEPTHS, GRID, SMALL, STD, profiles
from tests.estimator.runs import run
from tests.reference.lattice import matrix as functions_at


def uncompressed_rows(estimator, place):
    """H of one profile, all east then all north."""
    basis = estimator.basis
    weights = depth_weights(DepthFunctions("hat", 1.0), DEPTHS, GRID.levels)
    row = functions_at(basis.horizontal, place[None])
    design = np.vstack([np.kron(weights, row[c] @ basis.modes) for c in range(2)])
    error = np.hypot(
        STD, np.interp(DEPTHS, GRID.levels, basis.local_error(place[None], basis.truncation_std)[0])
    )
    return design, (weights @ (row @ basis.offset).T).T.ravel(), np.tile(error, 2)


def test_filterpy_s_kalman_filter():
    config = EstimatorConfig(modes=12, mean_variance=0.1)
    observations, places, values = profiles(4)
    estimator = build_estimator(SMALL, config)
    state, said = run(estimator, observations)
    theirs = KalmanFilter(dim_x=state.mean.size, dim_z=2 * DEPTHS.size)
    theirs.x, theirs.P = estimator.prior.mean[:, None].copy(), estimator.prior.covariance().copy()
    for place, value, ours in zip(places, values, said, strict=True):
        design, offset, error = uncompressed_rows(estimator, place)
        theirs.update((value.T.ravel() - offset)[:, None], R=np.diag(error**2), H=design)
        assert float((theirs.y.T @ theirs.SI @ theirs.y).item()) == pytest.approx(
            ours.nis, rel=1e-8
        )
    np.testing.assert_allclose(state.mean, theirs.x.ravel(), atol=1e-9)
    np.testing.assert_allclose(state.posterior.covariance(), theirs.P, atol=1e-9)
