"""The gate, the softening, errors adapted to a profile, and the watch over the estimate's own errors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Reason
from replay_kit.estimator import build_estimator
from replay_kit.estimator.update.gate import (
    DECISIONS,
    ConsistencyMonitor,
    Spectrum,
    gate_innovations,
    softened_variance,
)
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from tests import synthetic

FEW = np.array([5.0, 60.0, 150.0, 300.0])
ENSEMBLE = synthetic.ensemble(n_members=24, shape=(6, 7), levels=FEW)
TRUST = GatingConfig()
OPEN = GatingConfig(gate="off", adapt_errors=False, inflate=False)


def gate_innovation(innovation, cov, residual, config, is_consistent=True):
    """The gate's decision on one profile."""
    square, dof = (np.array([each]) for each in residual)
    size = np.array([innovation.size])
    spectrum = Spectrum.of(innovation[None], cov[None])
    gates = gate_innovations(spectrum, size, (square, dof), config, is_consistent)
    names = ("statistic", "threshold", "exceeds", "error_factor")
    values = {name: getattr(gates, name)[0] for name in names}
    return SimpleNamespace(decision=DECISIONS[gates.decision[0]], **values)


def sound_profiles(n, noise=0.09):
    truth = Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[:1], None, "member 0")
    return list(random_observations(build_field(truth), n, noise, 7))


def others():
    return Ensemble(ENSEMBLE.grid, ENSEMBLE.velocity[1:], None, "the others")


def rms(estimator, state):
    flow, grid = estimator.flow(state), ENSEMBLE.grid
    at = flow.velocity(grid.east[None], grid.north[None], grid.levels[:, None, None])
    return float(np.sqrt(np.mean((np.moveaxis(at, -1, 0) - ENSEMBLE.velocity[0]) ** 2)))


def test_the_statistic_is_the_textbook_s():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    cov, innovation = root @ root.T, rng.standard_normal(6)
    verdict = gate_innovation(innovation, cov, (0.0, 0), TRUST)
    assert verdict.statistic == pytest.approx(
        innovation @ np.linalg.inv(cov + np.eye(6)) @ innovation
    )
    assert verdict.threshold == pytest.approx(chi2.isf(1e-5, 6))


@pytest.mark.full
def test_a_gate_of_one_in_a_hundred_rejects_about_one_in_a_hundred():
    rng = np.random.default_rng(1)
    cov = np.diag([25.0, 4.0, 1.0, 0.1])
    config = GatingConfig(gate_probability=0.01, adapt_errors=False)
    draws = rng.standard_normal((20_000, 4)) * np.sqrt(np.diag(cov) + 1.0)
    rejected = np.mean(
        [gate_innovation(draw, cov, (0.0, 0), config).decision == "rejected" for draw in draws]
    )
    # two tests of one in a hundred, of which one implies much of the other
    assert 0.01 < rejected < 0.02


def test_a_profile_that_is_wrong_as_a_whole_is_rejected_and_leaves_no_trace():
    estimator = build_estimator(others(), EstimatorConfig(modes=20), TRUST)
    state = estimator.initial()
    for observation in sound_profiles(12):
        state, said = estimator.step(state, observation)
        assert said.decision == "accepted"
        assert 0.0 < said.signal_dof <= said.dof
    wrong = replace(
        observation, velocity=observation.velocity + np.array([1.0, 0.0]), time_ns=10**12
    )
    after, said = estimator.step(state, wrong)
    assert said.decision == "rejected"
    assert not said.accepted
    assert said.signal_dof == 0.0
    np.testing.assert_array_equal(after.mean, state.mean)
    np.testing.assert_array_equal(after.posterior.covariance(), state.posterior.covariance())


def test_noise_beyond_its_stated_error_is_believed_less_not_rejected():
    estimator = build_estimator(others(), EstimatorConfig(modes=20), TRUST)
    (observation,) = sound_profiles(1, noise=0.5)
    _, said = estimator.step(
        estimator.initial(), replace(observation, error_std=np.full(observation.depth.size, 0.05))
    )
    assert said.decision == "accepted"
    assert 30.0 < said.error_inflation < 300.0  # (0.5 / 0.05)^2 = 100


def test_a_softened_outlier_moves_the_estimate_by_k_standard_deviations_at_most():
    for innovation in (0.1, 1.0, 10.0, 1e3, 1e6):
        prior, error, factor = 2.0, 1.0, 2.0
        grown = float(
            softened_variance(np.array([prior]), error, np.array([innovation]), factor)[0]
        )
        move = prior / (prior + grown) * innovation
        assert move <= factor * np.sqrt(prior) * 1.0001
        if innovation <= 0.1:
            assert grown == pytest.approx(error, rel=1e-2)
    estimator = build_estimator(others(), EstimatorConfig(modes=20), GatingConfig(gate="soften"))
    state = estimator.initial()
    for observation in sound_profiles(6):
        state, said = estimator.step(state, observation)
    _, said = estimator.step(state, replace(observation, velocity=observation.velocity + 1.0))
    assert said.decision == "softened"
    assert said.accepted


@pytest.mark.parametrize("gate", ["reject", "soften"])
def test_outliers_cost_little_with_a_gate_and_much_without(gate):
    profiles = sound_profiles(60)
    rng = np.random.default_rng(3)
    bad = rng.permutation(60)[:6]
    planted = []
    for k, profile in enumerate(profiles):
        angle = rng.uniform(0, 2 * np.pi)
        offset = np.array([np.cos(angle), np.sin(angle)]) if k in bad else np.zeros(2)
        planted.append(replace(profile, velocity=profile.velocity + offset))
    errors = {}
    for name, gating, log in (
        ("clean", TRUST, profiles),
        ("gate", GatingConfig(gate=gate), planted),
        ("open", OPEN, planted),
    ):
        estimator = build_estimator(others(), EstimatorConfig(modes=20), gating)
        *_, (state, _) = estimator.steps(estimator.initial(), log)
        errors[name] = rms(estimator, state)
    assert errors["open"] > 1.5 * errors["clean"]
    assert errors["gate"] < (1.05 if gate == "reject" else 1.3) * errors["clean"]


def test_the_same_profile_twice_counts_once():
    estimator = build_estimator(others(), EstimatorConfig(modes=20), TRUST)
    first, second = sound_profiles(2)
    state, _ = estimator.step(estimator.initial(), first)
    again, said = estimator.step(state, replace(first, velocity=first.velocity.copy()))
    assert again is state
    assert np.all(said.reasons & Reason.DUPLICATE)
    both = list(estimator.steps(estimator.initial(), [first, first, second]))
    once = list(estimator.steps(estimator.initial(), [first, second]))
    np.testing.assert_allclose(both[-1][0].mean, once[-1][0].mean, atol=1e-12)


def test_what_contradicts_an_estimate_that_has_not_been_right_is_softened_not_rejected():
    """An ensemble of another place: nearly every profile lies beyond the gate, and all of them count."""
    elsewhere = Ensemble(ENSEMBLE.grid, 0.02 * ENSEMBLE.velocity[1:], None, "too weak")
    estimator = build_estimator(elsewhere, EstimatorConfig(modes=20), GatingConfig(inflate=False))
    state, decisions = estimator.initial(), []
    profiles = sound_profiles(12, noise=0.02)
    for observation in profiles:
        state, said = estimator.step(state, observation)
        decisions.append(said.decision)
    assert decisions[0] == "softened"
    assert "rejected" not in decisions[:5]
    assert rms(estimator, state) < rms(estimator, estimator.initial())


def test_profiles_that_contradict_one_another_end_finite_and_positive():
    estimator = build_estimator(others(), EstimatorConfig(modes=20), TRUST)
    (observation,) = sound_profiles(1)
    state = estimator.initial()
    for k in range(40):
        side = 0.4 if k % 2 else -0.4
        state, _ = estimator.step(
            state, replace(observation, velocity=observation.velocity + side, time_ns=k)
        )
    cov = state.posterior.covariance()
    assert np.isfinite(state.mean).all()
    assert np.linalg.eigvalsh(cov).min() > -1e-12 * np.trace(cov)


def test_an_overconfident_estimate_is_noticed_and_grows_its_errors():
    """Members shrunk to a tenth of their spread: nearly all sound profiles lie outside."""
    small = others()
    mean = small.velocity.mean(axis=0)
    shrunk = Ensemble(small.grid, mean + 0.1 * (small.velocity - mean), None, "shrunk")
    watched = build_estimator(shrunk, EstimatorConfig(modes=20), TRUST)
    blind = build_estimator(shrunk, EstimatorConfig(modes=20), GatingConfig(inflate=False))
    profiles, states, grown, errors = sound_profiles(100), [], [], []
    for estimator in (watched, blind):
        state, at = estimator.initial(), (0.0, 0.0, 100.0)
        for observation in profiles:
            state, said = estimator.step(state, observation)
            grown.append(said.prior_inflation)
            errors.append(estimator.flow(state).standard_error(*at))
        states.append(state)
    assert max(grown[:100]) > 1.5
    assert max(grown[100:]) == 1.0
    assert rms(watched, states[0]) < rms(blind, states[1])
    first = int(np.argmax(np.array(grown) > 1.0))
    ratio = (np.array(errors[first]) / errors[100 + first]) ** 2
    np.testing.assert_allclose(ratio, grown[first], rtol=1e-6)


def test_the_watch_ignores_one_bad_profile_in_ten_and_sees_one_in_two():
    sound, bad = (
        gate_innovations(
            Spectrum.of(np.full((1, 16), np.sqrt(nis / 16)), np.zeros((1, 16, 16))),
            np.array([16]),
            (np.zeros(1), np.zeros(1, np.intp)),
            TRUST,
        )
        for nis in (16.0, 400.0)
    )
    watch = ConsistencyMonitor()
    for k in range(200):
        watch, grown = watch.updated(bad if k % 10 == 0 else sound, TRUST)
        assert grown == 1.0
    growth = []
    for k in range(40):
        watch, grown = watch.updated(bad if k % 2 else sound, TRUST)
        growth.append(grown)
    # the median between ten sound and ten bad ones is 13, a growth 2 at most
    assert max(growth) == 2.0
    for _ in range(400):
        watch, grown = watch.updated(bad, TRUST)
        growth.append(grown)
    assert np.prod(growth) == pytest.approx(4.0)
