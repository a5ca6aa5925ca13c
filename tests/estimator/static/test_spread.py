"""The amplitude fitted as a log goes on: from the past only, the same however it is called, and when it is fitted at all."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.observation import PathMean, Source
from replay_kit.estimator import build_estimator
from replay_kit.estimator.prior.amplitude import ScaledPrior, bands_of, fit_amplitude
from replay_kit.estimator.static.likelihood import predict_jointly
from replay_kit.estimator.static.state import SpreadFit
from tests import synthetic
from tests.estimator.runs import after, rows_of

GIVEN = synthetic.ensemble(n_members=6, shape=(6, 7), levels=np.array([5.0, 90.0, 220.0]))
GRID = GIVEN.grid
MADE = replace(GIVEN, made_from="lags")
CONFIG = EstimatorConfig(modes=20, mean_variance=0.1)
ESTIMATOR = build_estimator(MADE, CONFIG)
# so near one another that nearly all would be left out by the usual spacing
ESTIMATOR = replace(ESTIMATOR, spread=replace(ESTIMATOR.spread, spacing=10.0))
PROFILES = synthetic.random_profiles(GIVEN.grid, 132)


def path(seed):
    """A mean current along a short path, with places of its own."""
    rng = np.random.default_rng(seed)
    east, north = (
        rng.uniform(0.5 * axis.min(), 0.5 * axis.max()) + np.array([-900.0, 0.0, 1500.0])
        for axis in (GRID.east, GRID.north)
    )
    longitude, latitude = to_geographic(GRID.projection, east, north)
    times, weight = seed * 10**10 + np.arange(3) * 10**9, np.array([0.25, 0.5, 0.25])
    velocity, depth = (
        (float(rng.normal(0.0, 0.2)), float(rng.normal(0.0, 0.2))),
        np.array([5.0, 150.0, 5.0]),
    )
    return PathMean(
        int(times[-1]),
        times,
        longitude,
        latitude,
        depth,
        weight,
        velocity,
        0.02,
        "dac",
        seed,
        Source(0, "/dac", seed, 0),
    )


def unfitted(spread):
    """The estimator with amplitudes that stay."""
    return replace(ESTIMATOR, prior=spread.scale(ESTIMATOR.prior), spread=None)


def assert_unfitted(state, given):
    """A state is that of an estimator whose amplitude was as it is from the start."""
    alone = after(unfitted(state.spread), given)
    np.testing.assert_allclose(state.mean, alone.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        state.posterior.covariance(), alone.posterior.covariance(), rtol=1e-8, atol=1e-12
    )


@pytest.fixture
def one_band(monkeypatch):
    """So many innovations that bands of modes are not fitted any more."""
    monkeypatch.setattr("replay_kit.estimator.static.state._MOST_BY_SCALE", 0)


def test_made_members_are_fitted_and_true_ones_are_not():
    assert build_estimator(GIVEN, CONFIG).spread is None
    assert build_estimator(MADE, CONFIG).spread.fitted_to == 0
    assert build_estimator(GIVEN, CONFIG.model_copy(update={"spread": "fit"})).spread.fitted_to == 0
    assert build_estimator(MADE, CONFIG.model_copy(update={"spread": "as_given"})).spread is None
    assert build_estimator(MADE, EstimatorConfig(preset="paper", modes=10)).spread is None


def test_a_number_is_a_factor_on_the_covariance():
    for config in (CONFIG, EstimatorConfig(preset="paper", modes=10)):
        given = build_estimator(GIVEN, config)
        scaled = build_estimator(GIVEN, config.model_copy(update={"spread": 2.0}))
        assert scaled.spread is None
        np.testing.assert_allclose(
            scaled.prior.covariance(), 2.0 * given.prior.covariance(), rtol=1e-12
        )


def test_before_the_log_the_amplitude_is_that_of_members_left_out():
    prior = ESTIMATOR.initial().posterior.prior
    assert isinstance(prior, ScaledPrior)
    assert prior.amplitude == ESTIMATOR.spread.amplitude
    assert after(ESTIMATOR, PROFILES[:7]).spread.amplitude == ESTIMATOR.spread.amplitude
    assert after(ESTIMATOR, PROFILES[:7]).spread.fitted_to == 0


@pytest.mark.usefixtures("one_band")
@pytest.mark.parametrize("count", [8, 64])
def test_it_is_the_likeliest_for_the_profiles_so_far_and_the_estimate_is_made_with_it(count):
    state = after(ESTIMATOR, PROFILES[:count])
    bins = [np.flatnonzero(profile.depth <= GIVEN.grid.levels[-1]) for profile in PROFILES[:count]]
    joint = predict_jointly(ESTIMATOR, PROFILES[:count], bins)
    rows = [ESTIMATOR.rows(profile, used) for profile, used in zip(PROFILES, bins, strict=False)]
    innovation = np.concatenate([each.y for each in rows]) - joint.mean
    amplitude = fit_amplitude(
        innovation, joint.chol @ joint.chol.T - np.eye(innovation.size), ESTIMATOR.spread.amplitude
    )
    assert state.spread.amplitude == pytest.approx(amplitude, rel=1e-4)
    assert state.spread.fitted_to == count
    assert_unfitted(state, PROFILES[:count])


@pytest.mark.parametrize("count", [8, 32])
def test_bands_of_modes_have_the_likeliest_amplitudes_and_the_estimate_is_made_with_them(count):
    given = [replace(each, velocity=0.4 * each.velocity) for each in PROFILES[:count]]
    state = after(ESTIMATOR, given)
    spread, band = state.spread, bands_of(ESTIMATOR.prior)
    assert sorted(set(band)) == [0, 1, 2]
    assert np.all(np.diff(band) >= 0)
    assert np.prod(spread.tilt) == pytest.approx(1.0)
    design, values = rows_of(ESTIMATOR, given)
    innovation = values - design @ ESTIMATOR.prior.mean

    def deviance(logs):
        root = np.tile(np.exp(0.5 * logs)[band], len(GRID.levels))
        total = design @ (root[:, None] * ESTIMATOR.prior.covariance() * root) @ design.T
        total += np.eye(len(total))
        about = [*(logs - logs.mean()), logs.mean() - np.log(spread.expected)]
        return (
            np.linalg.slogdet(total)[1]
            + innovation @ np.linalg.solve(total, innovation)
            + np.sum(np.square(about)) / np.log(2.0) ** 2
        )

    found = np.log(spread.amplitude) + np.log(spread.tilt)
    least = deviance(found)
    for step in (*np.eye(3), *-np.eye(3)):
        assert deviance(found + 0.2 * step) > least - 0.02
    assert_unfitted(state, given)
    # the covariance is that of scaled weights, in every form in which it is asked for
    scaled, root = spread.scale(ESTIMATOR.prior), np.exp(0.5 * found)[band]
    whole = np.tile(root, len(GRID.levels))
    dense = whole[:, None] * ESTIMATOR.prior.covariance() * whole
    np.testing.assert_allclose(scaled.covariance(), dense, rtol=1e-12, atol=1e-15)
    weights = np.random.default_rng(1).standard_normal((2, len(GRID.levels), root.size))
    np.testing.assert_allclose(
        scaled.matvec(weights).reshape(2, -1), weights.reshape(2, -1) @ dense, rtol=1e-9
    )


def test_the_innovation_published_was_predicted_before_the_fit():
    before = after(ESTIMATOR, PROFILES[:7])
    _, innovation = ESTIMATOR.step(before, PROFILES[7])
    np.testing.assert_allclose(
        innovation.innovation, ESTIMATOR.innovation(before, PROFILES[7]), rtol=1e-9, atol=1e-12
    )


def test_online_in_blocks_and_from_a_pickle_are_the_same():
    online = after(ESTIMATOR, PROFILES[:40])
    *_, (at_once, _) = ESTIMATOR.steps(ESTIMATOR.initial(), PROFILES[:40])
    half = pickle.loads(pickle.dumps(after(ESTIMATOR, PROFILES[:13])))
    half = after(ESTIMATOR, PROFILES[13:40], half)
    for other in (at_once, half):
        np.testing.assert_allclose(other.mean, online.mean, rtol=1e-8, atol=1e-11)
        assert other.spread.amplitude == pytest.approx(online.spread.amplitude, rel=1e-12)
    assert online.spread.fitted_to == 32
    assert len(online.spread.past) == 40


@pytest.mark.full
def test_it_is_fitted_at_these_counts_and_ends_with_the_last():
    state, counts = ESTIMATOR.initial(), []
    for profile in PROFILES:
        before = state.spread
        state, _ = ESTIMATOR.step(state, profile)
        if state.spread.fitted_to != before.fitted_to:
            assert state.spread.fitted_to == len(before.apart) + 1
            counts.append(state.spread.fitted_to)
    assert counts == [8, 16, 32, 48, 64, 96, 128]
    assert state.spread.past is None
    assert state.spread.apart == ()
    *_, (at_once, _) = ESTIMATOR.steps(ESTIMATOR.initial(), PROFILES)
    np.testing.assert_allclose(at_once.mean, state.mean, rtol=1e-7, atol=1e-10)


def test_more_innovations_than_are_fitted_end_the_fit(monkeypatch):
    # 8 profiles at three levels of both components
    monkeypatch.setattr("replay_kit.estimator.static.state._MOST_INNOVATIONS", 47)
    ended = after(ESTIMATOR, PROFILES[:9])
    assert ended.spread.past is None
    assert (ended.spread.amplitude, ended.spread.fitted_to) == (ESTIMATOR.spread.amplitude, 0)
    expected = after(unfitted(ESTIMATOR.spread), PROFILES[:9])
    np.testing.assert_allclose(ended.mean, expected.mean, rtol=1e-9, atol=1e-12)
    monkeypatch.setattr("replay_kit.estimator.static.state._MOST_INNOVATIONS", 48)
    assert after(ESTIMATOR, PROFILES[:8]).spread.fitted_to == 8


@pytest.mark.usefixtures("one_band")
def test_mean_currents_alone_fit_it_too():
    dives = [path(seed) for seed in range(8)]
    state = after(ESTIMATOR, dives)
    assert state.spread.fitted_to == 8
    rows = [ESTIMATOR.rows(dive, np.arange(1)) for dive in dives]
    design = np.concatenate([each.design() for each in rows])
    innovation = np.concatenate([each.y for each in rows]) - design @ ESTIMATOR.prior.mean
    amplitude = fit_amplitude(
        innovation, design @ ESTIMATOR.prior.covariance() @ design.T, ESTIMATOR.spread.expected
    )
    assert state.spread.amplitude == pytest.approx(amplitude, rel=1e-4)
    # the middle of a path is its place
    east, north = to_local(GIVEN.grid.projection, dives[0].longitude, dives[0].latitude)
    np.testing.assert_allclose(state.spread.apart[0][1], [east.mean(), north.mean()])
    scaled = unfitted(state.spread)
    np.testing.assert_allclose(state.mean, after(scaled, dives).mean, rtol=1e-9, atol=1e-12)


def test_a_state_is_not_changed_by_what_follows():
    state = after(ESTIMATOR, PROFILES[:7])
    mean, amplitude = state.mean.copy(), state.spread.amplitude
    ESTIMATOR.step(state, PROFILES[7])
    np.testing.assert_array_equal(state.mean, mean)
    assert state.spread.amplitude == amplitude
    assert len(state.spread.past) == 7


def test_profiles_near_one_another_count_once():
    fit, here = SpreadFit(1.0, 1.0, 0, 1000.0), np.array([0.0, 0.0])
    fit = fit.after(PROFILES[0], here).after(PROFILES[1], np.array([600.0, 799.0]))
    assert len(fit.apart) == 1
    fit = fit.after(PROFILES[2], np.array([600.0, 800.0]))
    assert len(fit.apart) == 2
    assert len(fit.past) == 3
    assert len(fit.after(PROFILES[3], None).apart) == 2


def test_the_usual_spacing_is_half_a_cell():
    east, north = GIVEN.grid.east, GIVEN.grid.north
    cell = np.sqrt(
        np.hypot(*np.diff([east, north], axis=2)[:, 0, 0])
        * np.hypot(*np.diff([east, north], axis=1)[:, 0, 0])
    )
    assert build_estimator(MADE, CONFIG).spread.spacing == pytest.approx(0.5 * cell, rel=0.02)


def test_a_vehicle_that_stays_ends_the_fit():
    fit = SpreadFit(1.5, 1.0, 8, 1000.0, past=(PROFILES[0],) * 1023)
    assert len(fit.after(PROFILES[1], None).past) == 1024
    ended = fit.after(PROFILES[1], None).after(PROFILES[2], np.zeros(2))
    assert ended.past is None
    assert (ended.amplitude, ended.fitted_to) == (1.5, 8)
    assert ended.after(PROFILES[3], np.zeros(2)) is ended


def test_what_it_says():
    state = after(ESTIMATOR, PROFILES[:9])
    assert ESTIMATOR.spread_record(state) == {
        "amplitude": repr(state.spread.amplitude),
        "by_scale": " ".join(map(repr, state.spread.tilt)),
        "measurements": "8",
    }
    spread = state.spread
    bands = ", ".join(f"{spread.amplitude * each:.2f}" for each in spread.tilt)
    assert (
        ESTIMATOR.bias_notes(state)[0]
        == f"variance of the prior multiplied by {spread.amplitude:.2f} ({bands} from large scales to small), "
        "fitted to 8 measurements of the log"
    )
    assert (
        "members left out, no measurement of the log"
        in ESTIMATOR.bias_notes(ESTIMATOR.initial())[0]
    )
    given = build_estimator(GIVEN, CONFIG)
    assert given.spread_record(given.initial()) == {}
    assert given.bias_notes(given.initial()) == []


def test_rejected_profiles_do_not_count():
    estimator = replace(ESTIMATOR, gating=GatingConfig())
    wrong = replace(PROFILES[6], velocity=PROFILES[6].velocity + 30.0)
    state = after(estimator, [*PROFILES[:6], wrong])
    place = np.array(to_local(GIVEN.grid.projection, wrong.longitude, wrong.latitude))
    assert len(state.spread.past) == 7
    assert not any(np.array_equal(place, at) for _, at in state.spread.apart)


def test_few_members_span_their_shifted_copies_too():
    # rough, so that all that copies span is clear of rounding
    noise = 0.02 * np.random.default_rng(5).standard_normal(GIVEN.velocity[:3].shape)
    three = replace(GIVEN, velocity=GIVEN.velocity[:3] + noise)
    made = replace(three, made_from="times")
    # two anomalies and the mean at three levels, and four copies of the anomalies
    assert build_estimator(made, EstimatorConfig()).basis.n_modes == 33
    assert build_estimator(three, EstimatorConfig()).basis.n_modes == 33
    assert build_estimator(three, EstimatorConfig(shift_distance=0.0)).basis.n_modes == 9
    # "all" modes are those of the members themselves, unless these were made
    assert build_estimator(three, EstimatorConfig(modes=None)).basis.n_modes == 9
    assert build_estimator(made, EstimatorConfig(modes=None)).basis.n_modes == 33
    assert build_estimator(made, EstimatorConfig(mean_variance=0.0)).basis.n_modes == 30
    # as many modes as the members have themselves: nothing is added
    alike = [
        build_estimator(three, EstimatorConfig(modes=6, shift_distance=shift)).basis.modes
        for shift in (None, 0.0)
    ]
    np.testing.assert_array_equal(*alike)
    assert build_estimator(three, EstimatorConfig(modes=7)).basis.n_modes == 7
