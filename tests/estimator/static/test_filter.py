"""The estimator against its slow twin, online against batch, and the physics every basis flow must obey."""

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.estimator import build_estimator
from replay_kit.estimator.basis.slices import ensemble_slices
from replay_kit.estimator.update.noise import dependence_inflation
from tests import synthetic
from tests.estimator.runs import run
from tests.reference import estimator as slow
from tests.reference.lattice import matrix as functions_at
from tests.reference.representation import error_at

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
DEFAULT = EstimatorConfig(mean_variance=0.1)


def local_values(grid, observation):
    u, v = rotate_to_local(
        grid.projection, observation.longitude, observation.latitude, *observation.velocity.T
    )
    return np.concatenate([u, v])


def test_paper_equals_a_dense_twin():
    config = EstimatorConfig(preset="paper", modes=12, length_vertical=60.0)
    estimator = build_estimator(SMALL, config)
    members, grid = ensemble_slices(SMALL), SMALL.grid
    lengths, speed = (10_000.0, 10_000.0, 60.0), float(np.sqrt(np.mean(members[:, 0] ** 2)))
    modes, weights, points = slow.paper_basis(members, grid.nodes, grid.levels, lengths, speed, 12)
    stacked = weights.reshape(len(members), -1)
    mean, cov = stacked.mean(axis=0), np.diag(stacked.var(axis=0, ddof=1))
    observations = synthetic.random_profiles(grid, 6)
    state = estimator.initial()
    for observation in observations:
        used = observation.depth <= grid.levels[-1]
        place = to_local(grid.projection, observation.longitude, observation.latitude)
        h = slow.design_matrix(
            place, observation.depth[used], points, modes, 3, grid.levels[0], lengths, speed
        )
        value = local_values(grid, observation)[np.tile(used, 2)]
        mean, cov, nis, _ = slow.kalman_update(mean, cov, h, value, 0.12**2 * np.eye(value.size))
        state, innovation = estimator.step(state, observation)
        assert innovation.nis == pytest.approx(nis, rel=1e-8)
        assert innovation.dof == value.size
    probe = synthetic.random_profiles(grid, 3, seed=9)
    for observation in probe:
        east, north = to_local(grid.projection, observation.longitude, observation.latitude)
        depths = np.array([5.0, 50.0, 200.0])
        h = slow.design_matrix(
            (east, north), depths, points, modes, 3, grid.levels[0], lengths, speed
        )
        flow = estimator.flow(state)
        expected = (h @ mean).reshape(2, -1).T
        np.testing.assert_allclose(
            flow.velocity(east, north, depths),
            expected,
            rtol=1e-8,
            atol=1e-8 * np.abs(expected).max(),
        )
        std = np.sqrt(np.diag(h @ cov @ h.T)).reshape(2, -1).T
        np.testing.assert_allclose(flow.standard_error(east, north, depths), std, rtol=1e-8)


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_online_equals_batch(preset):
    config = EstimatorConfig(preset=preset, modes=10, mean_variance=0.1)
    estimator = build_estimator(SMALL, config)
    observations = synthetic.random_profiles(SMALL.grid, 15, seed=2)
    state, _ = run(estimator, observations)
    basis = estimator.basis
    rows, values, variances = [], [], []
    for observation in observations:
        used = observation.depth <= SMALL.grid.levels[-1]
        point = np.array(
            [to_local(SMALL.grid.projection, observation.longitude, observation.latitude)]
        )
        kernel = functions_at(basis.horizontal, point)
        weights = depth_weights(basis.depth_functions, observation.depth[used], basis.grid.levels)
        rows.append(np.vstack([np.kron(weights, kernel[c] @ basis.modes) for c in range(2)]))
        values.append(
            local_values(SMALL.grid, observation)[np.tile(used, 2)]
            - (weights @ (kernel @ basis.offset).T).T.ravel()
        )
        if preset == "paper":
            std = np.full(used.sum(), 0.12)
        else:
            std = np.hypot(
                0.05,
                np.interp(
                    observation.depth[used],
                    basis.grid.levels,
                    basis.local_error(point, basis.truncation_std)[0],
                ),
            )
        variances.append(np.tile(std**2, 2))
    h, y, r = np.vstack(rows), np.concatenate(values), np.diag(np.concatenate(variances))
    mean, cov, _, _ = slow.kalman_update(
        estimator.prior.mean, estimator.prior.covariance(), h, y, r
    )
    np.testing.assert_allclose(state.mean, mean, atol=1e-10 * np.abs(mean).max())
    np.testing.assert_allclose(
        state.posterior.covariance(), cov, atol=1e-10 * np.abs(estimator.prior.covariance()).max()
    )


def test_innovation_std_and_residual_are_those_of_the_uncompressed_profile():
    estimator = build_estimator(SMALL, DEFAULT)
    observation = synthetic.random_profiles(SMALL.grid, 1, seed=5)[0]
    state, innovation = estimator.step(estimator.initial(), observation)
    before, after = estimator.flow(estimator.initial()), estimator.flow(state)
    east, north = to_local(SMALL.grid.projection, observation.longitude, observation.latitude)
    used = observation.depth <= SMALL.grid.levels[-1]
    depth, value = (
        observation.depth[used],
        local_values(SMALL.grid, observation).reshape(2, -1).T[used],
    )
    np.testing.assert_allclose(
        innovation.innovation[used], value - before.velocity(east, north, depth), atol=1e-12
    )
    np.testing.assert_allclose(
        innovation.residual[used], value - after.velocity(east, north, depth), atol=1e-12
    )
    representation = error_at(estimator, observation.longitude, observation.latitude)
    error_std = np.hypot(0.05, np.interp(depth, SMALL.grid.levels, representation))
    expected = np.hypot(before.standard_error(east, north, depth), error_std[:, None])
    np.testing.assert_allclose(innovation.innovation_std[used], expected, rtol=1e-10)
    assert np.isnan(innovation.innovation[~used]).all()


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_estimate_and_modes_are_divergence_free(preset):
    """Analytic: the velocity is the rotated gradient of a stream function; here by fourth-order differences."""
    estimator = build_estimator(SMALL, EstimatorConfig(preset=preset))
    state, _ = run(estimator, synthetic.random_profiles(SMALL.grid, 5))
    n_levels = SMALL.grid.levels.size
    rng = np.random.default_rng(1)
    east, north = rng.uniform(-1.5e4, 1.5e4, (2, 6))
    depth = rng.uniform(0.0, 220.0, 6)
    means = [state.mean] + [
        np.tile(np.eye(estimator.basis.n_modes)[m], n_levels)
        for m in (0, 3, estimator.basis.n_modes - 1)
    ]
    step = 60.0
    for mean in means:
        flow = estimator.flow_of(mean, state.posterior.covariance, None)

        def slope(shift_east, shift_north, component, flow=flow):
            values = [
                flow.velocity(east + k * shift_east, north + k * shift_north, depth)[:, component]
                for k in (-2, -1, 1, 2)
            ]
            return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * step)

        u_x, v_y = slope(step, 0.0, 0), slope(0.0, step, 1)
        assert np.max(np.abs(u_x + v_y)) < 1e-8 * np.max(np.abs(u_x))


def test_the_prior_s_flow_is_the_ensemble_s_mean():
    estimator = build_estimator(SMALL, EstimatorConfig(nugget=1e-12))
    flow, grid = estimator.flow(estimator.initial()), SMALL.grid
    ours = flow.velocity(grid.east[None], grid.north[None], grid.levels[:, None, None])
    np.testing.assert_allclose(np.moveaxis(ours, -1, 0), SMALL.velocity.mean(axis=0), atol=1e-6)


def test_samples_have_the_stated_spread_and_are_seeded():
    estimator = build_estimator(SMALL, EstimatorConfig(modes=8))
    flow = estimator.flow(estimator.initial())
    point = (3_000.0, -2_000.0, 40.0)
    drawn = np.array([sample.velocity(*point) for sample in flow.sample(4000, seed=1)])
    np.testing.assert_allclose(drawn.std(axis=0), flow.standard_error(*point), rtol=0.05)
    np.testing.assert_array_equal(
        flow.sample(2, seed=1)[1].velocity(*point), flow.sample(2, seed=1)[1].velocity(*point)
    )


def test_inflation_is_one_for_independent_residuals_and_ar1_s_for_correlated_ones():
    rng = np.random.default_rng(0)

    def inflation(series):
        return dependence_inflation(series[None], np.array([series.size]))

    assert inflation(rng.standard_normal((22, 2))) == 1.0
    for rho in (0.6, 0.9):
        noise = rng.standard_normal((20_000, 2))
        series = np.zeros_like(noise)
        for k in range(1, len(series)):
            series[k] = rho * series[k - 1] + np.sqrt(1 - rho**2) * noise[k]
        assert inflation(series) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)
        # twice the residual is four times the variance
        assert inflation(2.0 * series) == pytest.approx(4 * (1 + rho) / (1 - rho), rel=0.1)


def test_independent_bins_and_the_paper_s_never_inflate():
    observation = synthetic.random_profiles(SMALL.grid, 1)[0]
    smooth = synthetic.wiggle(SMALL.grid)
    for preset, profile, inflates in (
        ("default", smooth, True),
        ("default", observation, False),
        ("paper", smooth, False),
    ):
        estimator = build_estimator(SMALL, DEFAULT.model_copy(update={"preset": preset}))
        _, innovation = estimator.step(estimator.initial(), profile)
        assert (innovation.error_inflation > 1.0) == inflates
