"""The process of mean currents: against one Gaussian of all dives, and on currents that are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from replay_kit.estimator.next_dive.process import DiveMean, MeanCurrentProcess, ProcessSettings
from tests.reference import mean_currents as slow

HOUR = 3600.0
PROCESS = MeanCurrentProcess()


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
                np.array([mean.real, mean.imag]),
                pair,
            )
        )
    return out


def after(process, given):
    state = process.initial()
    for dive in given:
        state = process.step(state, dive)
    return state


def chosen(which):
    """The process with some of the settings, evenly weighted."""
    names = ProcessSettings.__dataclass_fields__
    return MeanCurrentProcess(
        ProcessSettings(*(getattr(PROCESS.settings, name)[which] for name in names))
    )


@pytest.mark.parametrize("inverted", [False, True])
def test_the_filter_is_the_gaussian_of_all_dives_at_once(inverted, monkeypatch):
    monkeypatch.setattr("replay_kit.estimator.next_dive.process._UNLIKE", 1e-40)
    *given, last = dives(6, inverted=inverted)
    process = chosen(np.array([3, 77, 210, 511]))
    coming = replace(last, inverted=None, way_std=0.05)
    state = after(process, given)
    found = process.forecast(state, coming)
    densities = []
    for h in range(4):
        mean, spread, density = slow.forecast(given, coming, process.settings, h)
        np.testing.assert_allclose(found.means[h], mean, rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(found.covs[h], spread, rtol=1e-8, atol=1e-14)
        densities.append(density)
    expected = np.exp(np.array(densities) - np.max(densities))
    np.testing.assert_allclose(
        np.exp(state.log_weights[:, 0]), expected / expected.sum(), rtol=1e-7
    )


def test_a_dive_that_may_be_wrong_joins_what_is_known_with_it_and_without():
    *given, last = dives(5, inverted=False)
    plain = chosen(np.array([77]))
    state, robust = after(plain, given), replace(plain, outliers=True)
    said = robust.forecast(state, last)
    # three standard deviations off, one is about as likely as the other
    off = 3.0 * np.sqrt(np.diag(said.covs[0]))
    last = replace(last, velocity=said.means[0] + off)
    found = robust.step(state, last)
    odds = np.exp(said.log_weights) * [
        multivariate_normal(m, c).pdf(last.velocity)
        for m, c in zip(said.means, said.covs, strict=True)
    ]
    share = odds[0] / odds.sum()
    assert 0.05 < share < 0.95
    cases = (share, plain.step(state, last)), (1.0 - share, plain.later(state, last))
    mean = sum(p * one.mean[0, :, 0] for p, one in cases)
    about = [(p, one.cov[0], one.mean[0, :, 0] - mean) for p, one in cases]
    np.testing.assert_allclose(found.mean[0, :, 0], mean, atol=1e-12)
    cov = sum(p * (cov + np.outer(off, off)) for p, cov, off in about)
    np.testing.assert_allclose(found.cov[0], cov, atol=1e-12)


def test_a_change_of_the_current_explains_nothing_that_an_inverted_one_leaves():
    process, last = chosen(np.array([3, 210])), dives(1)[0]
    known, without = process.step(process.initial(), last), replace(last, inverted=None)
    before, error = process.step(process.initial(), without), last.velocity - last.inverted
    turn, densities = slow.of_way(last), []
    for h, flight in enumerate(process.settings.flight):
        effect = flight * turn @ np.diag([1.0, 0.5])
        mean, cov = effect @ before.mean[h, :2, 0], effect @ before.cov[h, :2, :2] @ effect.T
        cov = cov + (0.03**2 + (60.0 / last.seconds) ** 2) * np.eye(2)
        densities.append(multivariate_normal(mean, cov).logpdf(error))
    odds, then = (one.log_weights[:, 0] @ [1.0, -1.0] for one in (before, known))
    assert then - odds == pytest.approx(densities[0] - densities[1])


def test_a_background_that_is_right_is_believed_and_one_that_is_missing_changes_nothing():
    process, rng = MeanCurrentProcess(n_backgrounds=1), np.random.default_rng(3)
    given = []
    for k in range(6):
        velocity = rng.normal(0.0, 0.3, 2)
        known = velocity[None] + 0.005
        given.append(DiveMean(int(k * 4e13), 3e4, np.zeros(2), velocity, None, known))
    # settings by backgrounds, the first of which is none
    assert np.exp(after(process, given).log_weights).sum(axis=0)[1] > 0.99
    unknown = replace(given[0], backgrounds=np.full((1, 2), np.nan))
    np.testing.assert_allclose(process.forecast(process.initial(), unknown).mean, 0.0)


def test_a_late_dive_counts_at_the_end_of_the_last_one_and_many_leave_covariances_sound():
    given = dives(90, inverted=False, noise=0.05)
    state = after(PROCESS, given)
    assert (state.dives, PROCESS.step(state, given[3]).time_ns) == (90, state.time_ns)
    cov = state.cov
    np.testing.assert_array_equal(cov, cov.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(cov).min() > -1e-12


def test_settings_are_spread_as_the_prior_says():
    settings = PROCESS.settings
    assert (settings.amplitude.min() < 0.021, settings.amplitude.max() > 0.245) == (True, True)
    assert np.median(settings.amplitude) == pytest.approx(np.sqrt(0.02 * 0.25), rel=0.02)
    for values, level, share in (
        (settings.parts[:, 2], 0.0, 0.4),
        (settings.parts[:, 3], 0.0, 0.6),
        (settings.flight, 0.0, 1.0 / 3.0),
        (settings.scale, 20.0 * HOUR, 1.0 / 6.0),
    ):
        assert np.mean(values == level) == pytest.approx(share, abs=0.03)
    # a current along an axis, of the same variance in all
    along = settings.axes @ settings.axes.transpose(0, 2, 1)
    np.testing.assert_allclose(np.trace(along, axis1=1, axis2=2), 2.0)
