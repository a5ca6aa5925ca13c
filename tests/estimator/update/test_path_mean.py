"""Means along paths: the operator against brute force, and what they do to the static and to the evolving estimate."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.factors import CovarianceFactors
from replay_kit.core.geodesy import rotate_to_local, to_geographic, to_local
from replay_kit.core.observation import PathMean, Reason, Source
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.prior.amplitude import hybrid_parts
from replay_kit.estimator.prior.conditioned import ConditionedPrior, FullCovariancePrior
from replay_kit.estimator.update.representation import (
    inflated,
    predict,
    prefetch,
    taken_in_all,
    to_full_covariance,
)
from tests import synthetic
from tests.estimator.runs import assert_static
from tests.reference import estimator as slow
from tests.reference.representation import error_at

LEVELS = np.array([5.0, 90.0, 220.0])
SMALL = synthetic.ensemble(n_members=8, shape=(4, 5), levels=LEVELS)
CONFIG = EstimatorConfig(modes=8, sample_share=0.6, mean_variance=0.1)
STATIC = TimeConfig(scale="static", dropped_std=0.0)
HOUR = 3600 * 10**9


def dive(seed=0, velocity=(0.1, -0.05), error_std=0.02, n=7, start_ns=0, deepest=200.0):
    """A dive along a crooked path, with uneven times."""
    rng = np.random.default_rng(seed)
    grid = SMALL.grid
    east = np.linspace(*rng.uniform(0.6 * grid.east.min(), 0.6 * grid.east.max(), 2), n)
    north = np.linspace(
        *rng.uniform(0.6 * grid.north.min(), 0.6 * grid.north.max(), 2), n
    ) + rng.normal(0, 500.0, n)
    depth = deepest * (1.0 - np.abs(np.linspace(-1.0, 1.0, n)))
    weight = rng.uniform(0.2, 1.0, n)
    longitude, latitude = to_geographic(grid.projection, east, north)
    times = start_ns + (np.cumsum(weight) / weight.sum() * 3 * HOUR).astype(np.int64)
    return PathMean(
        int(times[-1]),
        times,
        longitude,
        latitude,
        depth,
        weight / weight.sum(),
        velocity,
        error_std,
        "dac",
        1,
        Source(0, "/dac", seed, 0),
    )


#: Position of a mean's only value.
ONLY = np.arange(1)


def mean_by_brute_force(flow, path):
    """The flow's mean along the path, point by point."""
    total = np.zeros(2)
    for longitude, latitude, depth, weight in zip(
        path.longitude, path.latitude, path.depth, path.weight, strict=True
    ):
        east, north = to_local(SMALL.grid.projection, longitude, latitude)
        total += weight * flow.velocity(east, north, depth)
    return total


def test_the_operator_is_the_mean_of_any_flow_of_the_basis():
    estimator = build_estimator(SMALL, CONFIG)
    path, rng = dive(), np.random.default_rng(1)
    estimator = replace(estimator, representation_std=np.zeros(3))
    rows = estimator.rows(path, ONLY)
    for _ in range(3):
        weights = rng.standard_normal(3 * estimator.basis.n_modes)
        flow = estimator.flow_of(weights, np.empty((0, 0)), None)
        expected = mean_by_brute_force(flow, path) - mean_by_brute_force(
            estimator.flow_of(0.0 * weights, np.empty((0, 0)), None), path
        )
        np.testing.assert_allclose(
            rows.matvec(weights.reshape(3, -1)) * path.error_std, expected, rtol=1e-9
        )


@pytest.mark.parametrize("n_profiles", [0, 1, 4, 40])
def test_a_static_estimate_takes_a_mean_as_the_textbook_does(n_profiles):
    """After nothing, one profile (the prior in parts), a few (one matrix), many along a line (span form); and profiles go on after it."""
    estimator = build_estimator(SMALL, CONFIG)
    state = estimator.initial()
    for observation in synthetic.random_profiles(
        SMALL.grid, max(n_profiles, 1), seed=5, speed=0.05
    )[:n_profiles]:
        state, _ = estimator.step(state, observation)
    path = dive()
    of_points = [
        np.interp(depth, LEVELS, error_at(estimator, *place))
        for place, depth in zip(
            zip(path.longitude, path.latitude, strict=True), path.depth, strict=True
        )
    ]
    std = float(np.hypot(path.error_std, path.weight @ np.array(of_points)))
    rows = estimator.rows(path, ONLY)
    design, value = rows.design() * std, rows.stack.values.ravel()
    mean, cov, nis, _ = slow.kalman_update(
        state.mean, state.posterior.covariance(), design, value, std**2 * np.eye(2)
    )
    after, said = estimator.step(state, path)
    scale = np.abs(cov).max()
    np.testing.assert_allclose(after.mean, mean, atol=1e-8 * np.abs(mean).max())
    np.testing.assert_allclose(after.posterior.covariance(), cov, atol=1e-9 * scale)
    assert said.nis == pytest.approx(nis, rel=1e-6)
    assert said.dof == 2
    assert said.innovation.shape == (1, 2)
    (more,) = synthetic.random_profiles(SMALL.grid, 1, seed=8, speed=0.05)
    further, _ = estimator.step(after, more)
    assert np.trace(further.posterior.covariance()) < np.trace(after.posterior.covariance())


@pytest.mark.parametrize("in_one_matrix", [False, True])
def test_profiles_and_means_in_any_order_are_one_prior_and_all_rows(in_one_matrix):
    """Mean, profile, mean, with a covariance that was inflated between them: textbook, and the factors that a file keeps."""
    estimator = build_estimator(SMALL, CONFIG)
    posterior, (profile,) = (
        estimator.initial().posterior,
        synthetic.random_profiles(SMALL.grid, 1, seed=5, speed=0.05),
    )
    mean, cov = posterior.mean, posterior.covariance()
    # rows wait until there are enough to be taken from one matrix together
    many = [dive(k) for k in range(3, 22)] if in_one_matrix else []
    posterior = to_full_covariance(posterior) if in_one_matrix else posterior
    for path in (dive(1), None, dive(2), *many):
        rows = estimator.rows(path or profile, np.arange(2) if path is None else ONLY)
        predicted = predict(posterior, rows, prefetch(posterior, [rows]))
        innovation = np.column_stack([rows.y, np.zeros((rows.y.size, 3))]) - predicted.means
        lower = np.linalg.cholesky(predicted.cov / 1.5**2 + np.eye(len(predicted.cov)))
        posterior = predicted.update(lower, np.linalg.solve(lower, innovation / 1.5), 1.5)
        design = rows.design()
        mean, cov, _, _ = slow.kalman_update(
            mean, cov, design, rows.y, 1.5**2 * np.eye(len(design))
        )
        if path is None:
            posterior, cov = inflated(posterior, 1.7), 1.7 * cov
    assert isinstance(posterior.prior, ConditionedPrior)
    np.testing.assert_allclose(posterior.mean, mean, atol=1e-9 * np.abs(mean).max())
    np.testing.assert_allclose(posterior.covariance(), cov, atol=1e-9 * np.abs(cov).max())
    if in_one_matrix:
        assert isinstance(posterior.prior.before, FullCovariancePrior)
        assert 0 < len(posterior.prior.gain) < 2 * len(many)
        return
    taken = taken_in_all(posterior.prior, *posterior.taken(99), 99)
    kept = CovarianceFactors(hybrid_parts(posterior.prior.before), *taken)
    np.testing.assert_allclose(kept(None), cov, atol=1e-9 * np.abs(cov).max())
    assert taken_in_all(posterior.prior, *posterior.taken(99), 1) is None


def test_without_change_the_evolving_estimate_takes_it_as_the_static_one():
    static, evolving = build_estimator(SMALL, CONFIG), build_evolving([SMALL], CONFIG, STATIC)
    dives = [dive(k, start_ns=k * 5 * HOUR) for k in range(4)]
    assert_static(evolving, static, dives, 1e-9, 1e-11)


def test_a_path_outside_the_region_is_left_out_and_one_twice_counts_once():
    estimator = build_estimator(SMALL, CONFIG, GatingConfig())
    path = dive()
    after, said = estimator.step(
        estimator.initial(), replace(path, longitude=path.longitude + 20.0)
    )
    assert not said.accepted
    assert np.all(said.reasons & Reason.OUTSIDE_REGION)
    state, _ = estimator.step(estimator.initial(), path)
    after, said = estimator.step(state, replace(path))
    assert after is state
    assert np.all(said.reasons & Reason.DUPLICATE)


def test_the_operator_sees_a_forecast_that_changes_during_the_dive():
    """Mean of a forecast that grows linearly, at each point's own time."""
    members = [
        replace(SMALL, velocity=(1.0 + k) * SMALL.velocity, time_ns=k * 6 * HOUR) for k in range(2)
    ]
    estimator = build_evolving(members, CONFIG, STATIC)
    path = dive()
    expected = np.zeros(2)
    for k in range(path.weight.size):
        flow = estimator.flow(estimator.predict(estimator.initial(), int(path.path_time_ns[k])))
        point = replace(
            path,
            longitude=path.longitude[[k]],
            latitude=path.latitude[[k]],
            depth=path.depth[[k]],
            weight=np.ones(1),
        )
        expected += path.weight[k] * mean_by_brute_force(flow, point)
    seen = estimator.operator.path(path, np.arange(1))
    # vectors are turned where the path ends
    measured = rotate_to_local(
        SMALL.grid.projection, path.longitude[-1], path.latitude[-1], *path.velocity
    )
    np.testing.assert_allclose(seen.stack.values[0, 0], np.array(measured) - expected, atol=1e-12)
