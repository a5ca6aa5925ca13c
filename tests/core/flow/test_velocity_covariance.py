"""The covariance between velocities at a few points, against the standard errors and the textbook's product."""

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.flow.load import load
from replay_kit.estimator.static.filter import build_estimator
from tests import synthetic
from tests.reference.lattice import matrix as functions_at

ENSEMBLE = synthetic.ensemble(n_members=6, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
EAST, NORTH, DEPTH = (
    np.array([1e3, -4e3, 1e3]),
    np.array([2e3, 0.0, 2e3]),
    np.array([5.0, 60.0, 180.0]),
)


@pytest.fixture(scope="module", params=["posterior", "file", "matrix"])
def flow(request, tmp_path_factory):
    estimator = build_estimator(ENSEMBLE, EstimatorConfig(modes=12), GatingConfig())
    depth = np.array([10.0, 50.0, 120.0, 200.0])
    state = estimator.initial()
    for number in range(3):
        values = 0.1 * np.random.default_rng(number).standard_normal((4, 2))
        state, _ = estimator.step(
            state,
            synthetic.profile(
                ENSEMBLE.grid, 2e3 * number, 0.0, depth, values, 0.05, time_ns=number
            ),
        )
    flow = estimator.flow(state)
    if request.param == "file":
        path = tmp_path_factory.mktemp("flow") / "flow.nc"
        flow.save(path)
        return load(path)
    if request.param == "matrix":
        assert flow.weight_cov.size
    return flow


def test_it_is_the_textbook_s_product(flow):
    places = functions_at(flow.horizontal, np.column_stack([EAST, NORTH])) @ flow.modes
    weights = depth_weights(flow.depth_functions, DEPTH, flow.levels)
    design = np.array([np.kron(weights[row % 3], places[row]) for row in range(6)])
    expected = design @ flow.weight_cov @ design.T
    np.testing.assert_allclose(
        flow.velocity_covariance(EAST, NORTH, DEPTH), expected, atol=1e-9 * expected.max()
    )


def test_its_diagonal_is_the_standard_error_squared(flow):
    for true_axes in (False, True):
        errors = flow.standard_error(EAST, NORTH, DEPTH, true_axes)
        found = np.diag(flow.velocity_covariance(EAST, NORTH, DEPTH, true_axes)).reshape(2, 3).T
        np.testing.assert_allclose(found, errors**2, rtol=1e-7)


def test_where_nothing_is_known_it_is_not_a_number(flow):
    found = flow.velocity_covariance([1e3, 1e3], 2e3, [5.0, 900.0])
    assert np.isnan(found).tolist() == [[False, True] * 2, [True] * 4] * 2


def test_a_flow_without_uncertainty_is_refused(flow):
    with pytest.raises(EstimatorError, match="velocity_covariance needs"):
        flow.mean_flow().velocity_covariance(0.0, 0.0, 5.0)
