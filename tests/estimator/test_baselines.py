"""The paper's baselines against slow twins, and the estimator against a Kalman filter that nobody here wrote: filterpy's."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.estimator import build
from replay_kit.estimator.baselines import build_named
from replay_kit.estimator.basis.modes import default_functions
from replay_kit.estimator.basis.slices import ensemble_slices
from tests import synthetic
from tests.estimator.seas import LEVELS
from tests.reference import baselines as slow
from tests.reference import lattice
from tests.reference.dense import Twin

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=LEVELS)
GRID, MEMBERS = SMALL.grid, ensemble_slices(SMALL)
# a nugget so small that a flow at the nodes is what it was made of, to the tolerances below
CONFIG = EstimatorConfig(nugget=1e-9, representation_error_std=0.0)
DEPTHS, STD = np.array([20.0, 100.0, 200.0]), 0.05


def named(name, config=CONFIG):
    return build_named(SMALL, config.model_copy(update={"name": name}))


def profiles(n, seed=0):
    """Profiles of three bins, their places, and their local values."""
    rng = np.random.default_rng(seed)
    places, values = rng.uniform(-1.2e4, 1.2e4, (n, 2)), 0.2 * rng.standard_normal((n, 3, 2))
    log = [
        synthetic.profile(GRID, *place, DEPTHS, value, STD, time_ns=k + 1)
        for k, (place, value) in enumerate(zip(places, values, strict=True))
    ]
    return log, places, values


def at_nodes(of):
    """Velocity, or its error, at all nodes and levels, shape (Z, 2N)."""
    return np.moveaxis(of(*GRID.nodes.T, GRID.levels[:, None]), -1, 1).reshape(3, -1)


def seen_of(flows, place):
    """Velocities of whole flows at the bins over a place, interpolated from the nodes by the twin."""
    functions = default_functions(GRID, CONFIG)
    from_nodes = lattice.interpolation(functions, GRID.nodes, place, CONFIG.nugget)
    return slow.design_of_members(flows, GRID.levels, from_nodes, DEPTHS)


def test_nearest_is_the_member_of_least_squares():
    log, places, values = profiles(4, seed=3)
    estimator = named("nearest")
    state, steps = estimator.assimilate(estimator.initial(), log)
    at_profiles = [seen_of(MEMBERS, place) for place in places]
    expected = slow.nearest(at_profiles, values, [STD] * 4)
    said = steps[-1].innovation
    np.testing.assert_allclose(said.residual, values[-1] - at_profiles[-1][expected], atol=1e-9)
    assert np.isnan(said.nis)
    assert np.argmax(estimator.chosen(state)) == expected
    np.testing.assert_allclose(
        at_nodes(estimator.flow(state).velocity), MEMBERS[expected], atol=2e-3
    )
    measured = synthetic.profile(GRID, *places[0], DEPTHS, at_profiles[0][3], STD)
    state, (step,) = estimator.assimilate(estimator.initial(), [measured])
    assert np.argmax(estimator.chosen(state)) == 3
    np.testing.assert_allclose(step.innovation.residual, 0.0, atol=1e-9)


def test_naive_is_a_textbook_filter_on_the_modes_of_whole_members():
    log, places, values = profiles(5)
    estimator = named("naive3d")
    state, _ = estimator.assimilate(estimator.initial(), log)

    def seen_at(place):
        def design(modes):
            flows = modes.T.reshape(-1, *MEMBERS.shape[1:])
            return seen_of(flows, place).reshape(len(flows), -1).T

        return design

    modes, mean, cov = slow.naive(MEMBERS, [seen_at(place) for place in places], values, [STD] * 5)
    flow = estimator.flow(state)
    np.testing.assert_allclose(at_nodes(flow.velocity), (modes @ mean).reshape(3, -1), atol=5e-5)
    std = np.sqrt(np.diag(modes @ cov @ modes.T)).reshape(3, -1)
    np.testing.assert_allclose(at_nodes(flow.standard_error), std, atol=5e-5)


@pytest.mark.parametrize(
    ("name", "text"),
    [("kriging", "expected one of reduced_basis, naive3d, nearest"), ("etkf", "got 'etkf'")],
)
def test_what_cannot_be_built_is_said(name, text):
    with pytest.raises(ConfigError, match=text):
        named(name)


def test_filterpy_s_kalman_filter():
    estimator = build([SMALL], EstimatorConfig(modes=12, spread="as_given"))
    (log, _, _) = profiles(4)
    state, steps = estimator.assimilate(estimator.initial(), log)
    twin = Twin(estimator.flow(estimator.initial()))
    theirs = KalmanFilter(dim_x=estimator.unknowns, dim_z=2 * DEPTHS.size)
    for given, step in zip(log, steps, strict=True):
        design, value, noise = twin.rows(given)
        theirs.update(value[:, None], R=noise, H=design)
        nis = float((theirs.y.T @ theirs.SI @ theirs.y).item())
        assert nis == pytest.approx(step.innovation.nis, rel=1e-8)
    np.testing.assert_allclose(state.x, theirs.x.ravel(), atol=1e-9)
    np.testing.assert_allclose(state.covariance, theirs.P, atol=1e-9)
