"""Covariances kept in factors against the dense matrix of a textbook update: parts, samples, files and pickles.

| case | why the tolerance |
|---|---|
| covariance 1e-12 of the largest | sums of some hundred products |
| covariance of 20,000 samples, 5 of its standard errors | no element of 2,000 lies outside by chance |
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from replay_kit.core.flow.covariance import HybridCovariance
from replay_kit.core.flow.factors import CovarianceFactors, half_of, half_size, whole_of
from replay_kit.core.flow.load import load, load_bytes
from replay_kit.core.flow.lossless import save_bytes
from tests.reference import estimator as slow

Z, R, S = 3, 14, 2


def factors(n_directions=S):
    """Return factors after five rows in some directions, and the dense covariance."""
    rng = np.random.default_rng(4)
    half = rng.standard_normal((2, R, R)) / R
    vertical = np.linalg.qr(rng.standard_normal((Z, Z)))[0]
    prior = HybridCovariance(rng.standard_normal((4, Z, R)), vertical, half @ half.swapaxes(1, 2))
    # one horizontal covariance serves the last two vertical functions
    each = prior.horizontal[[0, 1, 1]]
    rows = prior.factor.reshape(4, -1)
    before = rows.T @ rows + sum(
        np.kron(np.outer(v, v), h) for v, h in zip(vertical, each, strict=True)
    )
    directions = rng.standard_normal((n_directions, R))
    inside = rng.standard_normal((5, Z * n_directions))
    spread = np.kron(np.eye(Z), directions)
    within = inside @ spread @ before @ spread.T @ inside.T
    matrix = inside.T @ np.linalg.solve(within + np.eye(5), inside)
    _, after, _, _ = slow.kalman_update(
        np.zeros(Z * R), before, inside @ spread, np.zeros(5), np.eye(5)
    )
    return CovarianceFactors(prior, directions, 0.5 * (matrix + matrix.T)), after


def flow_with(flow, n_directions=S):
    modes = np.random.default_rng(1).standard_normal((len(flow.latent), R))
    return replace(flow, modes=modes, covariance=factors(n_directions)[0])


@pytest.mark.parametrize("n_directions", [0, S])
def test_the_parts_are_those_of_the_textbook_s_covariance(n_directions):
    ours, expected = factors(n_directions)
    by_level, atol = expected.reshape(Z, R, Z, R), 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(ours(None), expected, atol=atol)
    np.testing.assert_allclose(
        ours((0, 2)), by_level[[0, 2]][:, :, [0, 2]].reshape(2 * R, -1), atol=atol
    )
    np.testing.assert_allclose(
        ours.of_sum((0, 2)), by_level[[0, 2]][:, :, [0, 2]].sum(axis=(0, 2)), atol=4.0 * atol
    )
    np.testing.assert_array_equal(ours(None), ours(None).T)


@pytest.mark.parametrize("n_directions", [0, S])
def test_samples_have_the_covariance(n_directions):
    ours, expected = factors(n_directions)
    n = 20_000
    drawn = ours.draws(n, 3).reshape(n, -1)
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert np.all(np.abs(drawn.T @ drawn / n - expected) < 5.0 * error)
    np.testing.assert_array_equal(ours.draws(2, 7), ours.draws(2, 7))


def test_rows_without_noise_leave_no_scatter_in_samples():
    ours, _ = factors()
    spread = np.kron(np.eye(Z), ours.directions)
    within = spread @ ours.prior.covariance() @ spread.T
    inverse = np.linalg.inv(within)
    exact = replace(ours, matrix=0.5 * (inverse + inverse.T))
    drawn = exact.draws(50, 1) @ ours.directions.T
    assert np.abs(drawn).max() < 1e-6 * np.sqrt(np.diag(within).max())


@pytest.mark.parametrize("n_directions", [0, S])
def test_files_and_pickles_hold_the_factors_and_give_the_same_samples(flow, n_directions):
    kept = flow_with(flow, n_directions)
    data = save_bytes(kept)
    for again in (load_bytes(data, "flow"), pickle.loads(pickle.dumps(kept))):
        assert isinstance(again.covariance, CovarianceFactors)
        np.testing.assert_array_equal(again.weight_cov, kept.weight_cov)
        for one, other in zip(again.sample(3, 5), kept.sample(3, 5), strict=True):
            np.testing.assert_array_equal(one.latent, other.latent)
        assert save_bytes(again) == data
    place = (1e3, 2e3, 60.0)
    dense = replace(kept, covariance=factors(n_directions)[1])
    np.testing.assert_allclose(kept.standard_error(*place), dense.standard_error(*place), rtol=1e-9)


@pytest.mark.parametrize("kept_part", ["factor", "vertical"])
def test_a_prior_of_one_part_alone_is_kept(flow, kept_part):
    kept = flow_with(flow)
    prior = kept.covariance.prior
    alone = (
        replace(prior, vertical=prior.vertical[:0], horizontal=prior.horizontal[:0])
        if kept_part == "factor"
        else replace(prior, factor=prior.factor[:0])
    )
    kept = replace(kept, covariance=replace(kept.covariance, prior=alone))
    again = load_bytes(save_bytes(kept), "flow").covariance.prior
    assert (again.factor.shape, again.vertical.shape) == (alone.factor.shape, alone.vertical.shape)
    np.testing.assert_array_equal(again.covariance(), alone.covariance())


def test_a_matrix_is_stored_by_half_and_one_of_version_4_still_opens(flow, tmp_path):
    path = tmp_path / "flow.nc"
    flow = replace(flow, covariance=0.5 * (flow.weight_cov + flow.weight_cov.T))
    flow.save(path)
    with xr.open_dataset(path, engine="h5netcdf", decode_cf=False) as opened:
        dataset = opened.load()
    assert dataset["weight_cov"].shape == (half_size(len(flow.weight_cov)),)
    np.testing.assert_array_equal(load(path).weight_cov, flow.weight_cov)
    old = dataset.drop_vars("weight_cov").assign(
        weight_cov=(("weight", "weight_2"), flow.weight_cov)
    )
    old.attrs["replay_kit_format_version"] = 4
    old.to_netcdf(
        path,
        engine="h5netcdf",
        encoding={str(name): {"_FillValue": None} for name in old.variables},
    )
    with pytest.warns(UserWarning, match="no checksum"):
        np.testing.assert_array_equal(load(path).weight_cov, flow.weight_cov)


def test_halves_of_matrices():
    matrices = np.random.default_rng(0).standard_normal((2, 4, 4))
    matrices = matrices + matrices.swapaxes(1, 2)
    half = half_of(matrices)
    assert half[1].tolist() == [matrices[1, i, j] for i in range(4) for j in range(i + 1)]
    np.testing.assert_array_equal(whole_of(half), matrices)
    with pytest.raises(ValueError, match="11 elements are not half"):
        whole_of(np.zeros(11))
