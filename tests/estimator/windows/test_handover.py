"""What one window learnt is what the next one knows, no more and no less."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Flag, Profiles
from replay_kit.estimator import build
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.estimator.windows.handover import hand_over, overlap
from tests import synthetic

CONFIG = EstimatorConfig(
    modes=20, sample_share=0.4, representation_error_std=0.0, spread="as_given"
)
WHOLE = synthetic.ensemble(3, n_members=12, shape=(8, 12))
DEPTHS = np.array([5.0, 60.0, 150.0, 300.0])


def columns(first, last) -> Ensemble:
    """Some columns of the ensemble, in its local frame."""
    part, grid = slice(first, last), WHOLE.grid
    names = ("longitude", "latitude", "east", "north", "wet")
    cut = {name: getattr(grid, name)[..., part] for name in names}
    return replace(WHOLE, grid=replace(grid, **cut), velocity=WHOLE.velocity[..., part])


def after(estimator, n=12, seed=1):
    return estimator.assimilate(
        estimator.initial(), synthetic.random_profiles(estimator.grid, n, seed)
    )[0]


def at_points(estimator, state, points):
    """Mean and standard error at points and three depths."""
    at = points[:, 0], points[:, 1], DEPTHS[:3, None]
    flow = estimator.flow(state)
    return flow.velocity(*at), flow.standard_error(*at)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@pytest.fixture(scope="module")
def one():
    return build([columns(0, 8)], CONFIG)


def test_where_members_are_all_that_is_known_it_is_the_estimate_of_both_windows_at_once():
    """Bins at nodes, where every basis has the members themselves: in the overlap, and beyond it as the members carry it on."""
    alone = {"sample_share": 1.0, "shift_distance": 0.0, "modes": None, "nugget": 1e-12}
    config = CONFIG.model_copy(update={**alone, "dropped_std": 1e-3})
    first, second, both = (build([columns(*ends)], config) for ends in ((0, 8), (3, 12), (0, 12)))
    points, rng = overlap(first.grid, second.grid), np.random.default_rng(0)
    (truth,), log = both.flow(both.initial()).sample(1, 5), []
    for k in range(100):
        place = points[k % len(points)]
        values = truth.velocity(*place, DEPTHS) + 0.02 * rng.standard_normal((4, 2))
        log.append(synthetic.profile(WHOLE.grid, *place, DEPTHS, values, 0.02, time_ns=k))
    (state, _), (whole, _) = (each.assimilate(each.initial(), log) for each in (first, both))
    begun, _ = hand_over(first, state, second)
    nodes = second.grid.nodes[second.grid.nodes[:, 0] < points[:, 0].max() + 1.5e4]
    for places in (points, nodes):
        (mean, error), (expected, of_both) = (
            at_points(*each, places) for each in ((second, begun), (both, whole))
        )
        assert np.abs(mean - expected).max() < 1e-3
        assert 0.99 < (error / of_both).min() <= (error / of_both).max() < 1.3


def test_where_windows_overlap_the_next_knows_what_was_learnt_within_its_standard_error(one):
    state, other = after(one), build([columns(3, 12)], CONFIG)
    begun, _ = hand_over(one, state, other)
    (mean, error), (begun_mean, begun_error), (prior_mean, prior_error) = (
        at_points(*each, overlap(one.grid, other.grid))
        for each in ((one, state), (other, begun), (other, other.initial()))
    )
    assert rms((begun_mean - mean) / error) < 1.0
    assert rms((prior_mean - mean) / error) > 2.0
    assert 0.9 < rms(begun_error) / rms(error) < 1.5
    assert np.all(begun_error < 1.001 * prior_error)


@pytest.mark.parametrize("ends", [(3, 12), (8, 12)])
def test_nothing_learnt_or_shared_hands_over_the_next_prior(one, ends):
    other, state = build([columns(*ends)], CONFIG), one.initial() if ends[0] == 3 else after(one)
    begun, loss = hand_over(one, state, other)
    assert loss == 0.0
    np.testing.assert_allclose(begun.x, 0.0)
    np.testing.assert_allclose(begun.covariance, np.eye(other.unknowns), atol=1e-9)
    assert (begun.time_ns, begun.last) == (state.time_ns, state.last)


@pytest.mark.parametrize("n", [5, 40])
def test_what_the_log_said_of_the_prior_holds_in_the_next_window_too(n):
    """Its scale, its centre in units of the next window's members, and no column of the window before."""
    config = CONFIG.model_copy(update={"spread": None})
    before, other = (
        build([columns(*ends)], config.model_copy(update={"sample_share": share}), GatingConfig())
        for ends, share in (((0, 8), 0.4), ((3, 12), 0.6))
    )
    state = after(before, n)
    revised = state.revised._replace(scale=9.0)
    wide = replace(state, revised=revised, centre=None)
    begun, _ = hand_over(before, wide, other)
    assert (begun.scale, begun.profiles) == (9.0, n)
    prior, _ = hand_over(before, replace(before.initial(), revised=revised), other)
    assert np.diag(prior.covariance)[1:] == pytest.approx(9.0, abs=1e-9)
    begun, _ = hand_over(before, state, other)
    assert (begun.centre is None) == (state.centre is None) == (n < 28)
    if begun.centre is not None:
        anomalies = [each.evidence.parts.anomaly for each in (before, other)]
        np.testing.assert_allclose(begun.centre / anomalies[1], state.centre / anomalies[0])
    wrong = [
        replace(each, velocity=each.velocity + 5.0, time_ns=10**12 + each.time_ns)
        for each in synthetic.random_profiles(columns(4, 8).grid, 14, 3)
    ]
    sound = synthetic.random_profiles(columns(4, 8).grid, 2, 9)
    doubted, _ = before.assimilate(before.initial(), [*sound, *wrong[:4]])
    begun, _ = hand_over(before, doubted, other)
    end, _ = other.assimilate(begun, wrong[4:])
    assert np.isfinite(end.x).all()


def test_windows_say_of_measurements_what_the_estimator_of_the_window_says(one):
    grid = one.grid
    west, east = grid.longitude.min(), grid.longitude.max()
    south, north = grid.latitude.min(), grid.latitude.max()
    bounds = west, south, east + 1.0, north
    windows = WindowedEstimator((west, south, east, north), 1.0, bounds, lambda _: one)
    first, *others = log = synthetic.random_profiles(grid, 5, 3)
    state, inner = windows.initial(), one.initial()
    for profile in log:
        np.testing.assert_array_equal(
            windows.innovation(state, profile), one.innovation(inner, profile)
        )
    group = Profiles.of(others)
    np.testing.assert_array_equal(windows.innovation(state, group), one.innovation(inner, group))
    flags = np.full_like(first.flags, Flag.FAIL)
    nothing = replace(first, velocity=np.nan * first.velocity, flags=flags)
    deep = replace(first, depth=first.depth + grid.levels[-1])
    at_bottom = replace(first, depth=first.depth - first.depth[0] + grid.levels[-1])
    for away in (
        0.0,
        east + 0.5 - first.longitude,
    ):  # in the first window, and where there is none yet
        moved = [
            replace(each, longitude=each.longitude + away)
            for each in (first, at_bottom, nothing, deep)
        ]
        assert [windows.usable(each) for each in moved] == [True, True, False, False]
    assert not windows.usable(replace(first, longitude=east + 1.5))


def test_a_window_that_represents_half_is_no_surer_of_what_both_know(one):
    """What it cannot take over is an error of as many unknowns as there are, not of as many as points."""
    other = build([columns(3, 12)], CONFIG.model_copy(update={"modes": 10}))
    ratios = []
    for seed in range(4):
        state = after(one, seed=seed)
        begun, _ = hand_over(one, state, other)
        points = overlap(one.grid, other.grid)
        (_, error), (_, begun_error) = (
            at_points(*each, points) for each in ((one, state), (other, begun))
        )
        ratios.append(np.sqrt(np.mean(begun_error**2) / np.mean(error**2)))
    assert np.mean(ratios) > 0.78
