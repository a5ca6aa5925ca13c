"""The restricted likelihood, the slope and the geopotential of a section, term by term."""

import numpy as np

from replay_kit.measurements.ctd.sections import GRAVITY, RHO0


def geopotential(anomaly, levels):
    """Return the geopotential of one profile without its depth mean, by sums over layers."""
    found = np.zeros(levels.size)
    for k in range(levels.size):
        for j in range(k, levels.size - 1):
            found[k] += (
                0.5 * (anomaly[j] + anomaly[j + 1]) * RHO0 * GRAVITY * (levels[j + 1] - levels[j])
            )
    return found - np.trapezoid(found, levels) / (levels[-1] - levels[0])


def log_evidence(covariance, trend, values, prior, counts):
    """Return the log likelihood of values without their trend: of contrasts that do not see it, but for a constant."""
    n = values.size
    contrasts = np.linalg.svd(trend)[0][:, trend.shape[1] :]
    seen = contrasts.T @ covariance @ contrasts
    misfit = contrasts.T @ values @ np.linalg.inv(seen) @ contrasts.T @ values
    freedom = counts + n - trend.shape[1]
    log_determinant = np.log(np.linalg.det(seen))
    return -0.5 * log_determinant - 0.5 * freedom * np.log(counts * prior + misfit)


def slope(along, values, covariance):
    """Return the generalised least-squares slope by whitening."""
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    trend = np.stack([np.ones(along.size), along], axis=1)
    return np.linalg.lstsq(white @ trend, white @ values, rcond=None)[0][1]
