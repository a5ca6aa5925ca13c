"""The gate, errors adapted to a profile, and a prior that most measurements contradict."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from replay_kit import Observation
from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build, embed_member
from replay_kit.estimator.update.judge import judged_layout
from tests import synthetic
from tests.estimator.seas import CONFIG, SEA, profiles, relative

SEEN = synthetic.ensemble(n_members=24, shape=(6, 7))
OTHERS = replace(SEEN, velocity=SEEN.velocity[1:])
DEFAULT = EstimatorConfig(modes=20)
TRUTH = embed_member(SEEN, 0, DEFAULT)


def sound(n, noise=0.09, stated=0.09):
    """Profiles of the member that the estimate does not know."""
    rng, out = np.random.default_rng(7), []
    for k, each in enumerate(synthetic.random_profiles(SEEN.grid, n, 3)):
        place = rng.uniform(0.8 * SEEN.grid.nodes.min(axis=0), 0.8 * SEEN.grid.nodes.max(axis=0))
        velocity = TRUTH.velocity(*place, each.depth)
        velocity += noise * rng.standard_normal(velocity.shape)
        out.append(synthetic.profile(SEEN.grid, *place, each.depth, velocity, stated, time_ns=k))
    return out


def narrowed(share):
    """The others with their spread multiplied."""
    mean = OTHERS.velocity.mean(axis=0)
    return replace(OTHERS, velocity=mean + share * (OTHERS.velocity - mean))


def errors(estimator, state):
    """Root mean square of the error, and mean square over the standard error's."""
    grid, flow = SEEN.grid, estimator.flow(state)
    at = grid.east[None], grid.north[None], grid.levels[:, None, None]
    off = flow.velocity(*at) - TRUTH.velocity(*at)
    return np.sqrt(np.mean(off**2)), np.mean((off / flow.standard_error(*at)) ** 2)


@pytest.mark.parametrize(("square", "scale"), [(0.0, 1.0), (20.0, 1.0), (90.0, 9.0)])
def test_the_statistic_is_the_textbook_s_with_errors_as_large_as_the_noise(square, scale):
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    cov, innovation = root @ root.T, rng.standard_normal(6)
    # beside others of its column
    each, squares = np.stack([innovation, 2.0 * innovation]), np.array([square, 50.0])
    verdict = judged_layout(each, cov, (squares, 10), 1e-5)
    inverse = np.linalg.inv(cov + scale * np.eye(6))
    assert verdict.statistic[0] == pytest.approx(innovation @ inverse @ innovation)
    assert verdict.error_factor.tolist() == pytest.approx([scale, 5.0])
    assert verdict.threshold.tolist() == pytest.approx([chi2.isf(1e-5, 6)] * 2)
    stated = np.linalg.inv(cov + np.eye(6))
    assert verdict.nis[0] == pytest.approx(innovation @ stated @ innovation + square)
    trusting = judged_layout(1e3 * each, cov, (1e6 * squares, 10), None)
    assert (trusting.error_factor == 1.0).all()
    assert trusting.accepted.all()


def test_scatter_is_believed_less_and_what_is_wrong_as_a_whole_is_rejected():
    estimator, log = build([OTHERS], DEFAULT, GatingConfig()), sound(13)
    state, steps = estimator.assimilate(estimator.initial(), log[:12])
    for step in steps:
        assert step.innovation.accepted
        assert 0.0 < step.innovation.signal_dof <= step.innovation.dof
    wrong = replace(log[12], velocity=log[12].velocity + np.array([1.0, 0.0]))
    _, (step,) = estimator.assimilate(state, [wrong])
    assert (step.innovation.decision, step.innovation.signal_dof) == ("rejected", 0.0)
    assert step.innovation.gate_statistic > step.innovation.gate
    _, (step,) = estimator.assimilate(estimator.initial(), sound(1, 0.9))
    assert step.innovation.accepted
    assert 30.0 < step.innovation.error_inflation < 300.0


@pytest.mark.parametrize("change", [relative, lambda p: replace(p, platform_velocity=(0.1, 0.2))])
def test_the_gate_does_not_depend_on_rounding(change):
    """More functions of depth than independent ones: no row may be made of their rounding."""
    time = TimeConfig(biases=("heading", "shear"))
    estimator, profile = build([SEA], CONFIG, GatingConfig(), time), change(profiles(1)[0])
    near = profile.error_std * (1.0 + 1e-15 * np.arange(6)[:, None])
    log = [replace(profile, error_std=each) for each in near]
    steps = [estimator.assimilate(estimator.initial(), [each])[1][0] for each in log]
    statistics = [step.innovation.gate_statistic for step in steps]
    np.testing.assert_allclose(statistics, statistics[0], rtol=1e-9)


@pytest.mark.parametrize(("share", "stated", "refuted"), [(0.2, 0.09, False), (0.05, 0.02, True)])
def test_a_prior_that_is_far_too_narrow_is_widened_and_said(share, stated, refuted):
    """By the evidence, or, where the gate rejects nearly all, by what it rejected."""
    estimator, log = build([narrowed(share)], DEFAULT, GatingConfig()), sound(60, 0.02, stated)
    state, steps = estimator.assimilate(estimator.initial(), log)
    decisions = [step.innovation.decision for step in steps]
    assert (decisions[:10].count("rejected") >= 6) == refuted
    assert "rejected" not in decisions[16:]
    assert state.scale > 4.0
    assert state.doubt is None
    assert "variance of the ensemble was multiplied by" in " ".join(estimator.remarks(state))
    assert errors(estimator, state)[1] < 2.0
    as_given = DEFAULT.model_copy(update={"spread": "as_given"})
    blind = build([narrowed(share)], as_given, GatingConfig())
    assert errors(blind, blind.assimilate(blind.initial(), log)[0])[1] > 5.0


@pytest.mark.parametrize(("size", "waves", "depth"), [(0.12, 0.0, np.inf), (0.2, 0.017, 200.0)])
def test_an_unknown_tide_or_internal_wave_is_an_error_of_each_profile(size, waves, depth):
    estimator, log = build([OTHERS], DEFAULT, GatingConfig()), []
    for k, one in enumerate(sound(40, 0.02, 0.02)):
        phase = 2.1 * k + waves * one.depth[:, None] + np.array([0.0, 1.6])
        log.append(replace(one, velocity=one.velocity + size * np.cos(phase)))
    state, _ = estimator.assimilate(estimator.initial(), log)
    assert (state.scale < 2.0, state.revised.depth) == (True, depth)
    assert errors(estimator, state)[1] < 1.5
    assert "more than stated" in estimator.remarks(state)[-1]


def test_a_variance_far_above_the_ensemble_s_is_said_before_it_changes_the_prior():
    estimator = build([narrowed(0.3)], DEFAULT, GatingConfig())
    state, _ = estimator.assimilate(estimator.initial(), sound(7, 0.02))
    assert state.scale == 1.0
    assert "hardly" in estimator.remarks(state)[0]


@pytest.mark.parametrize("refused", [False, True])
def test_means_that_agree_with_the_prior_keep_rejected_profiles_from_widening_it(refused):
    """Of each dive two wrong profiles and its mean; a prior that is too narrow refuses the means too."""
    estimator, log = build([narrowed(0.05)], DEFAULT, GatingConfig()), sound(24, 0.02, 0.02)
    flow, both, hour = estimator.flow(estimator.initial()), [], 3600 * 10**9
    for k, one in enumerate(log[::2]):
        place = one.longitude, one.latitude
        wrong = [replace(each, velocity=each.velocity + 2.0) for each in log[2 * k : 2 * k + 2]]
        true = flow.velocity_at(*place, np.linspace(0.0, 100.0))
        begin = 450_000 * hour + k * hour
        ends = ((begin + part * hour // 4, *place) for part in (1, 2))
        mean = Observation.mean(*ends, 100.0, true.u.mean() + refused, true.v.mean(), 0.02)
        both += [*(replace(each, time_ns=begin) for each in wrong), mean]
    state, _ = estimator.assimilate(estimator.initial(), both)
    assert (state.scale > 1.0) == refused


@pytest.mark.parametrize("wrong", [slice(8), slice(1, None, 2)])
def test_an_instrument_that_fails_at_first_or_now_and_then_does_not_widen_the_prior(wrong):
    estimator, log = build([OTHERS], DEFAULT, GatingConfig()), sound(40)
    log[wrong] = [
        replace(each, velocity=each.velocity + np.array([2.0, 0.0])) for each in log[wrong]
    ]
    state, steps = estimator.assimilate(estimator.initial(), log)
    decisions = {step.innovation.decision for step in steps[wrong]}
    assert (decisions, state.scale, state.doubt) == ({"rejected"}, 1.0, None)
    assert errors(estimator, state)[1] < 1.5
    assert not estimator.remarks(state)
