"""The estimate against one joint Gaussian of all unknowns: every kind of measurement, constant and through time, filter and smoother."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Profiles
from replay_kit.estimator import build, smooth
from replay_kit.estimator.basis.slices import ensemble_slices
from tests.estimator.seas import (
    CONFIG,
    DAY,
    GRID,
    HOUR,
    LEVELS,
    SEA,
    every_kind,
    forecasts,
    profiles,
    relative,
)
from tests.reference import estimator as slow
from tests.reference.dense import Near, Twin

FORGETFUL = TimeConfig(scale=2 * 86_400.0)
OSCILLATING = FORGETFUL.model_copy(update={"oscillators": ("inertial", "M2")})
ERRING = FORGETFUL.model_copy(update={"biases": ("heading", "shear")})
EXACT = CONFIG.model_copy(update={"dropped_std": 0.0})


def twin_of(estimator, time=None, stated_std=None):
    return Twin(estimator.flow(estimator.initial()), time, stated_std)


def stated(log):
    """Profiles with the velocity of a platform that goes round."""
    angles = 0.7 * np.arange(len(log))
    motion = 0.3 * np.column_stack([np.cos(angles), np.sin(angles)])
    return [
        replace(each, platform_velocity=tuple(way), common_std=0.02)
        if hasattr(each, "dive")
        else each
        for each, way in zip(log, motion.tolist(), strict=True)
    ]


def assert_equal(estimator, state, twin, seen, rtol=1e-9):
    """Unknowns, and the current and its error at two places, now and for a later time."""
    at = state.time_ns
    x, p = twin.joint(seen, at)
    np.testing.assert_allclose(state.x, x, rtol=0.0, atol=rtol * np.abs(x).max())
    np.testing.assert_allclose(state.covariance, p, rtol=0.0, atol=rtol)
    for later in (at, at + DAY):
        x, p = twin.joint(seen, later)
        flow = estimator.flow(state).at(later)
        for place, depth in (((3e3, -2e3), 40.0), ((-9e3, 7e3), 150.0)):
            mean, variance = twin.velocity(x, p, np.array(place), depth, later)
            np.testing.assert_allclose(flow.velocity(*place, depth), mean, atol=rtol)
            np.testing.assert_allclose(flow.standard_error(*place, depth) ** 2, variance, rtol=rtol)


@pytest.mark.parametrize(
    ("members", "config", "time", "log"),
    [
        (forecasts(1), CONFIG, None, every_kind()),
        (forecasts(1, n_members=3), CONFIG, None, every_kind()),
        (forecasts(1), CONFIG.model_copy(update={"preset": "paper"}), None, every_kind()),
        (forecasts(), CONFIG, FORGETFUL, every_kind()),
        (forecasts(1), EXACT, FORGETFUL, every_kind()),
        (forecasts(), EXACT, OSCILLATING, every_kind()),
        (forecasts(), CONFIG, ERRING, stated(profiles(6))),
        (forecasts(), CONFIG, ERRING, every_kind()),
    ],
    ids=[
        "static",
        "few members",
        "paper",
        "through time",
        "one time",
        "oscillating",
        "erring",
        "unstated",
    ],
)
def test_it_is_the_joint_gaussian_of_all_measurements(members, config, time, log):
    estimator = build(members, config, None, time)
    twin = twin_of(estimator, time, 0.12 if config.preset == "paper" else None)
    state, seen, near = estimator.initial(), [], Near(twin)
    for given in log:
        state, (step,) = estimator.assimilate(state, [given])
        (rows,), said = near.rows(given), step.innovation
        # the gate takes each as if nothing else were near
        nis, _, _ = twin.predicted(seen, twin.rows(given), given.time_ns)
        _, density, signal = twin.predicted(seen, rows, given.time_ns)
        assert (said.dof, said.accepted, said.error_inflation) == (len(rows[1]), True, 1.0)
        assert said.nis == pytest.approx(nis, rel=1e-8)
        assert said.log_likelihood == pytest.approx(density, rel=1e-8, abs=1e-8)
        assert said.signal_dof == pytest.approx(signal, rel=1e-6)
        seen.append((rows, given.time_ns))
        assert state.time_ns == given.time_ns
    assert_equal(estimator, state, twin, seen)


def test_the_paper_s_is_the_kalman_filter_of_the_whole_kernel():
    """Latents of all three dimensions at once, their singular vectors, and one error for all bins."""
    config = CONFIG.model_copy(update={"preset": "paper", "length_vertical": 60.0})
    estimator, members = build([SEA], config), ensemble_slices(SEA)
    lengths, speed = (10_000.0, 10_000.0, 60.0), float(np.sqrt(np.mean(members[:, 0] ** 2)))
    modes, weights, points = slow.paper_basis(members, GRID.nodes, LEVELS, lengths, speed, 12)
    stacked = weights.reshape(len(members), -1)
    mean, cov = stacked.mean(axis=0), np.diag(stacked.var(axis=0, ddof=1))

    def design(place, depth):
        return slow.design_matrix(place, depth, points, modes, 3, LEVELS[0], lengths, speed)

    state, here = estimator.initial(), GRID.projection
    for given in profiles(6):
        used = given.depth <= LEVELS[-1]
        place = given.longitude, given.latitude
        rows = design(to_local(here, *place), given.depth[used])
        value = np.array(rotate_to_local(here, *place, *given.velocity[used].T)).ravel()
        noise = 0.12**2 * np.eye(value.size)
        mean, cov, nis, _ = slow.kalman_update(mean, cov, rows, value, noise)
        state, (step,) = estimator.assimilate(state, [given])
        assert step.innovation.nis == pytest.approx(nis, rel=1e-8)
    flow, depths = estimator.flow(state), np.array([5.0, 50.0, 200.0])
    for place in ((3e3, -2e3), (-9e3, 7e3)):
        rows = design(place, depths)
        expected = (rows @ mean).reshape(2, -1).T
        np.testing.assert_allclose(flow.velocity(*place, depths), expected, atol=1e-9)
        std = np.sqrt(np.diag(rows @ cov @ rows.T)).reshape(2, -1).T
        np.testing.assert_allclose(flow.standard_error(*place, depths), std, rtol=1e-8)


@pytest.mark.parametrize("time", [None, FORGETFUL, ERRING])
@pytest.mark.parametrize("change", [lambda each: each, relative], ids=["absolute", "relative"])
def test_a_group_is_all_its_profiles_at_their_mean_place_and_time(time, change):
    start = profiles(1)[0]
    rng, log = np.random.default_rng(4), []
    for k in range(6):
        velocity = start.velocity + 0.05 * rng.standard_normal(start.velocity.shape)
        away = {"longitude": start.longitude + 1e-3 * k, "depth": start.depth + 0.7 * k}
        log.append(replace(start, velocity=velocity, time_ns=DAY + k * 10**9, **away))
    log = [change(each) for each in stated(log)]
    estimator, group = build([SEA], CONFIG, None, time), Profiles.of(log)
    state, (step,) = estimator.assimilate(estimator.initial(), [group])
    twin = twin_of(estimator, time)
    seen = [(rows, group.time_ns) for rows in Near(twin).rows(*log[:1], log[1:])]
    assert_equal(estimator, state, twin, seen)
    assert (step.innovation.profiles, state.profiles) == (6, 6)
    designs, values, _ = zip(*(rows for rows, _ in seen), strict=True)
    assert step.innovation.dof == sum(map(len, values))
    if change is not relative:
        off = np.nan_to_num(estimator.innovation(state, group)).reshape(6, -1, 2)
        used = start.depth <= LEVELS[-1] - 0.7 * 5
        x, _ = twin.joint(seen, state.time_ns)
        for k in range(6):
            left = (values[k] - designs[k] @ x).reshape(2, -1).T
            np.testing.assert_allclose(off[k][used], left[: used.sum()], atol=1e-10)


def late(log):
    """The sixth comes a quarter of an hour before the fifth, after it: it counts then."""
    log[5] = replace(log[5], time_ns=log[4].time_ns - HOUR // 4)
    return log


@pytest.mark.parametrize(
    ("time", "log"),
    [(FORGETFUL, late(profiles(9))), (OSCILLATING, every_kind()), (ERRING, stated(profiles(9)))],
)
def test_the_smoother_is_the_joint_gaussian_of_all_measurements(time, log):
    estimator = build(forecasts(), CONFIG, None, time)
    twin, times = twin_of(estimator, time), [each.time_ns for each in log]
    counted = np.maximum.accumulate(times).tolist()
    wanted = [times[4], 0, times[2] + DAY // 7, times[-1], times[-1] + DAY]
    wanted += [times[5], times[4] - HOUR // 12, times[3] - DAY // 4]
    rows, near = [], Near(twin)
    for each, time_ns in zip(log, counted, strict=True):
        ((design, *rest),) = near.rows(each)
        # a late one knows less of the unknowns as they are then
        rows.append((design * np.exp((each.time_ns - time_ns) / 1e9 / twin.tau), *rest))
    for at, state in zip(wanted, smooth(estimator, log, wanted), strict=True):
        x, p = twin.joint(list(zip(rows, counted, strict=True)), at)
        np.testing.assert_allclose(state.x, x, atol=1e-8 * np.abs(x).max())
        np.testing.assert_allclose(state.covariance, p, atol=1e-8)
        assert estimator.flow(state).time_ns == at


def test_a_scale_error_moves_the_estimate_by_the_jacobian_and_smoothing_takes_all_of_them():
    """The density of logged values has the factor (1 + s)^-2 less the platform's share, times the innovation's normalised square."""
    time = FORGETFUL.model_copy(update={"biases": ("heading", "scale")})
    estimator, log = build(forecasts(), CONFIG, None, time), stated(profiles(8))
    twin, state, seen, slopes = twin_of(estimator, time), estimator.initial(), [], []
    near = Near(twin)
    functions = twin.process.functions

    def moved(at, count):
        x, p = twin.joint(seen[:count], at)
        return x - p[:, -1] * 0.05 * sum(slopes[:count])

    for count, profile in enumerate(log, 1):
        ((_, _, inflated),) = near.rows(profile)
        design, value, noise = twin.rows(profile)
        _, p = twin.joint(seen, profile.time_ns)
        off = value - design @ moved(profile.time_ns, count - 1)
        whole = np.linalg.inv(design @ p @ design.T + noise)
        # what the bins' functions of depth do not hold is noise alone, and says nothing of the scale
        depth = profile.depth[profile.depth <= LEVELS[-1]]
        at_bins = np.array(
            [functions @ [np.interp(z, LEVELS, one) for one in np.eye(3)] for z in depth]
        )
        of_bins = np.column_stack([at_bins, np.ones(depth.size), depth - depth[0]])
        whiten = np.linalg.inv(np.linalg.cholesky(noise[: depth.size, : depth.size]))
        u, s, _ = np.linalg.svd(whiten @ of_bins, full_matrices=False)
        kept = u[:, s > 1e-10 * s[0]]
        whitened = whiten @ off.reshape(2, -1).T
        left = np.sum(whitened**2) - np.sum((kept.T @ whitened) ** 2)
        one = np.kron(np.eye(2), np.ones((depth.size, 1)))
        shared = profile.common_std**2 * np.trace(one.T @ whole @ one)
        slopes.append((2.0 - shared) * (off @ whole @ off - left) / (2 * kept.shape[1]))
        seen.append(((design, value, inflated), profile.time_ns))
        state, _ = estimator.assimilate(state, [profile])
        expected = moved(profile.time_ns, count)
        np.testing.assert_allclose(state.x, expected, atol=1e-9 * np.abs(expected).max())
    wanted = [log[3].time_ns, 0]
    for at, smoothed in zip(wanted, smooth(estimator, log, wanted), strict=True):
        np.testing.assert_allclose(
            smoothed.x, moved(at, len(log)), atol=1e-8 * np.abs(state.x).max()
        )
    assert any("scale" in line for line in estimator.remarks(state))
