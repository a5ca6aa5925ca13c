"""The prior's fit: the score against a slow twin, and what it must prefer."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator.prior import fit
from replay_kit.estimator.prior.factor import PriorSettings
from replay_kit.estimator.prior.fit import SHARES, Members, choose_settings, score_withheld, scores
from tests.reference import baselines as slow_scores
from tests.reference import estimator as slow
from tests.remembered import score_member


@pytest.fixture(autouse=True)
def _members_are_scored_anew(monkeypatch):
    monkeypatch.setattr(fit, "_score_member", score_member.__wrapped__)


def members_of(seed, n_members, latent, n_side=6, n_levels=2):
    """Members on a square of nodes; ``latent(rng)`` draws one level of one component."""
    rng = np.random.default_rng(seed)
    east, north = np.meshgrid(np.arange(n_side) * 1e4, np.arange(n_side) * 1e4)
    nodes = np.column_stack([east.ravel(), north.ravel()])
    fields = np.array(
        [
            [np.concatenate([latent(rng, nodes), latent(rng, nodes)])] * n_levels
            for _ in range(n_members)
        ]
    )
    return Members(fields, np.eye(2 * len(nodes)), nodes)


def mean_scores(members, settings, left_out):
    """The score of each share, mean over the members left out."""
    return dict(zip(SHARES, scores(members, settings, SHARES, left_out).mean(axis=0), strict=True))


def test_the_score_equals_a_textbook_update_and_quadrature_over_the_noise():
    rng = np.random.default_rng(3)
    members = members_of(0, 5, lambda r, nodes: r.standard_normal(len(nodes)), n_side=2)
    truth = rng.standard_normal((2, 8))
    factor = rng.standard_normal((16, 16))
    prior, rows = factor @ factor.T, members.columns(3, 1)
    design = np.kron(np.eye(2), rows / fit.LEVEL_ERROR_STD)
    mean, cov, _, _ = slow.kalman_update(
        np.zeros(16), prior, design, design @ truth.ravel(), np.eye(12)
    )
    error, std = mean - truth.ravel(), np.sqrt(np.diag(cov))
    scatter = np.sqrt(np.sum((cov @ design.T) ** 2, axis=1))
    noise, weights = np.polynomial.hermite_e.hermegauss(12)
    off = error[:, None] + scatter[:, None] * noise
    crps = [
        [slow_scores.crps_by_quadrature(e, s) for e in each]
        for each, s in zip(off, std, strict=True)
    ]
    by_hand = np.mean(crps @ weights) / weights.sum()
    log_score = score_withheld(members, truth, prior, rows)
    assert log_score == pytest.approx(np.log(by_hand / np.mean(np.abs(truth))), abs=1e-4)


def test_members_of_one_shape_want_the_sample_covariance_and_noise_does_not():
    def long_waves(rng, nodes):
        a, b = rng.standard_normal(2)
        return a * np.sin(nodes[:, 0] / 2e4) + b * np.cos(nodes[:, 1] / 2e4)

    settings = PriorSettings(0.5, 0.0, 3e4)
    waves, noise = (
        mean_scores(members_of(0, 12, each), settings, range(0, 12, 2))
        for each in (long_waves, lambda rng, nodes: rng.standard_normal(len(nodes)))
    )
    assert min(waves, key=waves.get) == max(SHARES)
    assert min(noise, key=noise.get) == min(SHARES)


def test_what_is_set_is_kept_and_what_is_open_is_chosen_alike_each_time():
    members = members_of(0, 6, lambda rng, nodes: rng.standard_normal(len(nodes)), n_side=3)
    fixed = EstimatorConfig(sample_share=0.4, shift_distance=0.0, localisation_radius=5e4)
    assert choose_settings(members, 1e4, fixed) == PriorSettings(0.4, 0.0, 5e4)
    chosen = choose_settings(members, 1e4, EstimatorConfig())
    assert chosen == choose_settings(members, 1e4, EstimatorConfig())
    assert chosen.sample_share in SHARES


@pytest.mark.parametrize(("length", "shift"), [(1e4, 1e4), (2e4, 1e4)])
def test_the_shift_is_a_length_or_half_of_it_as_suits_members_left_out(length, shift):
    """The second is tried with the share that suits the first, and has shares of its own where it is better."""

    def eddies(rng, nodes):
        return np.cos(
            nodes @ rng.standard_normal((2, 6)) / 8e3 + rng.uniform(0.0, 2.0 * np.pi, 6)
        ).sum(axis=1)

    members = members_of(0, 6, eddies, n_side=3)
    start = choose_settings(members, length, EstimatorConfig(shift_distance=length))
    half = replace(start, shift=0.5 * length)
    far, near = (mean_scores(members, tried, range(6)) for tried in (start, half))
    chosen = choose_settings(members, length, EstimatorConfig())
    assert chosen.shift == shift
    better = near[start.sample_share] < min(far.values())
    assert chosen == (replace(half, sample_share=min(near, key=near.get)) if better else start)
