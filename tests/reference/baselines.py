"""The baselines, slow and obvious: loops over members, columns and bins, inverses written as inverses."""

import math

import numpy as np
import scipy.integrate
import scipy.linalg

from tests.reference.dense import hats
from tests.reference.estimator import kalman_update


def member_at(slices, levels, at_place, depth):
    """One member, shape (Z, 2N), interpolated to a point: from the nodes by a matrix, shape (2, 2N), and by hats in depth."""
    shares = hats(depth, levels)
    return sum(share * (at_place @ one) for share, one in zip(shares, slices, strict=True))


def design_of_members(members, levels, at_place, depths):
    """Velocity of every member at every bin, shape (E, n, 2)."""
    return np.array(
        [[member_at(member, levels, at_place, depth) for depth in depths] for member in members]
    )


def nearest(members_at_profiles, values, error_std):
    """Position of the member with the least sum of squares; lists by profile of (E, n, 2) and (n, 2)."""
    n_members = len(members_at_profiles[0])
    sums = [
        sum(
            float(np.sum(((v - at[e]) / s) ** 2))
            for at, v, s in zip(members_at_profiles, values, error_std, strict=True)
        )
        for e in range(n_members)
    ]
    return int(np.argmin(sums))


def naive(members, modes_at_profiles, values, error_std):
    """Mean and covariance of the weights of whole-member singular vectors; ``modes_at_profiles`` are functions of the modes' matrix."""
    columns = members.reshape(len(members), -1).T
    modes = np.linalg.svd(columns, full_matrices=False)[0]
    weights = modes.T @ columns
    mean, cov = weights.mean(axis=1), np.diag(weights.var(axis=1, ddof=1))
    for at, value, std in zip(modes_at_profiles, values, error_std, strict=True):
        design = at(modes)
        mean, cov, _, _ = kalman_update(
            mean, cov, design, value.ravel(), std**2 * np.eye(value.size)
        )
    return modes, mean, cov


def gaspari_cohn(distance, radius):
    """Equation 4.10 of Gaspari and Cohn (1999) with half-width radius / 2, case by case."""
    r = distance / (radius / 2)
    if r <= 1:
        return -(r**5) / 4 + r**4 / 2 + 5 * r**3 / 8 - 5 * r**2 / 3 + 1
    if r < 2:
        return r**5 / 12 - r**4 / 2 + 5 * r**3 / 8 + 5 * r**2 / 3 - 5 * r + 4 - 2 / (3 * r)
    return 0.0


def crps_by_quadrature(error, std):
    """Integral of (F - step)^2 of a Gaussian with a given mean error; the step is at zero, where the integral is cut in two."""

    def cdf(x):
        return 0.5 * (1 + math.erf((x - error) / (std * math.sqrt(2))))

    far = abs(error) + 12 * std
    below = scipy.integrate.quad(lambda x: cdf(x) ** 2, -far, 0.0, epsabs=1e-12)[0]
    return below + scipy.integrate.quad(lambda x: (1 - cdf(x)) ** 2, 0.0, far, epsabs=1e-12)[0]
