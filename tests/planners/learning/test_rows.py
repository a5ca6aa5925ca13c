"""The covariance that profiles leave: against dense twins, the estimator's own update, and finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from planners.front.current import shares_of_levels
from planners.learning.current import currents_of
from planners.learning.loops import Aim, Survey, shapes, timed
from planners.learning.rows import (
    covariance,
    gains,
    learnt,
    posterior,
    rows_at,
    stacked,
    unknowns_at,
)
from planners.learning.transit import end_sensitivity, fly, plan_transit
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.depth_means import depth_means
from tests import synthetic
from tests.planners.learning.scenes import (
    DEPTH,
    HOUR,
    MEMBERS,
    NOON,
    SPEED,
    estimator,
    known,
    mean,
    places,
    static,
    through_time,
)
from tests.reference import learning as slow


def test_covariances_of_depth_means_are_those_of_all_weights():
    points, shares = places(5), shares_of_levels(static(), DEPTH, 0.0)
    rows = rows_at(known(), points, np.zeros(5))
    wanted = slow.static_rows(static(), shares, points)
    np.testing.assert_allclose(
        covariance(rows, rows), wanted @ static().weight_cov @ wanted.T, rtol=1e-9, atol=1e-12
    )


def test_several_depths_share_one_covariance_whatever_its_form():
    flow = static()
    two = np.stack([shares_of_levels(flow, DEPTH, 0.0), np.eye(flow.levels.size)[1]])
    points = places(3)
    by_matrix, by_factors = (
        depth_means(replace(flow, covariance=flow.weight_cov), two),
        depth_means(replace(flow), two),
    )
    for means in (by_matrix, by_factors):
        rows = stacked(rows_at(means, points, np.zeros(3)), rows_at(means, points, np.zeros(3), 1))
        wanted = np.vstack([slow.static_rows(flow, share, points) for share in two])
        np.testing.assert_allclose(
            covariance(rows, rows), wanted @ flow.weight_cov @ wanted.T, rtol=1e-8, atol=1e-11
        )


def test_covariances_through_time_are_those_of_the_processes_unknowns():
    points, times = places(4), np.array([0.0, 9.0, 20.0, 47.0]) * HOUR
    rows = rows_at(known(True), points, times)
    shares = shares_of_levels(through_time(), DEPTH, 0.0)
    wanted = slow.covariance_through_time(
        through_time(), shares, points, NOON + (times * 1e9).astype(np.int64)
    )
    np.testing.assert_allclose(covariance(rows, rows), wanted, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("changes", [False, True])
def test_posterior_and_mean_are_the_textbook_s(changes):
    means, points, times = known(changes), places(6), np.linspace(0.0, 30.0, 6) * HOUR
    measured, end = rows_at(means, points, times), 40.0 * HOUR
    sought = rows_at(means, places(2, 5), np.full(2, end))
    both = stacked(measured, sought)
    joint = covariance(both, both)
    pick = np.eye(16)[:12]
    left = slow.textbook(joint, pick, 1e-3)
    np.testing.assert_allclose(
        posterior(sought.combined(np.eye(4)), measured, 1e-3), left[12:, 12:], rtol=1e-7, atol=1e-10
    )
    values = np.random.default_rng(0).standard_normal(12)
    weighed = gains(measured, values, 1e-3)
    np.testing.assert_allclose(
        weighed @ covariance(measured, sought),
        joint[12:, :12] @ np.linalg.inv(joint[:12, :12] + 1e-3 * np.eye(12)) @ values,
    )
    # by way of the unknowns
    unknowns = learnt(means, measured, weighed, end)
    loading = means.loading(means.time_ns + round(end * 1e9))[:, 0]
    by_unknowns = means.modes(places(2, 5)) @ loading.T @ unknowns
    np.testing.assert_allclose(
        by_unknowns.ravel(), weighed @ covariance(measured, sought), rtol=1e-8, atol=1e-12
    )


def test_unknowns_have_the_estimate_s_variance():
    own = unknowns_at(known(True), 20.0 * HOUR)
    point = places(1)
    flow = through_time().at(NOON + round(20.0 * HOUR * 1e9))
    loading, modes = (
        known(True).loading(NOON + round(20.0 * HOUR * 1e9))[:, 0],
        known(True).modes(point)[0],
    )
    rows = slow.static_rows(flow, shares_of_levels(flow, DEPTH, 0.0), point)
    np.testing.assert_allclose(
        modes @ loading.T @ covariance(own, own) @ loading @ modes.T,
        rows @ flow.weight_cov @ rows.T,
        rtol=1e-8,
    )


def test_two_rows_a_place_replace_a_profile_within_3_percent():
    """A whole run of the estimator's own update, with profiles that measure what it expects, each bin with its own error."""
    flow, depth = static(), 10.0 + 20.0 * np.arange(15)
    survey = timed(mean(), 0j, shapes(1.0 + 0j)[9:10], (0.0, 26.0 * HOUR, 9), SPEED)
    planned = plan_transit(
        mean(), np.zeros(1, dtype=complex), 26.0 * HOUR, np.array([20e3 + 4e3j]), 23.0 * HOUR, SPEED
    )
    sense = end_sensitivity(mean(), 0j, 26.0 * HOUR, planned)
    points, shares = (
        np.stack([sense.points.real, sense.points.imag], axis=-1),
        shares_of_levels(flow, DEPTH, 0.0),
    )
    state, std = estimator().initial(), 0.08
    before = estimator().flow(state)
    rng, given = np.random.default_rng(4), []
    for k, point in enumerate(survey.points[0]):
        values = before.velocity(*point, depth) + std * rng.standard_normal((depth.size, 2))
        given.append(synthetic.profile(MEMBERS.grid, *point, depth, values, std, time_ns=k))
    for after, _ in estimator().steps(state, given):
        state = after
    rows = sense.weights @ slow.static_rows(flow, shares, points)
    whole = np.sqrt(np.trace(rows @ estimator().flow(state).weight_cov @ rows.T))
    prior = np.sqrt(np.trace(rows @ before.weight_cov @ rows.T))
    aim = Aim(
        known(), rows_at(known(), points, sense.times).combined(sense.weights), std**2 / depth.size
    )
    assert aim.before() == pytest.approx(prior, rel=1e-9)
    assert whole < 0.6 * prior
    assert aim.judge(survey)[0] == pytest.approx(whole, rel=0.03)


def test_candidates_together_are_judged_as_alone_and_others_help_less_where_they_repeat():
    survey = timed(mean(), 0j, shapes(1.0 + 0j), (0.0, 20.0 * HOUR, 6), SPEED)
    assert survey.flown.all()
    aim = Aim(
        known(), rows_at(known(), places(1, 3), np.array([40.0 * HOUR])).combined(np.eye(2)), 1e-3
    )
    together = aim.judge(survey)
    for k in (0, 1, 17, 64):
        alone = posterior(aim.sought, rows_at(known(), survey.points[k], survey.times), 1e-3)
        assert together[k] == pytest.approx(np.sqrt(np.trace(alone)), rel=1e-9)
    best = int(np.argmin(together))
    shared = replace(aim, given=rows_at(known(), survey.points[best], survey.times))
    assert shared.before() == pytest.approx(together[best], rel=1e-9)
    # another glider that does the same brings less than one that goes where the first did not
    assert np.argmin(shared.judge(survey)) != best or shared.judge(survey)[best] < together[best]
    assert np.all(shared.judge(survey) < together + 1e-12)


@pytest.mark.parametrize("changes", [False, True])
def test_the_end_s_sensitivity_is_its_derivative(changes):
    """Central differences of the end by the current of each of some modes, to 1e-6."""
    means = known(changes)
    times = mean(changes).times
    planned = plan_transit(
        mean(changes),
        np.array([1e3 - 2e3j]),
        3600.0,
        np.array([8e3 + 3e3j, 15e3 + 1e3j]),
        20.0 * HOUR,
        SPEED,
    )
    sense = end_sensitivity(mean(changes), 1e3 - 2e3j, 3600.0, planned)

    def ended(currents):
        place, when = np.array([1e3 - 2e3j]), 3600.0
        for held, duration in zip(planned.through_water[0], planned.durations, strict=True):
            place = fly(currents, place, when, np.array([held]), duration)[-1]
            when += duration
        return place[0]

    assert ended(mean(changes)) == pytest.approx(planned.ends[0, -1], rel=1e-12)
    rng, latent = np.random.default_rng(2), means.latent(NOON)[:, 0]
    for _ in range(3):
        shape = rng.standard_normal((times.size, latent.size)) * np.abs(latent).max()
        added = currents_of(means.flow, list(shape[:, None]), times)
        step = 1e-4
        more, less = (
            replace(
                added, coefficients=mean(changes).coefficients + sign * step * added.coefficients
            )
            for sign in (1, -1)
        )
        by_difference = (ended(more) - ended(less)) / (2.0 * step)
        current = added.at(sense.points[None], sense.times)[0]
        by_weights = sense.weights @ np.stack([current.real, current.imag], axis=-1).ravel()
        assert complex(*by_weights) == pytest.approx(by_difference, rel=1e-6)


def test_an_estimate_without_uncertainty_has_no_depth_means():
    with pytest.raises(EstimatorError, match="with its uncertainty"):
        depth_means(static().mean_flow(), np.eye(4)[:1])


def test_one_profile_more_never_hurts():
    aim = Aim(known(), rows_at(known(), places(3, 1), np.zeros(3)).combined(np.eye(6)), 1e-3)
    points = places(7, 2)
    nested = [aim.judge(_still(points[:k]))[0] for k in range(1, 8)]
    assert np.all(np.diff(nested) <= 1e-12)
    assert nested[0] < aim.before()


def _still(points):
    at = (points[:, 0] + 1j * points[:, 1])[None]
    return Survey(at, at, at, np.zeros(len(points)), np.ones(1, dtype=bool))
