"""Baselines against packages that nobody here wrote: DAPPER's ETKF and LETKF, filterpy's Kalman filter, scikit-learn's GP."""

import warnings

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalKernel,
    depth_weights,
    velocity_kernel,
)
from replay_kit.estimator import build_estimator
from replay_kit.estimator.baselines.builders import build_baseline
from replay_kit.estimator.baselines.etkf import build_letkf
from replay_kit.estimator.baselines.gp import build_gp, second_moments
from replay_kit.estimator.prior.localised import gaspari_cohn
from tests import synthetic
from tests.estimator.baselines.small import (
    DEPTHS,
    GRID,
    MEMBERS,
    SMALL,
    STD,
    at_nodes,
    profiles,
)
from tests.estimator.runs import run
from tests.reference.lattice import matrix as functions_at

with warnings.catch_warnings():
    # DAPPER leaves its configuration file to the garbage collector
    warnings.simplefilter("ignore", ResourceWarning)
    from dapper.da_methods.ensemble import EnKF_analysis, local_analyses
    from dapper.tools.randvars import GaussRV

NODES = GRID.nodes


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


def test_dapper_s_etkf():
    """DAPPER transforms the members themselves; ours keeps the transform. All profiles in one batch."""
    config = EstimatorConfig(modes=12, sample_share=1.0, shift_distance=0.0)
    observations, places, values = profiles(4)
    estimator = build_baseline("etkf", SMALL, config)
    state, _ = run(estimator, observations)
    rows = [uncompressed_rows(estimator.reduced, place) for place in places]
    design, error = np.vstack([r[0] for r in rows]), np.concatenate([r[2] for r in rows])
    data = np.concatenate([v.T.ravel() - r[1] for v, r in zip(values, rows, strict=True)])
    weights = estimator.reduced.basis.member_weights.reshape(5, -1)
    analysed = EnKF_analysis(weights.copy(), weights @ design.T, GaussRV(C=error**2), data, "Sqrt")
    mean = estimator.reduced.prior.mean + estimator.anomalies.T @ state.mean
    np.testing.assert_allclose(analysed.mean(axis=0), mean, atol=1e-9)
    np.testing.assert_allclose(np.cov(analysed.T), estimator.flow(state).weight_cov, atol=1e-9)


def test_dapper_s_letkf():
    config = EstimatorConfig(nugget=1e-13)
    observations, places, values = profiles(5)
    radius = 2.5e4
    estimator = build_letkf(SMALL, config, radius)
    state, _ = run(estimator, observations)
    everyone = (
        np.concatenate([np.zeros((5, 1)), np.eye(5)], axis=1) * 2.0
    )  # member = mean + sqrt(E - 1) anomaly
    everyone[:, 0] = 1.0
    weights = depth_weights(DepthFunctions("hat", 1.0), DEPTHS, GRID.levels)
    seen = [
        np.einsum("nz,czm->ncm", weights, estimator.columns.at_place(place)).reshape(-1, 6)
        @ everyone.T
        for place in places
    ]
    members = (
        np.concatenate([MEMBERS[..., : len(NODES)], MEMBERS[..., len(NODES) :]], axis=1)
        .reshape(5, -1)
        .copy()
    )
    columns = [np.arange(6) * len(NODES) + node for node in range(len(NODES))]

    def taperer(batch):
        distance = np.hypot(*(np.array(places) - NODES[batch[0]]).T)
        taper = np.repeat(gaspari_cohn(distance, radius), 2 * DEPTHS.size)
        near = np.flatnonzero(taper > 0.0)
        return near, taper[near]

    data = np.concatenate([v.ravel() for v in values])
    analysed, _ = local_analyses(
        members, np.concatenate(seen).T, GaussRV(C=STD**2, M=data.size).C, data, columns, taperer
    )
    expected = analysed.mean(axis=0).reshape(2, 3, -1)
    np.testing.assert_allclose(
        at_nodes(estimator.flow(state)),
        np.concatenate([expected[0], expected[1]], axis=1),
        atol=1e-4,
    )


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


class IncompressibleKernel(Kernel):
    """Rows of X are (component, east, north, level's position)."""

    def __init__(self, length, depth_cov):
        self.length = length
        self.depth_cov = depth_cov

    def __call__(self, X, Y=None, eval_gradient=False):  # noqa: N803  (scikit-learn's names)
        Y = X if Y is None else Y  # noqa: N806
        blocks = velocity_kernel(
            HorizontalKernel(self.length, self.length, 1.0), X[:, 1:3], Y[:, 1:3]
        )
        blocks = blocks.reshape(2, len(X), 2, len(Y))
        rows, columns = X[:, 0].astype(int), Y[:, 0].astype(int)
        horizontal = blocks[
            rows[:, None], np.arange(len(X))[:, None], columns[None], np.arange(len(Y))[None]
        ]
        return horizontal * self.depth_cov[X[:, 3].astype(int)[:, None], Y[:, 3].astype(int)[None]]

    def diag(self, X):  # noqa: N803
        return np.diag(self(X))

    def is_stationary(self):
        return False


def test_scikit_learn_s_gaussian_process():
    """Profiles at nodes, bins at levels: there the finite model is the process itself."""
    length = 9_000.0
    rng = np.random.default_rng(4)
    chosen = (1, 6, 13)
    estimator = build_gp(SMALL, EstimatorConfig(length_horizontal=length, modes=None))
    state = estimator.initial()
    rows, data = [], []
    for node in chosen:
        value = 0.2 * rng.standard_normal((3, 2))
        state, _ = estimator.step(
            state, synthetic.profile(GRID, *NODES[node], GRID.levels, value, STD)
        )
        rows += [(c, *NODES[node], z) for z in range(3) for c in range(2)]
        data += list(value.ravel())
    peer = GaussianProcessRegressor(
        IncompressibleKernel(length, second_moments(MEMBERS)), alpha=STD**2, optimizer=None
    )
    peer.fit(np.array(rows), np.array(data))
    everywhere = np.array([(c, *node, z) for z in range(3) for c in range(2) for node in NODES])
    mean, std = peer.predict(everywhere, return_std=True)
    flow = estimator.flow(state)
    np.testing.assert_allclose(at_nodes(flow), mean.reshape(3, -1), atol=2e-3)
    ours = np.moveaxis(
        flow.standard_error(NODES[:, 0], NODES[:, 1], GRID.levels[:, None]), -1, 1
    ).reshape(-1)
    np.testing.assert_allclose(ours, std, rtol=1e-2)
