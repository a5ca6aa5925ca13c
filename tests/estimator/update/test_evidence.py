"""Another prior after the rows: each formula against conditioning again under it, and what the estimate publishes."""

import numpy as np
import pytest

from replay_kit.estimator import build
from replay_kit.estimator.update.evidence import (
    AMPLITUDE_VARIANCES,
    Marginal,
    fitted_scale,
    member_centre,
    scale_changes,
    with_marginal,
    with_mean,
    with_variance,
)
from tests.estimator.seas import CONFIG, SEA, profiles
from tests.reference.dense import Near, Twin
from tests.reference.estimator import kalman_update, log_density

RNG = np.random.default_rng(0)
SIZE, PART = 9, slice(2, 7)
ROWS, VALUES, NOISE = RNG.standard_normal((6, SIZE)), 2.0 * RNG.standard_normal(6), np.eye(6)
WEIGHTS = np.array([0.5, 0.5 / 3, 0.5 / 3, 0.5 / 3])


def conditioned(variance=1.0, mean=0.0, part=PART):
    """Mean and covariance after the rows, and the density of the values, where a part has another prior."""
    prior, about = np.eye(SIZE), np.zeros(SIZE)
    prior[part, part] *= variance
    about[part] = mean
    x, p, *_ = kalman_update(about, prior, ROWS, VALUES, NOISE)
    return x, p, log_density(VALUES, ROWS @ about, ROWS @ prior @ ROWS.T + NOISE)


X, P, DENSITY = conditioned()
MARGINAL = Marginal.of(X[PART], P[PART, PART])


@pytest.mark.parametrize(("before", "after"), [(1.0, 4.0), (1.0, 0.2), (4.0, 0.5), (2.0, 2.0)])
def test_another_variance(before, after):
    x, p, _ = conditioned(before)
    found = with_variance(x, p, PART, before, after)
    for ours, theirs in zip(found, conditioned(after), strict=False):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_another_mean_and_another_marginal():
    mean = RNG.standard_normal(5)
    np.testing.assert_allclose(with_mean(X, P, PART, mean), conditioned(mean=mean)[0], atol=1e-12)
    x, p, _ = conditioned(3.0, 0.7, slice(4, 5))
    for ours, theirs in zip(with_marginal(X, P, 4, x[4], p[4, 4]), (x, p), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_the_evidence_is_the_ratio_of_densities():
    variances, means = np.array([0.15, 0.4, 3.0]), RNG.standard_normal((4, 5))
    expected = [[conditioned(h, m)[2] - DENSITY for m in means] for h in variances]
    np.testing.assert_allclose(MARGINAL.evidence(variances, means), expected, atol=1e-10)
    of_variances = [conditioned(h)[2] - DENSITY for h in variances]
    misfit, determinant, explained = scale_changes(X[PART], np.tril(P[PART, PART]), variances)
    np.testing.assert_allclose(-0.5 * (misfit + determinant), of_variances, atol=1e-10)
    assert explained == pytest.approx(X[PART] @ np.linalg.solve(P[PART, PART], X[PART]))


@pytest.mark.parametrize("expected", [1.0, 2.5])
@pytest.mark.parametrize("noisier", [1.0, 4.0])
def test_the_scale_is_the_likeliest_with_a_factor_on_the_errors(expected, noisier):
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((40, SIZE))
    values = rows @ rng.standard_normal(SIZE) + noisier * rng.standard_normal(40)
    x, p, *_ = kalman_update(np.zeros(SIZE), np.eye(SIZE), rows, values, np.eye(40))

    def log(a, f):
        doubt = (np.log(a / expected) ** 2 + np.log(f) ** 2) / np.log(2.0) ** 2
        return log_density(values, 0.0, a * rows @ rows.T + f * np.eye(40)) - 0.5 * doubt

    scales = np.geomspace(0.05, 20.0, 301)
    noises = np.geomspace(1.0, (scales[5] / scales[0]) ** 28, 8)
    logs = [max(log(a, f) for f in noises) for a in scales]
    found = fitted_scale(x, np.tril(p), expected, 40, float(values @ values))
    assert found == pytest.approx(scales[np.argmax(logs)], rel=0.03)


@pytest.mark.parametrize("profiles_so_far", [3, 20])
def test_the_centre_is_the_mean_of_kernels_about_the_members(profiles_so_far):
    logs, shifts, probability = [], [], np.array([0.5, 0.2, 0.3])
    for h, share in zip((1.0, 0.4, 0.15), probability, strict=True):
        for member in range(3):
            shift = np.sqrt(1.0 - h) * 1.7 * np.eye(5)[member]
            power = min(1.0, 6.0 / profiles_so_far)
            logs.append(np.log(share) + power * conditioned(h, shift)[2])
            shifts.append(shift)
    weights = np.exp(logs - np.max(logs))
    expected = weights @ np.array(shifts) / weights.sum()
    found = member_centre(MARGINAL, 1.7, 3, profiles_so_far, probability)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def mixture(mean, cov, rows, values, noise, variance):
    """Moments after rows of a mixture over the prior variances of the first unknown, one dense update each."""
    parts, logs = [], []
    for each in AMPLITUDE_VARIANCES:
        prior = cov.copy()
        prior[0, 0] = each / variance
        parts.append(kalman_update(mean, prior, rows, values, noise)[:2])
        logs.append(log_density(values, rows @ mean, rows @ prior @ rows.T + noise))
    share = WEIGHTS * np.exp(logs - np.max(logs))
    share /= share.sum()
    middle = sum(s * x for s, (x, _) in zip(share, parts, strict=True))
    spread = sum(
        s * (p + np.outer(x - middle, x - middle)) for s, (x, p) in zip(share, parts, strict=True)
    )
    return middle, spread


def test_an_estimate_publishes_the_average_and_the_likeliest_scale():
    """Of a made ensemble, whose members give no centre: what all values say of amplitude and scale, at once."""
    config = CONFIG.model_copy(update={"spread": "fit", "mean_variance": None})
    estimator, log = build([SEA], config), profiles(5)
    twin = Twin(estimator.flow(estimator.initial()))
    state, _ = estimator.assimilate(estimator.initial(), log)
    near = Near(twin)
    seen = [rows for each in log for rows in near.rows(each)]
    rows, values = (np.concatenate(each) for each in list(zip(*seen, strict=True))[:2])
    noise = np.zeros((len(values), len(values)))
    ends = np.cumsum([0, *(len(y) for _, y, _ in seen)])
    for k, (_, _, r) in enumerate(seen):
        noise[ends[k] : ends[k + 1], ends[k] : ends[k + 1]] = r
    size = rows.shape[1]
    x, p = mixture(np.zeros(size), np.eye(size), rows, values, noise, 0.1)
    unknowns = estimator.flow(state).unknowns
    np.testing.assert_allclose(unknowns.x, x, atol=1e-9)
    np.testing.assert_allclose(unknowns.p, p, atol=1e-9)

    def density(a):
        prior = np.diag([1.0, *np.full(size - 1, a)])
        return log_density(values, 0.0, rows @ prior @ rows.T + noise) - 0.5 * np.log2(a) ** 2

    scales = np.geomspace(0.3, 15.0, 1001)
    likeliest = scales[np.argmax([density(a) for a in scales])]
    # six members span less than the twenty for which it is 1, by Student's distribution
    few = (7 / 6 * 5 / 3) / (21 / 20 * 19 / 17)
    assert unknowns.scale == pytest.approx(few * max(1.0, likeliest), rel=1e-2)
    _, variance = twin.velocity(x, p, np.array([3e3, -2e3]), 40.0, 0)
    np.testing.assert_allclose(
        estimator.flow(state).standard_error(3e3, -2e3, 40.0) ** 2,
        unknowns.scale * variance,
        rtol=1e-8,
    )
