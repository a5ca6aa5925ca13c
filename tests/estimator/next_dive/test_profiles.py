"""The model of the current by depth in the next dive: against one Gaussian of all bins, and as physics."""

import numpy as np
import pytest

from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.estimator.next_dive.profiles import Bins, ColumnModel, joined

DEEPEST = 60.0


def dive(seed, n=9, shift=0.0):
    rng = np.random.default_rng(seed)
    depth = np.sort(rng.uniform(0.0, DEEPEST, n))
    velocity = (
        np.column_stack([np.sin(depth / 10.0), np.cos(depth / 15.0)]) * 0.1
        + shift
        + rng.normal(0.0, 0.03, (n, 2))
    )
    return Bins(depth, velocity, np.zeros((0, n, 2)))


def test_the_steps_are_the_gaussian_of_all_bins_at_once():
    model, given, last = ColumnModel.default(DEEPEST), [dive(0), dive(1, 7)], dive(2, 5)
    state = model.initial()
    for each in given:
        state = model.step(state, each)
    depth = np.concatenate([each.depth for each in (*given, last)])
    number = np.repeat(range(3), [9, 7, 5])
    hats = depth_weights(DepthFunctions("hat", 1.0), depth, model.knots)
    known, values = number < 2, np.concatenate([each.velocity for each in given])
    expected, densities = np.zeros((model.white.size, 5, 2)), np.zeros(model.white.size)
    variances = np.zeros((model.white.size, 5))
    for h in range(model.white.size):
        same = number[:, None] == number
        cov = (
            hats @ model.staying[h] @ hats.T
            + same * (hats @ model.shared[h] @ hats.T)
            + model.white[h] ** 2 * np.eye(depth.size)
        )
        inner = cov[np.ix_(known, known)]
        gain = cov[np.ix_(~known, known)] @ np.linalg.inv(inner)
        expected[h] = gain @ values
        variances[h] = np.diag(cov[np.ix_(~known, ~known)] - gain @ cov[np.ix_(known, ~known)])
        densities[h] = (
            -0.5 * np.sum(values * np.linalg.solve(inner, values)) - np.linalg.slogdet(inner)[1]
        )
    weights = np.exp(densities - densities.max())
    weights /= weights.sum()
    np.testing.assert_allclose(np.exp(state.log_weights), weights, rtol=1e-6, atol=1e-12)
    mean, std = model.forecast(state, last)
    about = np.einsum("h,hnc->nc", weights, expected)
    np.testing.assert_allclose(mean, about, rtol=1e-6)
    spread = np.einsum("h,hnc->nc", weights, variances[:, :, None] + (expected - about) ** 2)
    np.testing.assert_allclose(std, np.sqrt(spread), rtol=1e-6)


def test_what_stays_is_learnt_and_what_does_not_is_not_expected():
    model = ColumnModel.default(DEEPEST)
    state, rng = model.initial(), np.random.default_rng(5)
    for seed in range(8):
        state = model.step(state, dive(seed))
    last = dive(99)
    assert np.sqrt(np.mean((model.forecast(state, last)[0] - last.velocity) ** 2)) < 0.06
    other = model.initial()
    for _ in range(8):
        depth = np.linspace(0.0, DEEPEST, 9)
        other = model.step(
            other,
            Bins(
                depth,
                np.outer(np.sin(depth / 20.0 + rng.uniform(0, 6)), rng.normal(0, 0.3, 2)),
                np.zeros((0, 9, 2)),
            ),
        )
    assert np.sqrt(np.mean(model.forecast(other, last)[0] ** 2)) < 0.1


def test_a_background_is_believed_where_it_is_right():
    model = ColumnModel.default(DEEPEST, 1)
    state = model.initial()
    rng = np.random.default_rng(1)
    for seed in range(3):
        each = dive(seed, shift=rng.normal(0.0, 0.5))
        state = model.step(state, Bins(each.depth, each.velocity, each.velocity[None] + 0.01))
    assert np.exp(state.log_weights)[model.background == 1].sum() > 0.99
    assert (
        model.step(state, joined([Bins(np.zeros(0), np.zeros((0, 2)), np.zeros((1, 0, 2)))]))
        is state
    )
    assert model.forecast(state, Bins(np.array([10.0]), np.zeros((1, 2)), np.full((1, 1, 2), 0.4)))[
        0
    ][0] == pytest.approx(0.39, abs=0.03)
