"""Slow obvious twin of the model of mean currents: one Gaussian of all dives, for one combination of settings, without changes."""

import numpy as np

from tests.reference.estimator import log_density


def joint_covariance(dives, settings, h, inverted_std):
    """Mean-current and flight-residual covariance of all dives, and the vector that they are the covariance of."""
    rows, values, noise, kinds = [], [], [], []
    for dive in dives:
        rows.append(dive.design)
        values.append(dive.velocity - about(dive, settings.background[h]))
        noise.append(settings.white_std[h] ** 2 + (dive.position_std / dive.seconds) ** 2)
        kinds.append(dive.time_ns)
        if dive.inverted is not None:
            design = dive.design.copy()
            design[:, :6] = 0.0
            rows.append(design)
            values.append(dive.velocity - dive.inverted)
            noise.append(inverted_std**2 + (dive.position_std / dive.seconds) ** 2)
            kinds.append(dive.time_ns)
    n = len(rows)
    cov = np.zeros((2 * n, 2 * n))
    for i in range(n):
        for j in range(n):
            apart = abs(kinds[i] - kinds[j]) / 1e9
            block = (
                rows[i]
                @ np.diag(settings.variance[h] * np.exp(-apart / settings.scales[h]))
                @ rows[j].T
            )
            cov[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block + (
                noise[i] * np.eye(2) if i == j else 0.0
            )
    return np.concatenate(values), cov


def conditional(values, cov, known):
    """Mean and covariance of the rest given the first ``known`` values, and the log-density of these."""
    a, b = slice(0, known), slice(known, None)
    gain = cov[b, a] @ np.linalg.inv(cov[a, a])
    density = log_density(values[a], 0.0, cov[a, a]) - 0.5 * known * np.log(2 * np.pi)
    return gain @ values[a], cov[b, b] - gain @ cov[a, b], density


def about(dive, background):
    """The current that a dive's mean is measured about."""
    return np.zeros(2) if background == 0 else dive.backgrounds[background - 1]


def mean_along(times, depths, levels, current):
    """Mean of a current by depth along a path of straight lines in time and depth, second by second."""
    seconds = np.arange(times[0], times[-1]) + 0.5
    found = [
        [np.interp(depth, levels, component) for component in current.T]
        for depth in np.interp(seconds, times, depths)
    ]
    return np.mean(found, axis=0)
