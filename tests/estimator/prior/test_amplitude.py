"""The amplitude of a prior: against its slow twin, its limits, the scaled prior, and what members left out say."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator.basis.modes import build_basis
from replay_kit.estimator.prior.amplitude import (
    AMPLITUDES,
    ScaledPrior,
    fit_amplitude,
    scaled_prior,
)
from replay_kit.estimator.prior.fit import left_out_amplitude, members_in_basis
from replay_kit.estimator.prior.hybrid import PriorSettings, hybrid_prior
from tests import synthetic
from tests.reference import amplitude as slow

SMALL = synthetic.ensemble(n_members=8, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
MEMBERS = members_in_basis(build_basis(SMALL, EstimatorConfig(modes=6)))
SETTINGS = PriorSettings(0.7, 5_000.0, 60_000.0)


def drawn(amplitude, seed, size=40):
    """Return an innovation drawn with an amplitude, and the prior's covariance."""
    rng = np.random.default_rng(seed)
    factor = rng.standard_normal((size, 6))
    cov = factor @ factor.T
    return np.sqrt(amplitude) * factor @ rng.standard_normal(6) + rng.standard_normal(size), cov


@pytest.mark.parametrize(("amplitude", "seed"), [(1.0, 0), (0.3, 1), (4.0, 2), (9.0, 3)])
def test_it_is_the_likeliest_of_a_fine_grid(amplitude, seed):
    innovation, cov = drawn(amplitude, seed)
    assert fit_amplitude(innovation, cov) == pytest.approx(
        slow.fit_amplitude(innovation, cov, *AMPLITUDES), rel=1e-4
    )


@pytest.mark.parametrize(
    ("c", "s", "rel"), [(3.0, 4.0, 1e-4), (-3.0, 2.0, 1e-4), (0.1, 4.0, 1e-3), (100.0, 1.0, 1e-3)]
)
def test_one_direction_has_the_answer_of_a_formula_within_the_limits(c, s, rel):
    # with one eigenvalue s and component c, a s + 1 = c^2
    expected = np.clip((c**2 - 1.0) / s, *AMPLITUDES)
    assert fit_amplitude(np.array([c]), np.array([[s]])) == pytest.approx(expected, rel=rel)


def test_what_was_expected_counts_as_much_as_stated():
    innovation, cov = drawn(4.0, 5)
    found = fit_amplitude(innovation, cov, 0.5)
    assert found == pytest.approx(
        slow.fit_amplitude(innovation, cov, *AMPLITUDES, expected=0.5), rel=1e-4
    )
    assert found < fit_amplitude(innovation, cov)
    # no variance, no information
    assert fit_amplitude(np.array([5.0]), np.array([[0.0]]), 1.7) == pytest.approx(1.7, rel=1e-4)


def test_many_innovations_recover_the_amplitude():
    found = [fit_amplitude(*drawn(4.0, seed)) for seed in range(200)]
    assert np.exp(np.mean(np.log(found))) == pytest.approx(4.0, rel=0.25)


def test_a_scaled_prior_is_the_prior_with_another_covariance():
    prior = hybrid_prior(MEMBERS.weights, MEMBERS.shifted(SETTINGS), SETTINGS)
    scaled, cov = scaled_prior(prior, 2.5), prior.covariance()
    assert isinstance(scaled, ScaledPrior)
    assert scaled.settings == SETTINGS
    np.testing.assert_array_equal(scaled.mean, prior.mean)
    np.testing.assert_allclose(scaled.covariance(), 2.5 * cov, rtol=1e-12)
    np.testing.assert_allclose(scaled.covariance((1,)), 2.5 * prior.covariance((1,)), rtol=1e-12)
    weights = np.random.default_rng(0).standard_normal((2, 3, 6))
    np.testing.assert_allclose(
        scaled.matvec(weights).reshape(2, -1),
        2.5 * weights.reshape(2, -1) @ cov,
        rtol=1e-9,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        scaled.matvec_modes(np.eye(6)).reshape(18, 18), 2.5 * cov, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        scaled.matvec_modes(np.eye(6), (0, 2)),
        2.5 * prior.matvec_modes(np.eye(6), (0, 2)),
        rtol=1e-12,
    )
    np.testing.assert_allclose(scaled.mode_std() ** 2, 2.5 * prior.mode_std() ** 2, rtol=1e-12)


@pytest.mark.parametrize("spread", ["as_given", "fit", None])
def test_words_leave_the_prior_as_it_is(spread):
    prior = hybrid_prior(MEMBERS.weights, MEMBERS.shifted(SETTINGS), SETTINGS)
    assert scaled_prior(prior, spread) is prior


def test_each_member_left_out_is_measured_at_ten_columns_and_noise_adds_its_mean_square():
    logs, few = [], MEMBERS.leading()
    for member in (0, 2, 3, 4, 6, 7):
        others = np.delete(few.weights, member, axis=0)
        cov = hybrid_prior(others, few.shifted(SETTINGS), SETTINGS).covariance()
        h = np.kron(np.eye(3), few.columns(10, member))
        innovation = h @ (few.weights[member] - others.mean(axis=0)).ravel()
        noisy = np.sqrt(np.square(np.linalg.eigh(h @ cov @ h.T)[1].T @ innovation) + 1.0)
        of_prior = np.diag(np.linalg.eigvalsh(h @ cov @ h.T))
        logs.append(np.log(slow.fit_amplitude(noisy, of_prior, *AMPLITUDES)))
    assert left_out_amplitude(MEMBERS, SETTINGS) == pytest.approx(np.exp(np.mean(logs)), rel=1e-3)


def test_of_three_members_none_can_be_left_out():
    assert left_out_amplitude(replace(MEMBERS, weights=MEMBERS.weights[:3]), SETTINGS) == 1.0
    assert left_out_amplitude(replace(MEMBERS, weights=MEMBERS.weights[:4]), SETTINGS) != 1.0
