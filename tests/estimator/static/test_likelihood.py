"""The joint likelihood of profiles against one dense Gaussian, and against the filter that takes them one by one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.estimator import build_estimator
from replay_kit.estimator.static.likelihood import predict_jointly
from tests import synthetic
from tests.reference import estimator as slow
from tests.reference.lattice import matrix as functions_at
from tests.reference.representation import error_at

SMALL = synthetic.ensemble(n_members=6, shape=(4, 5), levels=np.array([5.0, 90.0, 220.0]))
ESTIMATOR = build_estimator(SMALL, EstimatorConfig(modes=10))
PROFILES = synthetic.random_profiles(SMALL.grid, 4)
BINS = [np.flatnonzero(profile.depth <= SMALL.grid.levels[-1]) for profile in PROFILES]


def dense(profiles, bins):
    """Return values, their mean and their covariance, number by number."""
    basis, grid = ESTIMATOR.basis, SMALL.grid
    rows, values, offsets, errors = [], [], [], []
    for profile, used in zip(profiles, bins, strict=True):
        place = np.array([to_local(grid.projection, profile.longitude, profile.latitude)], float)
        kernel = functions_at(basis.horizontal, place)
        weights = depth_weights(basis.depth_functions, profile.depth[used], grid.levels)
        measured = rotate_to_local(
            grid.projection, profile.longitude, profile.latitude, *profile.velocity[used].T
        )
        for k, bin_at in enumerate(used):
            for component in range(2):
                rows.append(np.kron(weights[k], (kernel @ basis.modes)[component]))
                offsets.append(weights[k] @ (kernel @ basis.offset)[component])
                values.append(measured[component][k])
                representation = np.interp(
                    profile.depth[bin_at],
                    grid.levels,
                    error_at(ESTIMATOR, profile.longitude, profile.latitude),
                )
                errors.append(np.hypot(profile.error_std[bin_at], representation))
    h = np.array(rows)
    mean = np.array(offsets) + h @ ESTIMATOR.prior.mean
    return (
        np.array(values),
        mean,
        h @ ESTIMATOR.prior.covariance() @ h.T + np.diag(np.square(errors)),
    )


def assert_density(found, values, mean, cov):
    nis = (values - mean) @ np.linalg.solve(cov, values - mean)
    expected = (slow.log_density(values, mean, cov), nis, values.size)
    assert (found.log, found.nis, found.dof) == pytest.approx(expected, rel=1e-9)


def test_it_is_the_density_of_one_dense_gaussian():
    found = predict_jointly(ESTIMATOR, PROFILES, BINS).of(PROFILES)
    values, mean, cov = dense(PROFILES, BINS)
    assert_density(found, values, mean, cov)


def relative(profile):
    """The profile, of a platform of unknown velocity."""
    return replace(profile, common_std=np.inf, reference="platform")


def differences(profiles, bins):
    """The matrix from the values of ``dense`` to what is known of them: of a relative profile differences of neighbours alone."""
    identities = [
        (np.eye(used.size), np.isinf(each.common_std))
        for each, used in zip(profiles, bins, strict=True)
    ]
    return block_diag(
        *[
            np.kron(np.diff(one, axis=0) if is_relative else one, np.eye(2))
            for one, is_relative in identities
        ]
    )


@pytest.mark.parametrize("unreferenced", [(0,), (1, 3), (0, 1, 2, 3)])
def test_of_relative_profiles_it_is_the_density_of_their_differences(unreferenced):
    profiles = [relative(each) if k in unreferenced else each for k, each in enumerate(PROFILES)]
    # each with other bins
    bins = [used[k:] for k, used in enumerate(BINS)]
    found, known = (
        predict_jointly(ESTIMATOR, profiles, bins).of(profiles),
        differences(profiles, bins),
    )
    values, mean, cov = dense(profiles, bins)
    values, mean, cov = known @ values, known @ mean, known @ cov @ known.T
    assert_density(found, values, mean, cov)


@pytest.mark.parametrize("bins", [0, 1])
def test_a_profile_without_bins_says_nothing_and_a_relative_one_of_one_bin_neither(bins):
    first = relative(PROFILES[0]) if bins else PROFILES[0]
    profiles, some = [first, *PROFILES[1:]], [BINS[0][:bins], *BINS[1:]]
    ours, theirs = (
        predict_jointly(ESTIMATOR, profiles, some),
        predict_jointly(ESTIMATOR, PROFILES[1:], BINS[1:]),
    )
    assert ours.of(profiles) == theirs.of(PROFILES[1:])


@pytest.mark.parametrize("profile", [PROFILES[0], relative(PROFILES[0])])
def test_one_profile_is_what_the_filter_says_of_it(profile):
    _, innovation = ESTIMATOR.step(ESTIMATOR.initial(), profile)
    found = predict_jointly(ESTIMATOR, [profile], BINS[:1]).of([profile])
    assert (found.nis, found.dof) == (pytest.approx(innovation.nis, rel=1e-9), innovation.dof)
    assert found.log == pytest.approx(innovation.log_likelihood, rel=1e-9)


def test_other_velocities_need_no_other_prediction():
    turned = [replace(profile, velocity=profile.velocity[:, ::-1]) for profile in PROFILES]
    ours = predict_jointly(ESTIMATOR, PROFILES, BINS).of(turned)
    assert ours.log == pytest.approx(
        predict_jointly(ESTIMATOR, turned, BINS).of(turned).log, rel=1e-12
    )
