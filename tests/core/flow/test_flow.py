"""What an estimate says: velocities, errors, covariances, samples and later times, against sums written out."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import EstimatorError
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from tests.core.flow.made import HOUR, changing
from tests.reference.dense import Twin
from tests.synthetic_flow import TIME_NS, synthetic_flow

PLACES = np.array([[1e3, 2e3], [-4e3, 0.0], [1e3, 2e3], [9e3, 7e3]])
DEPTHS = np.array([5.0, 60.0, 180.0, 25.0])
AT = PLACES[:, 0], PLACES[:, 1], DEPTHS


def rows_of(flow, hours):
    """Velocities of no unknown, effects of each on all east then all north, and the errors beside, some hours on."""
    twin = Twin(flow)
    points = [twin.point(*at, TIME_NS + hours * HOUR) for at in zip(PLACES, DEPTHS, strict=True)]
    means, effects, errors = (np.array(each) for each in zip(*points, strict=True))
    return means, effects.swapaxes(0, 1).reshape(2 * len(PLACES), -1), errors


def stated(flow, hours):
    """Mean and covariance of the velocities, all east then all north, and the error beside, some hours on."""
    known, (means, rows, errors) = flow.unknowns, rows_of(flow, hours)
    kept = np.exp(-3600.0 * hours / flow.unknowns.process.tau)
    x, p = kept * known.x, np.outer(kept, kept) * known.p + np.diag(1.0 - kept**2)
    mean = means + (rows @ x).reshape(2, -1).T
    return mean, known.scale * rows @ p @ rows.T, known.scale * errors**2


@pytest.mark.parametrize("hours", [0, 1, 6, 40])
@pytest.mark.parametrize("kind", [{}, {"on_lattice": True, "potential": False}, {"n_fixed": 0}])
def test_velocity_error_and_covariance_are_those_of_the_process(kind, hours):
    flow = changing(**kind)
    mean, cov, error = stated(flow, hours)
    later = flow.at(TIME_NS + hours * HOUR)
    assert later.time_ns == TIME_NS + hours * HOUR
    np.testing.assert_allclose(later.velocity(*AT), mean, rtol=1e-9, atol=1e-12)
    found = later.velocity_covariance(*AT)
    np.testing.assert_allclose(found, cov, atol=1e-10 * cov.max())
    variance = np.diag(cov).reshape(2, -1).T + error[:, None]
    np.testing.assert_allclose(later.standard_error(*AT) ** 2, variance, rtol=1e-9)
    # many points over few places are computed by place
    many = later.standard_error(np.repeat(AT[0], 600), np.repeat(AT[1], 600), np.tile(DEPTHS, 600))
    np.testing.assert_allclose(many[::601][:4], later.standard_error(*AT), rtol=1e-9)
    # in one step or in two
    again = flow.at(TIME_NS + hours * HOUR // 3).at(TIME_NS + hours * HOUR)
    np.testing.assert_allclose(again.velocity_covariance(*AT), found, rtol=1e-9, atol=1e-12)


def test_errors_turn_to_true_axes_with_their_covariance():
    flow = changing(spacing=150_000.0)
    points = 30.0 * PLACES[:, 0], 30.0 * PLACES[:, 1], DEPTHS
    projection = flow.grid.projection
    here = to_geographic(projection, *points[:2])
    turn = [
        np.diag(each) for way in np.eye(2) for each in rotate_to_geographic(projection, *here, *way)
    ]
    turn = np.block([[turn[0], turn[2]], [turn[1], turn[3]]])
    local, turned = (flow.velocity(*points, axes).T.ravel() for axes in (False, True))
    np.testing.assert_allclose(turned, turn @ local, rtol=1e-9)
    assert np.abs(turned - local).max() > 0.05
    of_local, found = (flow.velocity_covariance(*points, axes) for axes in (False, True))
    np.testing.assert_allclose(found, turn @ of_local @ turn.T, atol=1e-9 * found.max())
    errors = [flow.standard_error(*points, axes).T.ravel() ** 2 for axes in (False, True)]
    beside = errors[0] - np.diag(of_local)
    np.testing.assert_allclose(errors[1], np.diag(found) + beside, rtol=1e-7)


@pytest.mark.parametrize("hours", [(0,), (0, 3, 9)])
def test_samples_have_the_moments_of_the_estimate_and_the_correlation_of_the_process(hours):
    flow, count = changing(3, 1), 3000
    times = [TIME_NS + hour * HOUR for hour in hours]
    drawn = flow.sample_through(times, count, 5)
    assert [one.time_ns for one in drawn[0]] == times
    assert drawn[0][0].unknowns is None
    values = np.array([[one.velocity(*AT).T.ravel() for one in each] for each in drawn])
    for k, hour in enumerate(hours):
        mean, cov, _ = stated(flow, hour)
        size = np.sqrt(np.diag(cov))
        off = (values[:, k] - mean.T.ravel()) / size
        assert np.abs(off.mean(axis=0)).max() < 5.0 / np.sqrt(count)
        np.testing.assert_allclose(off.T @ off / count, cov / np.outer(size, size), atol=0.1)
        # between the first time and a later one only the decay of the unknowns counts
        first, later = (rows_of(flow, t)[1] for t in (0, hour))
        kept = np.exp(-3600.0 * hour / flow.unknowns.process.tau)
        cross = 1.7 * first @ (flow.unknowns.p * kept) @ later.T
        begun, about = (values[:, j] - values[:, j].mean(axis=0) for j in (0, k))
        scale = np.outer(np.sqrt(np.diag(stated(flow, 0)[1])), size)
        np.testing.assert_allclose(begun.T @ about / count / scale, cross / scale, atol=0.1)
    one, same = (each.sample(1, 7)[0] for each in (flow, pickle.loads(pickle.dumps(flow))))
    np.testing.assert_array_equal(one.latent, same.latent)


def test_a_covariance_without_full_rank_has_samples_and_one_that_is_no_number_has_none():
    def known(p):
        return replace(changing(), unknowns=replace(changing().unknowns, p=p))

    half = np.random.default_rng(1).standard_normal((7, 2))
    root = known(half @ half.T).unknowns.root
    np.testing.assert_allclose(root @ root.T, 1.7 * half @ half.T, atol=1e-12)
    (certain,) = known(np.zeros((7, 7))).sample(1, 0)
    np.testing.assert_allclose(certain.latent, changing().latent, atol=1e-12)
    with pytest.raises(EstimatorError, match="covariance is not a number everywhere"):
        known(np.full((7, 7), np.nan)).sample(3, 0)


def test_before_its_last_observation_an_estimate_stays_and_a_constant_one_is_of_its_own_time():
    flow, still, forecast = changing(), changing(times=1), changing(time_ns=None)
    np.testing.assert_array_equal(flow.at(TIME_NS - HOUR).latent, flow.latent)
    assert flow.at(TIME_NS - HOUR).time_ns == flow.last_observation_ns == TIME_NS
    assert (still.process, still.last_observation_ns) == (None, None)
    first, second = still.sample_through([TIME_NS, TIME_NS + HOUR], 1, 3)[0]
    np.testing.assert_array_equal(first.latent, second.latent)
    for time_ns in (TIME_NS - 7 * HOUR, TIME_NS + 9 * HOUR):
        assert still.at(time_ns) is still
        later = forecast.at(time_ns)
        assert later.time_ns == time_ns
        np.testing.assert_array_equal(later.unknowns.p, forecast.unknowns.p)


def test_the_forecast_s_times_that_are_over_count_no_more():
    process = changing().process
    kept = [process.since(TIME_NS + hours * HOUR) for hours in (4, -90, 90)]
    assert [(each.times_ns[0] - TIME_NS) // HOUR for each in kept] == [4, -8, 10]
    for hours in (5, 12):
        at = TIME_NS + hours * HOUR
        np.testing.assert_array_equal(kept[0].loading(at), process.loading(at))
        np.testing.assert_array_equal(kept[0].mean_at(at), process.mean_at(at))


def test_outside_and_below_nothing_is_known_and_a_flow_alone_has_no_error(flow):
    found = changing().velocity_covariance([1e3, 1e3], 2e3, [5.0, 900.0])
    assert np.isnan(found).tolist() == [[False, True] * 2, [True] * 4] * 2
    assert np.isnan(changing().standard_error([1e3, 1e6], 2e3, [900.0, 5.0])).all()
    without = flow.mean_flow()
    for ask in (without.velocity_covariance, without.standard_error):
        with pytest.raises(EstimatorError, match="needs an estimate with a covariance"):
            ask(0.0, 0.0, 5.0)
    with pytest.raises(EstimatorError, match="has no model of time"):
        without.at(TIME_NS)


def test_where_nothing_was_measured_the_error_is_that_of_a_regression_at_least():
    flow = synthetic_flow(n_modes=2)
    known = flow.unknowns
    assert known is not None
    # levels that vary together in the prior, known alike after it
    mixing = np.linalg.cholesky(np.array([[1.0, 0.9, 0.5], [0.9, 1.0, 0.7], [0.5, 0.7, 1.0]]))
    unit = np.kron(mixing.T, np.eye(2)).reshape(1, 6, 3, 2)
    process = replace(known.process, moving=unit)
    small = replace(known, process=process, p=1e-3 * np.eye(6), scaled=1.5)

    def errors(*measured):
        held = replace(flow, unknowns=replace(small, measured=np.array(measured)))
        return held.standard_error(*flow.nodes[4], flow.levels)

    plain, found = errors(True, True, True), errors(False, True, True)
    np.testing.assert_allclose(found[1:], plain[1:])
    modes = flow.horizontal.velocity(flow.nodes, flow.modes).reshape(-1, 2)
    c = 1.5 * (mixing @ mixing.T) * np.mean(np.sum(modes**2, axis=1))
    for k in range(2):
        gain = c[0, 1:] @ np.linalg.inv(c[1:, 1:] + np.diag(plain[1:, k] ** 2))
        assert found[0, k] == pytest.approx(np.sqrt(c[0, 0] - gain @ c[1:, 0]))
        assert found[0, k] > 2.0 * plain[0, k]
