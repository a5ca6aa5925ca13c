"""What is expected of a mean current: the shares of its ellipses and its density, and what the last dive alone says."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from replay_kit.estimator.next_dive.mixture import Mixture, Persistence


def test_the_radii_of_a_mixture_hold_their_shares():
    mixture = Mixture(
        np.log([0.7, 0.3]),
        np.array([[0.0, 0.0], [0.3, 0.1]]),
        np.array([0.01, 0.2])[:, None, None] * np.eye(2),
    )
    rng = np.random.default_rng(0)
    chosen = rng.choice(2, 40_000, p=[0.7, 0.3])
    noise = np.sqrt(mixture.covs[chosen, 0, 0, None]) * rng.standard_normal((40_000, 2))
    draws = mixture.means[chosen] + noise
    about = draws - mixture.mean
    radius = np.sqrt(np.einsum("ni,ij,nj->n", about, np.linalg.inv(mixture.cov), about))
    for share, found in zip((0.5, 0.9), mixture.radii([0.5, 0.9]), strict=True):
        assert np.mean(radius <= found) == pytest.approx(share, abs=0.02)
    density = np.log(
        sum(
            w * multivariate_normal(m, c).pdf([0.1, 0.1])
            for w, m, c in zip([0.7, 0.3], mixture.means, mixture.covs, strict=True)
        )
    )
    assert mixture.log_density(np.array([0.1, 0.1])) == pytest.approx(density)


def test_persistence_is_students_t_of_the_changes():
    baseline, velocities = Persistence(), np.random.default_rng(1).normal(0.0, 0.1, (5, 2))
    assert np.isnan(baseline.log_density(velocities[0]))
    for velocity in velocities[:4]:
        baseline = baseline.after(velocity)
    changes = np.diff(velocities[:4], axis=0)
    scale = np.sum(changes**2) / 6.0
    expected = multivariate_t(velocities[3], scale * np.eye(2), df=6)
    assert baseline.log_density(velocities[4]) == pytest.approx(expected.logpdf(velocities[4]))
    draws = expected.rvs(40_000, random_state=0) - velocities[3]
    assert np.mean(np.hypot(*draws.T) <= baseline.radius(0.9)) == pytest.approx(0.9, abs=0.01)
