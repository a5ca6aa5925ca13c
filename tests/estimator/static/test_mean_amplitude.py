"""The average over the variance of the mean's amplitude: the mixture it stands for, from the past only, the same however it is called."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import to_local
from replay_kit.estimator import build_estimator
from replay_kit.estimator.prior.amplitude import MeanAmplitude, before_the_log, mixture
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.representation import PosteriorCovariance
from replay_kit.estimator.windows.handover import hand_over
from replay_kit.workflows.replay.store.pickling import dump, load
from tests import synthetic
from tests.estimator.runs import after, rows_of
from tests.reference import estimator as slow

GIVEN = synthetic.ensemble(n_members=7, shape=(6, 7), levels=np.array([5.0, 90.0, 220.0]))
# so that the mean counts: members agree on a current along the region
STRONG = replace(GIVEN, velocity=GIVEN.velocity + np.array([0.5, 0.2])[:, None, None, None])
CONFIG = EstimatorConfig(modes=None)
ESTIMATOR = build_estimator(STRONG, CONFIG)
VARIANCES, WEIGHTS = (0.0, 0.03, 0.1, 0.3), (0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3)


def profiles(n, factor=1.0, seed=0):
    """Profiles of the mean current times a factor, with the noise that they state."""
    flow, rng, out = ESTIMATOR.flow(ESTIMATOR.initial()), np.random.default_rng(seed), []
    for profile in synthetic.random_profiles(GIVEN.grid, n, seed=seed):
        east, north = to_local(GIVEN.grid.projection, profile.longitude, profile.latitude)
        mean = flow.velocity(east, north, profile.depth, true_axes=True)
        out.append(
            replace(
                profile,
                velocity=factor * mean
                + profile.error_std[:, None] * rng.standard_normal(mean.shape),
            )
        )
    return out


def twin(observations):
    """Mean and covariance of the weights: one dense update for each variance, averaged with their densities of all that was measured."""
    design, values = rows_of(ESTIMATOR, observations)
    mean = ESTIMATOR.basis.mean_weights.ravel()
    certain = ESTIMATOR.prior.covariance() - before_the_log().variance * np.outer(mean, mean)
    return slow.mixture_update(
        ESTIMATOR.prior.mean,
        [certain + k * np.outer(mean, mean) for k in VARIANCES],
        np.array(WEIGHTS),
        design,
        values,
    )


@pytest.mark.parametrize(("count", "factor"), [(1, 1.0), (3, 1.0), (3, 0.4), (8, 0.7)])
def test_it_is_the_mixture_over_the_variances(count, factor):
    observations = profiles(count, factor)
    # members without anomalies do not move the centre
    still = np.repeat(ESTIMATOR.basis.member_weights[:1], 3, axis=0)
    basis = replace(ESTIMATOR.basis, member_weights=still)
    state = after(replace(ESTIMATOR, basis=basis), observations)
    mean, covariance = twin(observations)
    np.testing.assert_allclose(state.mean, mean, atol=1e-8)
    if state.mean_amplitude.variance < 0.3:
        np.testing.assert_allclose(state.posterior.covariance(), covariance, atol=1e-8)
    else:
        # of a mixture of two peaks the variance is that of its widest Gaussian
        np.testing.assert_allclose(
            np.trace(state.posterior.covariance()), np.trace(covariance), rtol=0.05
        )


def test_a_mean_that_is_too_strong_is_found_out():
    right, wrong = (after(ESTIMATOR, profiles(10, factor)).mean_amplitude for factor in (1.0, 0.4))
    assert right.variance < 0.01 < wrong.variance


def test_before_the_log_it_is_the_average_and_a_likelihood_of_nothing_changes_nothing():
    begun = before_the_log()
    assert begun.variance == pytest.approx(np.dot(VARIANCES, WEIGHTS))
    assert mixture(0.0, 0.0) == (0.0, pytest.approx(begun.variance))
    same = pytest.approx(begun.variance)
    assert begun.averaged(0.0, 0.0, 1) == MeanAmplitude(pytest.approx(0.0), same, 1)


def test_online_in_blocks_and_from_a_checkpoint_are_the_same():
    observations = profiles(40, 0.6)
    online = after(ESTIMATOR, observations)
    *_, (at_once, _) = ESTIMATOR.steps(ESTIMATOR.initial(), observations)
    half = pickle.loads(pickle.dumps(after(ESTIMATOR, observations[:13])))
    half = after(ESTIMATOR, observations[13:], half)
    assert online.mean_amplitude.profiles is None or online.mean_amplitude.profiles >= 8
    for other in (at_once, half):
        np.testing.assert_allclose(other.mean, online.mean, rtol=1e-8, atol=1e-10)
        assert other.mean_amplitude.shift == pytest.approx(online.mean_amplitude.shift, abs=1e-9)


def test_a_state_stays_as_it_is_when_others_go_on_from_it():
    observations = profiles(6, 0.6)
    state = after(ESTIMATOR, observations[:3])
    before = state.mean.copy(), state.posterior.covariance()
    for order in (observations[3:], observations[:2:-1]):
        after(ESTIMATOR, order, state)
    np.testing.assert_array_equal(state.posterior.covariance(), before[1])
    np.testing.assert_array_equal(state.mean, before[0])


def test_the_innovation_published_was_predicted_before_the_average():
    observations = profiles(3, 0.5)
    before = after(ESTIMATOR, observations[:2])
    _, said = ESTIMATOR.step(before, observations[2])
    np.testing.assert_allclose(
        said.innovation, ESTIMATOR.innovation(before, observations[2]), rtol=1e-9, atol=1e-12
    )


def test_a_checkpoint_holds_the_amplitude_and_not_the_prior(tmp_path):
    state = after(ESTIMATOR, profiles(3, 0.5))
    with (tmp_path / "state").open("wb") as file:
        dump(state, file, known=ESTIMATOR.common_part)
    with (tmp_path / "state").open("rb") as file:
        again = load(file, known=ESTIMATOR.common_part)
    assert again.posterior.prior.base is ESTIMATOR.prior
    np.testing.assert_array_equal(again.mean, state.mean)
    factors = PosteriorCovariance(again.posterior).factors()
    if factors is not None:
        np.testing.assert_allclose(factors(None), state.posterior.covariance(), atol=1e-12)


def test_a_group_counts_as_one_profile():
    (profile,) = profiles(1, 0.5)
    group = ProfileGroup((profile, replace(profile, time_ns=profile.time_ns + 10**9)))
    (*_, last) = ESTIMATOR.group_steps(ESTIMATOR.initial(), [group])
    assert last.after.mean_amplitude.profiles == 1
    assert last.after.mean_amplitude.variance > before_the_log().variance


def test_a_variance_that_is_given_stays():
    for variance in (0.0, 0.1):
        estimator = build_estimator(STRONG, CONFIG.model_copy(update={"mean_variance": variance}))
        assert after(estimator, profiles(3)).mean_amplitude is None
    assert (
        build_estimator(STRONG, CONFIG.model_copy(update={"spread": "fit"})).mean_amplitude is None
    )


def test_the_next_window_has_the_amplitude_and_keeps_it():
    state = after(ESTIMATOR, profiles(5, 0.5))
    begun, _ = hand_over(ESTIMATOR, state, ESTIMATOR)
    assert begun.mean_amplitude == state.mean_amplitude.ended()
    np.testing.assert_allclose(
        ESTIMATOR.flow(begun).velocity(0.0, 0.0, 50.0),
        ESTIMATOR.flow(state).velocity(0.0, 0.0, 50.0),
        atol=0.02,
    )
    again, _ = ESTIMATOR.step(begun, profiles(6, 0.5)[5])
    assert again.mean_amplitude == begun.mean_amplitude
