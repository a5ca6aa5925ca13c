"""Shear, radar and drifters in the estimators: each is the dense Kalman update with its rows and the full covariance of its errors."""

import heapq
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Flag, Label, LinearMeasurement, Source
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.measurements.messages.water import DrifterFix, RadarCurrents
from replay_kit.measurements.section.hydrography import section_of
from replay_kit.measurements.section.lines import measurement
from replay_kit.measurements.section.thermal_wind import GeostrophicShear
from replay_kit.measurements.surface import Errors, displacement, superobservations
from replay_kit.workflows.replay.stages.estimation import EstimationState, assimilate
from tests import synthetic
from tests.estimator.runs import assert_static
from tests.measurements.section.test_thermal_wind import line
from tests.reference import estimator as slow

OCEAN = synthetic.ensemble(levels=np.array([2.0, 65.0, 165.0, 300.0]))
CONFIG = EstimatorConfig(modes=8, mean_variance=0.0)
HOUR_NS = 3600 * 10**9


def shear(rng):
    levels = np.arange(10.0, 400.0, 10.0)
    modes = np.exp(-np.outer(levels, [1 / 100, 1 / 300])) * 0.05
    covariance = modes @ modes.T + 1e-4 * np.eye(levels.size)
    velocity = 0.05 * rng.standard_normal(levels.size)
    found = GeostrophicShear(levels, velocity, covariance, 0.0, 0.7)
    at = Source(0, "/ctd", 1, HOUR_NS)
    made = measurement(found, section_of(line()), Label(0, at, kind="shear"))
    # the line of the other test lies elsewhere
    place = {"longitude": np.array([152.25]), "latitude": np.array([-39.8])}
    return type(made)(**{name: getattr(made, name) for name in made.__slots__} | place)


def radar(rng, radials):
    n = 60
    direction = rng.uniform(20.0, 50.0, n) if radials else None
    currents = RadarCurrents(
        rng.uniform(152.05, 152.45, n),
        rng.uniform(-39.95, -39.65, n),
        0.2 * rng.standard_normal((n, 1 if radials else 2)),
        rng.uniform(0.05, 0.12, n),
        direction,
        1.0,
        3600.0,
        10e3,
        np.zeros(n, bool),
    )
    at = Source(0, "/radar", 1, 2 * HOUR_NS)
    return superobservations(currents, Label(0, at, kind="radar"), 8e3, 0.08)


def drifter(rng):
    fixes = [
        (
            Source(0, "/drifters", k, k * 6 * HOUR_NS),
            DrifterFix("a", 152.2 + 0.03 * k, -39.8, 15.0, 50.0),
        )
        for k in (1, 2)
    ]
    found = displacement(*fixes, Errors(20.0, 0.08), 0)
    assert found is not None
    return found


@pytest.fixture
def measurements():
    rng = np.random.default_rng(5)
    return [shear(rng), *radar(rng, False), *radar(rng, True), drifter(rng)]


def dense(estimator, given: LinearMeasurement):
    """Rows, values about the flow of no weights, and the covariance of their errors; differences where values are relative."""
    projection, grid = OCEAN.grid.projection, OCEAN.grid
    used = np.flatnonzero((given.flags == Flag.GOOD) & (given.value_depth <= grid.levels[-1]))
    n_points = given.depth.size
    weights = np.eye(n_points) if given.weights is None else given.weights
    east, north = to_local(
        projection, np.resize(given.longitude, n_points), np.resize(given.latitude, n_points)
    )
    last = given.longitude[-1], given.latitude[-1]
    along = np.array([rotate_to_local(projection, *last, *each) for each in given.components])

    def values(state):
        flow = estimator.flow_of(state, np.empty((0, 0)), None)
        at_points = np.array(
            [flow.velocity(*place) for place in zip(east, north, given.depth, strict=True)]
        )
        return (weights @ at_points @ along.T)[used].T.ravel()

    size = estimator.prior.mean.size
    offset = values(np.zeros(size))
    design = np.column_stack([values(one) - offset for one in np.eye(size)])
    places = np.column_stack([east, north])
    of_levels = estimator.basis.local_error(places, estimator.representation_std)
    extra = [np.interp(z, grid.levels, row) for z, row in zip(given.depth, of_levels, strict=True)]
    own = given.error_std
    correlation = np.eye(own.size) if given.correlation is None else given.correlation
    cov = np.outer(own, own) * correlation + np.diag((weights @ extra) ** 2)
    relative = not np.isfinite(given.common_std)
    cov = (cov + (0.0 if relative else given.common_std**2))[np.ix_(used, used)]
    cov = np.kron(np.eye(len(along)), cov)
    measured = given.value[used].T.ravel() - offset
    if not relative:
        return design, measured, cov
    contrast = np.diff(np.eye(used.size), axis=0)
    return contrast @ design, contrast @ measured, contrast @ cov @ contrast.T


def test_the_estimate_is_that_of_a_dense_kalman_filter_with_the_same_rows(measurements):
    estimator = build_estimator(OCEAN, CONFIG)
    state, mean, cov = estimator.initial(), estimator.prior.mean, estimator.prior.covariance()
    assert [len(each.value) > 1 for each in measurements] == [True] * 6 + [False]
    for given in measurements:
        design, value, error = dense(estimator, given)
        mean, cov, nis, _ = slow.kalman_update(mean, cov, design, value, error)
        state, said = estimator.step(state, given)
        assert (said.dof, said.accepted, said.error_inflation) == (value.size, True, 1.0)
        assert said.nis == pytest.approx(nis, rel=1e-8)
    np.testing.assert_allclose(state.mean, mean, atol=1e-12 * np.abs(mean).max())
    np.testing.assert_allclose(state.posterior.covariance(), cov, atol=1e-12 * np.abs(cov).max())


def test_through_time_without_change_the_estimate_is_the_static_one(measurements):
    static = build_estimator(OCEAN, CONFIG)
    evolving = build_evolving([OCEAN], CONFIG, TimeConfig(scale="static", dropped_std=0.0))
    assert_static(evolving, static, measurements, 1e-8, 1e-9)


def test_they_are_one_stream_with_profiles_that_are_grouped(measurements):
    estimator = build_estimator(OCEAN, CONFIG, GatingConfig())
    profiles = synthetic.random_profiles(OCEAN.grid, 12, seed=3)
    both = heapq.merge(measurements, profiles, key=lambda each: each.time_ns)
    begun = EstimationState(estimator.initial(), estimator.initial())
    _, steps = assimilate(estimator, begun, list(both))
    assert len(steps) == 12 + len(measurements)
    assert all(np.isfinite(step.assimilation.weights).all() for step in steps)


def test_boxes_outside_the_region_are_left_out_one_by_one():
    rng = np.random.default_rng(6)
    currents = RadarCurrents(
        np.linspace(151.5, 152.45, 40),
        np.full(40, -39.8),
        0.1 * rng.standard_normal((40, 2)),
        np.full(40, 0.08),
        None,
        1.0,
        3600.0,
        0.0,
        np.zeros(40, bool),
    )
    (given,) = superobservations(currents, Label(0, Source(0, "/radar", 1, 5)), 8e3, 0.0)
    _, said = (estimator := build_estimator(OCEAN, CONFIG)).step(estimator.initial(), given)
    inside = np.isfinite(said.innovation[:, 0])
    assert 0 < inside.sum() < inside.size
    beyond = (given.weights > 0.0) & (given.longitude < 152.0)
    assert np.array_equal(inside, ~beyond.any(axis=1))
    assert said.dof == 2 * inside.sum()


def test_hour_after_hour_takes_no_more_memory_than_one_matrix():
    exact = CONFIG.model_copy(update={"representation_error_std": 0.0})
    estimator = build_estimator(OCEAN, exact, None)
    (hour,) = radar(np.random.default_rng(2), False)
    state, weights, times = estimator.initial(), estimator.prior.mean.size, 8
    for k in range(times):
        state, _ = estimator.step(state, replace(hour, time_ns=hour.time_ns + k * HOUR_NS))
    assert 2 * times * len(hour.value) > weights
    assert len(getattr(state.posterior.prior, "gain", ())) <= 0.25 * weights + 2 * len(hour.value)
    # as often measured as the hour measured once is surer
    surer = replace(
        hour, error_std=hour.error_std / times**0.5, common_std=hour.common_std / times**0.5
    )
    once, _ = estimator.step(estimator.initial(), surer)
    np.testing.assert_allclose(state.mean, once.mean, atol=1e-9 * np.abs(once.mean).max())
