"""The localised covariance by tiles against every pair of nodes, and what any localised covariance must be."""

import numpy as np
import pytest

from replay_kit.estimator.basis.shifts import ShiftedModes, projector, shifted_copies
from replay_kit.estimator.prior import localised as module
from replay_kit.estimator.prior.localised import localised, localised_part, vertical_functions
from tests.reference import estimator as slow
from tests.reference.baselines import gaspari_cohn as slow_taper

RADIUS = 4.0


def nodes_of(kind, rng):
    """A regular grid with a bay of land, or a curvilinear one."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(7.0), np.arange(6.0)))
    places = (
        np.column_stack([x, y])
        if kind == "land"
        else np.column_stack([x + 0.3 * np.sin(y), (1.0 + 0.1 * x) * y])
    )
    return places[~((x < 3) & (y > 3))] if kind == "land" else places


def some_covariances(rng, groups, n_modes):
    factors = (
        rng.standard_normal((groups, n_modes, n_modes + 2))
        * np.geomspace(1.0, 0.05, n_modes)[:, None]
    )
    return factors @ factors.swapaxes(1, 2)


@pytest.mark.parametrize("kind", ["land", "curvilinear"])
@pytest.mark.parametrize(("few", "error"), [(1000, 1e-12), (0, 1e-4)])
def test_it_equals_the_twin_in_double_precision_and_nearly_in_single(monkeypatch, kind, few, error):
    monkeypatch.setattr(module, "_TILE", 5)
    monkeypatch.setattr(module, "_FEW_NODES", few)
    monkeypatch.setattr(module, "_DROPPED", 0.0)
    rng = np.random.default_rng(0)
    nodes = nodes_of(kind, rng)
    modes, covariances = rng.standard_normal((2 * len(nodes), 6)), some_covariances(rng, 2, 6)
    found = localised(covariances, modes, nodes, RADIUS)
    for ours, covariance in zip(found, covariances, strict=True):
        theirs = slow.localised_covariance(covariance, modes, nodes, RADIUS, slow_taper)
        np.testing.assert_allclose(ours, theirs, atol=error * np.abs(theirs).max())
        np.testing.assert_array_equal(ours, ours.T) if few else np.testing.assert_allclose(
            ours, ours.T, atol=1e-15
        )
        assert np.linalg.eigvalsh(ours).min() > -1e-12 * np.abs(theirs).max()


def test_weak_functions_of_depth_share_a_covariance_and_keep_their_variance():
    rng = np.random.default_rng(3)
    nodes = nodes_of("curvilinear", rng)
    modes = rng.standard_normal((2 * len(nodes), 5))
    anomalies = rng.standard_normal((40, 14, 5)) * np.geomspace(1.0, 1e-4, 14)[:, None]
    functions, apart = vertical_functions(anomalies)
    assert apart == 8
    np.testing.assert_allclose(np.sum(functions[apart:] ** 2), 1.0)
    vertical, horizontal = localised_part(anomalies, ShiftedModes.by(modes, nodes, 1.0), 1e9)
    assert horizontal.shape == (9, 5, 5)
    # without a taper, all that is left out is correlation between functions
    variance = sum(
        np.sum(row**2) * np.trace(horizontal[min(q, 8)]) for q, row in enumerate(vertical)
    )
    assert variance == pytest.approx(np.sum(anomalies**2), rel=1e-8)


def test_nodes_in_groups_give_smooth_modes_nearly_the_same_variance(monkeypatch):
    x, y = (0.13 * axis.ravel() for axis in np.mgrid[:24, :20])
    modes = np.concatenate([np.cos(k * x + m * y) for k in range(4) for m in range(4)])
    modes = modes.reshape(8, -1).T
    anomalies, variance = np.random.default_rng(5).standard_normal((30, 3, 8)), []
    shifted = ShiftedModes.by(modes, np.column_stack([x, y]), 0.0)
    for most, radius in ((2000, 2.4), (120, 2.4), (120, 1e9)):
        monkeypatch.setattr(module, "_MOST_NODES", most)
        found = localised_part(anomalies, shifted, radius)[1]
        variance.append(np.einsum("nr,grs,ns->gn", modes, found, modes))
    near, far = (each / variance[0] for each in variance[1:])
    assert np.mean(near) == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(near, 1.0, rtol=0.1)
    # the taper itself changes more
    assert np.abs(far - 1.0).max() > 0.2


@pytest.mark.parametrize("deficient", [False, True])
def test_the_projector_is_the_pseudo_inverse_and_shifts_in_modes_are_shifts_of_fields(deficient):
    rng = np.random.default_rng(4)
    nodes = nodes_of("land", rng)
    modes = rng.standard_normal((2 * len(nodes), 6))
    if deficient:
        modes[:, 5] = modes[:, 0] - modes[:, 1]
    shifted = ShiftedModes.by(modes, nodes, 1.2)
    to_modes = projector(modes)
    np.testing.assert_allclose(to_modes, np.linalg.pinv(modes), atol=1e-10)
    anomalies = rng.standard_normal((3, 2, 6))
    expected = shifted_copies(anomalies @ modes.T, nodes, 1.2) @ to_modes.T
    np.testing.assert_allclose(shifted.copies(anomalies), expected, atol=1e-12)
