"""The prior's parts against one dense matrix, and against a slow twin that builds it entry by entry."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build
from replay_kit.estimator.basis.slices import cell_size, correlation_length, ensemble_slices
from tests import synthetic
from tests.estimator.seas import CONFIG, DAY, LEVELS, forecasts
from tests.reference import estimator as slow
from tests.reference.baselines import gaspari_cohn as slow_taper
from tests.reference.lattice import matrix as functions_at

SMALL = synthetic.ensemble(n_members=5, shape=(4, 5), levels=LEVELS)
NODES = SMALL.grid.nodes


def prior_of(estimator, time_ns=0):
    """Mean and covariance of all weights."""
    process = estimator.flow(estimator.initial()).unknowns.process
    loading = process.loading(time_ns).swapaxes(1, 2) @ process.functions
    rows = loading.swapaxes(1, 2).reshape(process.size, -1)
    return process.mean_at(time_ns), rows.T @ rows


@pytest.mark.parametrize("factor", ["as_given", 2.0])
def test_the_prior_is_the_twin_s_projected_on_the_modes(factor):
    share, shift, radius, of_mean = 0.3, 1.2e4, 4e4, 0.2
    stated = {"sample_share": share, "shift_distance": shift, "localisation_radius": radius}
    config = EstimatorConfig(mean_variance=of_mean, dropped_std=0.0, spread=factor, **stated)
    estimator = build([SMALL], config)
    basis = estimator.observer.basis
    velocity_modes = functions_at(basis.horizontal, NODES) @ basis.modes
    fields = basis.member_weights @ velocity_modes.T
    twin = slow.hybrid_covariance(fields, velocity_modes, NODES, share, shift, radius, slow_taper)
    projector = np.kron(np.eye(3), np.linalg.pinv(velocity_modes))
    mean = basis.mean_weights @ velocity_modes.T
    # but for the nugget, and what no flow without divergence has
    np.testing.assert_allclose(
        mean, ensemble_slices(SMALL).mean(axis=0), atol=5e-3 * np.abs(mean).max()
    )
    twin = (1.0 if factor == "as_given" else factor) * twin + of_mean * np.outer(mean, mean)
    np.testing.assert_allclose(prior_of(estimator)[1], projector @ twin @ projector.T, atol=1e-12)


def test_the_flow_before_any_measurement_is_the_ensemble_s_mean_with_its_divergence():
    sea = synthetic.ensemble(n_members=5, shape=(9, 10), levels=np.array([5.0, 90.0]))
    grid = sea.grid
    diverging = sea.velocity + 5e-6 * np.stack([grid.east, grid.north])[:, None]
    estimator = build([replace(sea, velocity=diverging)], EstimatorConfig(nugget=1e-12))
    whole = estimator.flow(estimator.initial())
    off = [
        np.abs(np.moveaxis(flow.velocity(*at), -1, 0) - diverging.mean(axis=0)).max()
        for at in [(grid.east[None], grid.north[None], grid.levels[:, None, None])]
        for flow in (whole, replace(whole, potential=None))
    ]
    assert off[0] < 1e-3
    assert off[1] > 0.1


@pytest.mark.parametrize("levels", [LEVELS[:1], LEVELS])
def test_what_is_dropped_stays_below_the_bound_and_is_in_the_stated_error(levels):
    """Directions alone where there is one level; with several vertical functions too, which are not independent at every node."""
    sea, bound = synthetic.ensemble(n_members=8, shape=(4, 5), levels=levels), 0.02
    series = [replace(sea, velocity=(2 - k) * sea.velocity, time_ns=k * DAY) for k in range(2)]
    whole, few = (
        build(
            series, CONFIG.model_copy(update={"dropped_std": std, "modes": 40}), None, TimeConfig()
        )
        for std in (0.0, bound)
    )
    assert few.unknowns < whole.unknowns
    basis, n, error = few.observer.basis, levels.size, few.observer.error(1.0)
    by_node = np.kron(np.eye(n), functions_at(basis.horizontal, NODES) @ basis.modes)
    dropped = few.observer.dropped**2
    assert 0.0 < dropped.max() <= bound**2 * (1.0 + 1.0 / 9.0)
    assert np.all(error**2 >= dropped)
    for k, time_ns in enumerate((0, DAY)):
        own, all_of_it = (
            np.diag(by_node @ prior_of(each, time_ns)[1] @ by_node.T).reshape(n, 2, -1)
            for each in (few, whole)
        )
        missing = (all_of_it - own).mean(axis=1)
        if n == 1:
            np.testing.assert_allclose(missing, dropped / (1 + k) ** 2, atol=1e-9)
        assert np.all(missing - dropped <= 2.0 * np.sqrt(own.mean(axis=1) * dropped))
        flow = few.flow(few.initial()).at(time_ns)
        stated = flow.standard_error(*NODES.T, levels[:, None]) ** 2
        expected = np.moveaxis(own, 1, -1) + error[..., None] ** 2
        np.testing.assert_allclose(stated, expected, rtol=1e-6)


def test_the_time_scale_is_read_off_the_members_own_change_and_equal_members_tell_nothing():
    """Anomalies that keep a share of themselves a day; at a time before, all members are the same."""
    rng, (only,) = np.random.default_rng(0), forecasts(1, n_members=40)
    kept, fields = 0.7, [rng.standard_normal(only.velocity.shape)]
    for _ in range(5):
        noise = rng.standard_normal(only.velocity.shape)
        fields.append(kept * fields[-1] + np.sqrt(1 - kept**2) * noise)
    fields = [np.repeat(fields[0][:1], 40, axis=0), *fields]
    members = [replace(only, velocity=field, time_ns=k * DAY) for k, field in enumerate(fields)]
    config = EstimatorConfig(modes=None, sample_share=0.6, mean_variance=0.0)
    for series in (members, members[1:]):
        estimator = build(series, config, None, TimeConfig())
        moving, local = np.unique(estimator.flow(estimator.initial()).unknowns.process.tau)[::-1]
        assert local == pytest.approx(-86_400.0 / np.log(kept), rel=0.1)
        assert moving == 5.0 * local
    begun = build(members, config, None, TimeConfig())
    assert np.abs(prior_of(begun)[1]).max() < 1e-9 * np.abs(prior_of(begun, DAY)[1]).max()


def test_the_correlation_length_equals_a_pair_by_pair_twin_with_land_and_is_at_least_a_cell():
    wet = np.ones(SMALL.grid.wet.shape, dtype=bool)
    wet[:, 1:3, 2], wet[2, 0, 0] = False, False
    smooth = synthetic.ensemble(n_members=5, shape=(4, 5), levels=SMALL.grid.levels, step=0.02)
    with_land = replace(smooth, grid=replace(smooth.grid, wet=wet))
    expected = slow.correlation_length(
        with_land.velocity, with_land.grid.east, with_land.grid.north, wet
    )
    cell = np.sqrt(np.prod(cell_size(with_land.grid)))
    assert expected > 1.1 * cell
    assert correlation_length(with_land) == pytest.approx(expected, rel=1e-12)
    noise = np.random.default_rng(0).standard_normal(smooth.velocity.shape)
    for rough in (noise, np.ones_like(noise)):
        assert correlation_length(replace(smooth, velocity=rough)) == pytest.approx(cell)
