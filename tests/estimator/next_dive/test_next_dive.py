"""The small models of dives' means: against one Gaussian of all dives, as physics, and mixtures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal, multivariate_t

from replay_kit.estimator.next_dive import filter
from replay_kit.estimator.next_dive.filter import DiveMean, DiveModel
from replay_kit.estimator.next_dive.mixtures import (
    Mixture,
    Persistence,
    Settings,
    flight_combinations,
    ground_combinations,
    weighted_quantiles,
)
from tests.reference import next_dive as slow

HOUR = 3600.0


def dives(n=5, seed=0, bias=0.5 + 0.1j, inverted=True, noise=0.01):
    """Dives in a steady current, with a flight model that errs by a share of the way."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(n):
        way = 0.2 * np.exp(2j * np.pi * rng.uniform())
        current = complex(0.08, -0.03) + complex(*rng.normal(0.0, noise, 2))
        mean = current + bias * way
        pair = np.array([current.real, current.imag]) if inverted else None
        begin = int(k * 3 * HOUR * 1e9)
        out.append(
            DiveMean(
                begin,
                2 * HOUR,
                np.array([way.real, way.imag]),
                0.1,
                np.array([mean.real, mean.imag]),
                pair,
            )
        )
    return out


def one(settings, h):
    return Settings(
        settings.white_std[[h]],
        settings.variance[[h]],
        settings.scales[[h]],
        settings.background[[h]],
        np.zeros(1),
    )


def assert_is_gaussian_of_all(settings, chosen, given):
    last = replace(given[-1], inverted=None)
    whole = DiveModel(
        Settings(
            *(
                getattr(settings, name)[chosen]
                for name in ("white_std", "variance", "scales", "background", "log_prior")
            )
        ),
        1e-40,
    )
    state = whole.initial()
    for dive in given[:-1]:
        state = whole.step(state, dive)
    found, densities = whole.forecast(state, last), []
    for position, h in enumerate(chosen):
        values, cov = slow.joint_covariance([*given[:-1], last], settings, h, filter.INVERTED_STD)
        mean, spread, density = slow.conditional(values, cov, len(values) - 2)
        densities.append(density + settings.log_prior[h])
        np.testing.assert_allclose(
            found.means[:, position], mean + slow.about(last, settings.background[h]), rtol=1e-8
        )
        np.testing.assert_allclose(found.covs[..., position], spread, rtol=1e-8, atol=1e-14)
    expected = np.exp(np.array(densities) - np.max(densities))
    np.testing.assert_allclose(np.exp(state.log_weights[0]), expected / expected.sum(), rtol=1e-7)


@pytest.mark.parametrize("inverted", [False, True])
def test_the_filter_is_the_gaussian_of_all_dives_at_once(inverted):
    assert_is_gaussian_of_all(flight_combinations(), [17, 58, 170], dives(4, inverted=inverted))


def test_so_it_is_of_velocities_over_ground():
    currents = np.random.default_rng(2).normal(0.0, 0.1, (4, 1, 2))
    given = [
        replace(
            dive,
            way=np.zeros(2),
            velocity=dive.way + current[0],
            backgrounds=current + 0.01,
            position_std=filter.FIXES_STD,
        )
        for dive, current in zip(dives(4, inverted=False), currents, strict=True)
    ]
    assert_is_gaussian_of_all(ground_combinations(1), [4, 101, 102, 150], given)


def test_a_steady_way_is_told_from_a_changing_current_that_is_known():
    model, way, rng = DiveModel.over_ground(1), np.array([0.2, -0.15]), np.random.default_rng(3)
    state = model.initial()
    for k in range(8):
        current = rng.normal(0.0, 0.1, 2)
        coming = DiveMean(
            int(k * 1e13),
            9e3,
            np.zeros(2),
            0.0,
            way + current,
            None,
            current[None],
            filter.FIXES_STD,
        )
        expected = model.forecast(state, coming)
        state = model.step(state, coming)
    assert np.hypot(*(expected.mean - coming.velocity)) < 0.01
    assert np.sqrt(np.linalg.det(expected.cov)) < 0.03**2
    assert np.exp(state.log_weights[0])[model.settings.background == 1].sum() > 0.99


@pytest.mark.parametrize("inverted", [False, True])
def test_the_flight_bias_is_found_by_turns_and_by_profiles(inverted):
    model = DiveModel.of_flight()
    state = model.initial()
    for dive in dives(8, inverted=inverted):
        state = model.step(state, dive)
    mean, std = model.flight_bias(state)
    assert np.all(np.abs(mean - [0.5, 0.1]) < 3.0 * std)
    assert np.all(std < 0.15)


def test_a_turned_world_gives_a_turned_forecast():
    model, turn = DiveModel.of_flight(), np.array([[0.0, -1.0], [1.0, 0.0]])
    states, given = [model.initial()] * 2, dives(4)
    turned = [
        replace(
            dive,
            way=turn @ dive.way,
            velocity=turn @ dive.velocity,
            inverted=None if dive.inverted is None else turn @ dive.inverted,
        )
        for dive in given
    ]
    for pair in zip(given[:-1], turned[:-1], strict=True):
        states = [model.step(state, dive) for state, dive in zip(states, pair, strict=True)]
    plain, other = (
        model.forecast(state, dive)
        for state, dive in zip(states, (given[-1], turned[-1]), strict=True)
    )
    np.testing.assert_allclose(other.mean, turn @ plain.mean, atol=1e-12)
    np.testing.assert_allclose(other.cov, turn @ plain.cov @ turn.T, atol=1e-12)


def test_after_many_dives_covariances_are_still_those_of_something():
    model = DiveModel.of_flight()
    state = model.initial()
    for dive in dives(90, inverted=False, noise=0.05):
        state = model.step(state, dive)
    cov = np.moveaxis(state.cov[:, :, 0], -1, 0)
    np.testing.assert_array_equal(cov, cov.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(cov).min() > -1e-15


def test_a_long_time_forgets_the_change_but_not_the_flight_bias():
    model = DiveModel.of_flight()
    state = model.initial()
    for dive in dives(5):
        state = model.step(state, dive)
    later = model.predict(state, state.time_ns + int(1e3 * 86400e9))
    np.testing.assert_allclose(later.mean[2:6], 0.0, atol=1e-30)
    np.testing.assert_allclose(later.mean[6:], state.mean[6:])
    np.testing.assert_allclose(model.predict(state, state.time_ns - 5).cov, state.cov)


def test_a_late_dive_counts_at_the_time_of_the_last_one_and_the_next_one_after_that():
    model, (first, late, last, coming) = DiveModel.of_flight(), dives(4)
    known = model.step(model.step(model.initial(), first), last)
    state, in_time = (
        model.step(known, replace(late, time_ns=time_ns))
        for time_ns in (late.time_ns, last.time_ns)
    )
    assert state.time_ns == last.time_ns
    np.testing.assert_array_equal(state.mean, in_time.mean)
    expected, found = (model.forecast(each, coming) for each in (in_time, state))
    np.testing.assert_array_equal(found.means, expected.means)
    np.testing.assert_array_equal(found.covs, expected.covs)


def test_weighted_quantiles_are_those_of_all_values_sorted():
    rng = np.random.default_rng(4)
    for n in (1, 2, 40, 5000):
        values, weights = rng.exponential(size=n), rng.random(n) ** 9
        weights, order = weights / weights.sum(), np.argsort(values)
        expected = np.interp([0.0, 0.5, 0.9, 1.0], np.cumsum(weights[order]), values[order])
        np.testing.assert_allclose(
            weighted_quantiles(values, weights, [0.0, 0.5, 0.9, 1.0]), expected, rtol=1e-6
        )


def test_the_radii_of_a_mixture_hold_their_shares():
    gaussian = Mixture(
        np.zeros(1),
        np.array([[0.1], [0.2]]),
        np.array([[0.04, 0.01], [0.01, 0.02]])[..., None],
    )
    np.testing.assert_allclose(
        gaussian.radii([0.5, 0.9]), np.sqrt(chi2.ppf([0.5, 0.9], 2)), rtol=0.03
    )
    mixture = Mixture(
        np.log([0.7, 0.3]),
        np.array([[0.0, 0.3], [0.0, 0.1]]),
        np.eye(2)[..., None] * [0.01, 0.2],
    )
    rng = np.random.default_rng(0)
    chosen = rng.choice(2, 40_000, p=[0.7, 0.3])
    noise = np.sqrt(mixture.covs[0, 0, chosen]) * rng.standard_normal((2, 40_000))
    draws = (mixture.means[:, chosen] + noise).T
    about = draws - mixture.mean
    radius = np.sqrt(np.einsum("ni,ij,nj->n", about, np.linalg.inv(mixture.cov), about))
    for share, found in zip((0.5, 0.9), mixture.radii([0.5, 0.9]), strict=True):
        assert np.mean(radius <= found) == pytest.approx(share, abs=0.02)
    density = np.log(
        sum(
            w * multivariate_normal(m, c).pdf([0.1, 0.1])
            for w, m, c in zip([0.7, 0.3], mixture.means.T, mixture.covs.T, strict=True)
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
