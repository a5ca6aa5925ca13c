"""Slices by blocks, and their decomposition from products and in vertical functions, against that of all of them."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator.basis import modes, slices
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.estimator.basis.slices import (
    decompose,
    ensemble_slices,
    exact_svd,
    products,
    surface_speed,
)
from tests import synthetic


def blocks_of(columns, n_nodes, size=5):
    by_component = columns.T.reshape(-1, 2, n_nodes)
    return lambda: (
        (slice(k, k + size), by_component[:, :, k : k + size]) for k in range(0, n_nodes, size)
    )


@pytest.mark.parametrize(("n_slices", "rank"), [(12, 12), (12, 7), (70, 40), (70, 9)])
@pytest.mark.parametrize("n_modes", [None, 5])
def test_it_spans_what_the_dense_decomposition_spans(monkeypatch, n_slices, rank, n_modes):
    monkeypatch.setattr(slices, "_SMALL", 0)
    rng, n_nodes = np.random.default_rng(0), 20
    columns = (
        rng.standard_normal((2 * n_nodes, rank)) * np.geomspace(1.0, 1e-3, rank)
    ) @ rng.standard_normal((rank, n_slices))
    own, singular = decompose(blocks_of(columns, n_nodes), n_nodes, n_modes)
    vectors, values = exact_svd(columns, n_modes)
    u = np.linalg.svd(columns)[0][:, : min(rank, n_modes or rank)]
    assert own.shape == vectors.shape == u.shape
    np.testing.assert_allclose(own.T @ own, np.eye(u.shape[1]), atol=1e-12)
    np.testing.assert_allclose(own @ own.T, u @ u.T, atol=1e-9)
    np.testing.assert_allclose(own, vectors, atol=1e-8)
    # their squares are right to rounding of the largest
    np.testing.assert_allclose(
        singular[:rank] ** 2, values[:rank] ** 2, rtol=0.0, atol=1e-14 * values[0] ** 2
    )
    found = products(blocks_of(columns, n_nodes), own)
    np.testing.assert_allclose(found, columns.T @ own, atol=1e-12)


def test_blocks_of_rows_change_nothing_with_land_and_steps_of_the_sea_floor(monkeypatch):
    ensemble = synthetic.ensemble(n_members=4, shape=(6, 5), levels=np.array([5.0, 90.0, 220.0]))
    wet = np.ones(ensemble.grid.wet.shape, dtype=bool)
    wet[:, 1:3, 2], wet[:, 3], wet[2, 0, 0], wet[1:, 5, 1] = False, False, False, False
    ensemble = replace(
        ensemble,
        grid=replace(ensemble.grid, wet=wet),
        velocity=np.where(wet, ensemble.velocity, np.nan),
    )
    found = []
    for values in (slices._BLOCK_VALUES, 1, 2 * 4 * 3 * 5 * 2):
        monkeypatch.setattr(slices, "_BLOCK_VALUES", values)
        found.append(ensemble_slices(ensemble))
        np.testing.assert_array_equal(found[-1], found[0])
    columns = np.argwhere(wet[0])
    for node, (j, i) in enumerate(columns):
        for z in range(3):
            deepest = max(k for k in range(z + 1) if wet[k, j, i])
            at = [node, node + len(columns)]
            np.testing.assert_array_equal(
                found[0][:, z, at], ensemble.velocity[:, :, deepest, j, i]
            )
    speed = np.sqrt(np.mean(found[0][:, 0] ** 2))
    assert surface_speed(ensemble) == pytest.approx(speed)


def test_times_are_as_many_members_and_strongest_vertical_functions_find_the_modes(monkeypatch):
    """The functions are all of a sea in which two levels are the same; the weights of every level are exact whichever are taken."""
    sea = synthetic.ensemble(n_members=12)
    sea = replace(sea, velocity=sea.velocity[:, :, [0, 1, 2, 2]])
    parts = [replace(sea, velocity=sea.velocity[k : k + 4]) for k in range(0, 12, 4)]
    config = EstimatorConfig(modes=7)
    found = [build_basis(series, config) for series in ([sea], parts)]
    monkeypatch.setattr(modes, "_LEAST_FUNCTIONS", 3)
    monkeypatch.setattr(modes, "_SLICES_A_MODE", 0)
    found.append(build_basis(parts, config))
    for name in ("modes", "member_weights", "mean_weights", "representation", "potential"):
        one, *others = (getattr(each, name) for each in found)
        np.testing.assert_allclose(others, [one] * 2, atol=1e-9 * np.abs(one).max(), err_msg=name)
