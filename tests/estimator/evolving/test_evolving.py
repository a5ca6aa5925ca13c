"""The estimate through time: against one joint Gaussian, against the static filter, and by what time does to it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Reason
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.evolving.state_space import StateSpace
from replay_kit.estimator.update.rows import kalman_update
from tests import synthetic
from tests.estimator.runs import after
from tests.reference import evolving as slow

DAY = 86_400 * 10**9
LEVELS = np.array([5.0, 90.0, 220.0])
CONFIG = EstimatorConfig(modes=12, sample_share=0.6, mean_variance=0.1)
WHOLE = TimeConfig(dropped_std=0.0)


def forecasts(n_times=3, n_members=6, days=4.0):
    """An ensemble whose members drift from what they are to something else, more and more."""
    first, last = (
        synthetic.ensemble(seed, n_members=n_members, shape=(4, 5), levels=LEVELS)
        for seed in (0, 50)
    )
    out = []
    for k in range(n_times):
        share = k / max(n_times - 1, 1)
        velocity = np.cos(share) * first.velocity + np.sin(share) * last.velocity
        out.append(
            Ensemble(
                first.grid,
                (0.5 + share) * velocity,
                int(k * days * DAY / max(n_times - 1, 1)),
                "synthetic",
            )
        )
    return out


def profiles(n, days=4.0, seed=2):
    grid = forecasts(1)[0].grid
    return [
        replace(p, time_ns=int((k + 0.5) * days * DAY / n))
        for k, p in enumerate(synthetic.random_profiles(grid, n, seed, speed=0.1))
    ]


def rows_of(estimator, observation, static):
    """The observation's rows of the weights, and its values about the offset."""
    used = np.flatnonzero(observation.depth <= LEVELS[-1])
    rows = static.rows(observation, used)
    return rows.design(), rows.y


def inflated_rows(estimator, observations, static):
    """Return the rows of observations and their values, whitened by the errors with which the filter uses them."""
    state, designs, values = estimator.initial(), [], []
    for observation in observations:
        state, innovation = estimator.step(state, observation)
        design, value = rows_of(estimator, observation, static)
        designs.append(design / np.sqrt(innovation.error_inflation))
        values.append(value / np.sqrt(innovation.error_inflation))
    return designs, values


def test_the_filter_is_the_joint_gaussian_of_all_observations():
    members = forecasts()
    estimator = build_evolving(members, CONFIG, TimeConfig(scale=2 * 86_400.0, dropped_std=0.0))
    pooled = replace(members[0], velocity=np.concatenate([m.velocity for m in members]))
    static = build_estimator(pooled, CONFIG)
    observations = profiles(9)
    designs, values = inflated_rows(estimator, observations, static)
    state = after(estimator, observations)
    times = [o.time_ns for o in observations]
    for at in (times[-1], times[-1] + DAY):
        mean, cov = slow.joint(estimator.operator.process, designs, times, values, at)
        later = estimator.predict(state, at)
        flow = estimator.flow(estimator.predict(state, at))
        np.testing.assert_allclose(
            estimator.weights([later])[0], mean, atol=1e-9 * np.abs(mean).max()
        )
        np.testing.assert_allclose(flow.weight_cov, cov, atol=1e-9 * np.abs(cov).max())
        assert flow.time_ns == at


# of several times other members stand for all where the representation error is found, so it is stated there
@pytest.mark.parametrize(("n_times", "error_std"), [(1, None), (3, 0.02)])
def test_without_forgetting_and_change_it_is_the_static_filter(n_times, error_std):
    (only,), config = (
        forecasts(1),
        CONFIG.model_copy(update={"representation_error_std": error_std}),
    )
    members = [replace(only, time_ns=k * DAY) for k in range(n_times)]
    estimator = build_evolving(members, config, TimeConfig(scale="static", dropped_std=0.0))
    static = build_estimator(only, config)
    state, still = estimator.initial(), static.initial()
    for observation in profiles(12):
        state, said = estimator.step(state, observation)
        still, expected = static.step(still, observation)
        assert said.nis == pytest.approx(expected.nis, rel=1e-9)
        assert said.dof == expected.dof
        np.testing.assert_allclose(said.innovation_std, expected.innovation_std, rtol=1e-10)
        np.testing.assert_allclose(said.residual, expected.residual, atol=1e-12)
    grid = only.grid
    at = grid.east, grid.north, np.full(grid.east.shape, 60.0)
    flow, other = estimator.flow(state), static.flow(still)
    np.testing.assert_allclose(flow.velocity(*at), other.velocity(*at), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        flow.standard_error(*at), other.standard_error(*at), rtol=0.0, atol=1e-12
    )


def test_uncertainty_grows_from_the_last_observation_towards_the_forecast_s():
    estimator = build_evolving(forecasts(), CONFIG, TimeConfig(scale=86_400.0))
    state = after(estimator, profiles(12))
    grid = forecasts(1)[0].grid
    at = grid.east.ravel(), grid.north.ravel(), np.full(grid.east.size, 60.0)
    # beyond the last forecast its spread stays, so what grows is forgetting alone
    errors = [
        estimator.flow(estimator.predict(state, 4 * DAY + k * DAY)).standard_error(*at)
        for k in range(5)
    ]
    for before, later in pairwise(errors):
        assert np.all(later > before)
    prior = estimator.flow(estimator.predict(estimator.initial(), 40 * DAY)).standard_error(*at)
    np.testing.assert_allclose(
        estimator.flow(state).at(40 * DAY).standard_error(*at), prior, rtol=1e-6
    )


def test_an_estimate_for_a_later_time_is_that_of_the_predicted_state():
    """Also where the state has biases and oscillations beside the process."""
    time = TimeConfig(scale=86_400.0, oscillators=("inertial",), biases=("heading",))
    estimator = build_evolving(forecasts(), CONFIG, time)
    state = after(estimator, profiles(12))
    for time_ns in (DAY, 4 * DAY, 6 * DAY):
        predicted, later = (
            estimator.flow(estimator.predict(state, time_ns)),
            estimator.flow(state).at(time_ns),
        )
        assert predicted.time_ns == later.time_ns == max(time_ns, state.time_ns)
        np.testing.assert_allclose(later.latent, predicted.latent, rtol=1e-12)
        np.testing.assert_allclose(later.weight_cov, predicted.weight_cov, rtol=1e-9, atol=1e-14)


def test_before_any_observation_the_estimate_is_the_forecast_between_its_times():
    members = forecasts()
    estimator = build_evolving(members, CONFIG, WHOLE)
    grid = members[0].grid
    flow = estimator.flow(
        estimator.predict(estimator.initial(), DAY)
    )  # halfway between the first two
    between = 0.5 * (members[0].velocity.mean(axis=0) + members[1].velocity.mean(axis=0))
    velocity = flow.velocity(grid.east[None], grid.north[None], LEVELS[:, None, None])
    rest = np.sqrt(np.mean((np.moveaxis(velocity, -1, 0) - between) ** 2))
    assert rest < 0.1 * np.sqrt(np.mean(between**2))


def test_the_scale_is_read_off_the_members_own_change():
    """Anomalies that keep a share of themselves a day."""
    rng = np.random.default_rng(0)
    (only,) = forecasts(1, n_members=40)
    kept, fields = 0.7, [rng.standard_normal(only.velocity.shape)]
    for _ in range(5):
        fields.append(
            kept * fields[-1] + np.sqrt(1 - kept**2) * rng.standard_normal(only.velocity.shape)
        )
    members = [replace(only, velocity=field, time_ns=k * DAY) for k, field in enumerate(fields)]
    estimator = build_evolving(members, EstimatorConfig(modes=None, sample_share=0.6), TimeConfig())
    assert estimator.operator.process.local_scale == pytest.approx(
        -86_400.0 / np.log(kept), rel=0.1
    )
    assert estimator.operator.process.trajectory_scale == 5 * estimator.operator.process.local_scale


def test_dropped_directions_are_as_small_as_promised():
    members = forecasts(n_members=8)
    whole, few = (
        build_evolving(members, CONFIG, TimeConfig(dropped_std=bound)) for bound in (0.0, 0.02)
    )
    assert few.state_space.size < whole.state_space.size
    grid = members[0].grid
    at = grid.east.ravel()[:, None], grid.north.ravel()[:, None], LEVELS[None, :]
    for time_ns in (0, 4 * DAY):
        variances = [
            estimator.flow(estimator.predict(estimator.initial(), time_ns)).standard_error(*at) ** 2
            for estimator in (whole, few)
        ]
        assert 0.0 < (variances[0] - variances[1]).max() <= 0.02**2 * 1.01


def test_an_observation_older_than_the_state_is_left_out_and_says_so():
    estimator = build_evolving(forecasts(), CONFIG, WHOLE)
    first, second = profiles(2)
    state, _ = estimator.step(estimator.initial(), second)
    same, said = estimator.step(state, first)
    assert same is state
    assert said.decision == "rejected"
    assert np.all(said.reasons & Reason.OUT_OF_ORDER)


def test_a_rejected_profile_leaves_the_state_untouched():
    estimator = build_evolving(forecasts(), CONFIG, WHOLE, GatingConfig())
    log = profiles(6)
    state, last = after(estimator, log), log[-1]
    wrong = replace(last, velocity=last.velocity + 3.0, time_ns=last.time_ns + DAY // 10)
    same, said = estimator.step(state, wrong)
    assert said.decision == "rejected"
    assert same.time_ns == state.time_ns
    np.testing.assert_array_equal(same.mean, state.mean)
    np.testing.assert_array_equal(same.cov, state.cov)


@pytest.mark.full
def test_a_million_updates_keep_the_covariance_symmetric_and_positive():
    """The update itself, on few unknowns: what a log of weeks at 1 Hz asks of it."""
    rng = np.random.default_rng(5)
    n, none = 6, np.empty(0, dtype=np.intp)
    scales = np.array([np.inf, np.inf, np.inf, 1e4, 1e5, 1e7])
    layout = StateSpace(scales, none, none, np.empty(0), {})
    mean, cov = np.zeros((n, 1)), np.eye(n)
    designs = rng.standard_normal((64, 2, n)) * 10.0
    designs[:8] *= 1e3  # nearly without error
    designs[8:16] = designs[0]  # the same direction over and over
    smallest = []
    for k in range(20_000):
        mean, cov = layout.predict(mean, cov, 1.0)
        mean, cov = kalman_update(mean, cov, designs[k % 64], rng.standard_normal((2, 1)))
        if k % 500 == 0:
            smallest.append(np.linalg.eigvalsh(cov).min() / np.linalg.eigvalsh(cov).max())
    np.testing.assert_array_equal(cov, cov.T)
    assert min(smallest) > 0.0
    assert np.isfinite(mean).all()


def test_members_that_begin_from_one_analysis_tell_nothing_there():
    """At the first time all members are the same: scale and local directions come from the other times."""
    later = forecasts(4, days=6.0)
    same = replace(
        later[0], velocity=np.repeat(later[0].velocity[:1], len(later[0].velocity), axis=0)
    )
    certain = CONFIG.model_copy(update={"mean_variance": 0.0})
    whole, begun = (
        build_evolving(series, certain, TimeConfig()) for series in (later[1:], [same, *later[1:]])
    )
    assert begun.operator.process.local_scale == pytest.approx(
        whole.operator.process.local_scale, rel=0.1
    )
    start = begun.flow(begun.predict(begun.initial(), same.time_ns)).standard_error(0.0, 0.0, 60.0)
    assert np.all(start < 1e-6)
    np.testing.assert_allclose(
        begun.flow(begun.predict(begun.initial(), later[-1].time_ns)).standard_error(
            0.0, 0.0, 60.0
        ),
        whole.flow(whole.predict(whole.initial(), later[-1].time_ns)).standard_error(
            0.0, 0.0, 60.0
        ),
        rtol=0.1,
    )


def test_an_estimate_that_is_contradicted_grows_its_covariance_by_two_at_the_most_at_once():
    trusts = [
        GatingConfig(gate="off", adapt_errors=False, inflation_profiles=4, inflate=watch)
        for watch in (True, False)
    ]
    watching, blind = (build_evolving(forecasts(), CONFIG, WHOLE, gating) for gating in trusts)
    grown, other = watching.initial(), blind.initial()
    for k, observation in enumerate(profiles(4)):
        strong = replace(observation, velocity=20.0 * observation.velocity)
        grown, said = watching.step(grown, strong)
        other, _ = blind.step(other, strong)
        factor = 2.0 if k == 3 else 1.0
        assert said.prior_inflation == factor
        np.testing.assert_allclose(grown.cov, factor * other.cov, rtol=1e-12)


def test_a_number_is_a_factor_on_the_covariance_at_all_times():
    """The settings of the prior are those of the members as they are."""
    series, time = forecasts(), TimeConfig(dropped_std=0.0)
    config = EstimatorConfig(modes=12)
    given, scaled = (
        build_evolving(series, config.model_copy(update={"spread": spread}), time)
        for spread in ("as_given", 2.0)
    )
    for when in (0.0, 1.3):
        at = int(series[0].time_ns + when * 86_400 * 10**9)
        one, other = (each.flow(each.predict(each.initial(), at)) for each in (given, scaled))
        place = series[0].grid.east, series[0].grid.north, np.full(series[0].grid.east.shape, 60.0)
        np.testing.assert_allclose(
            other.standard_error(*place), np.sqrt(2.0) * one.standard_error(*place), rtol=1e-9
        )
        np.testing.assert_allclose(
            other.velocity(*place), one.velocity(*place), rtol=1e-9, atol=1e-12
        )
