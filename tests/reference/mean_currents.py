"""Slow obvious twin of the process of mean currents: one Gaussian of all dives, for one setting, every kernel written out."""

import numpy as np

from tests.reference.estimator import log_density

DAY, HOUR = 86_400.0, 3600.0


def kernel(settings, h, apart):
    """Covariance of the current at two instants, without amplitude and axis."""
    slow, matern, lunar, diurnal = settings.parts[h] ** 2
    r = np.sqrt(3.0) * apart / settings.scale[h]
    return (
        slow * np.exp(-apart / (30 * DAY))
        + matern * (1 + r) * np.exp(-r)
        + lunar * np.exp(-apart / (8 * DAY)) * np.cos(2 * np.pi * apart / (12.4206 * HOUR))
        + diurnal * np.exp(-apart / (12 * DAY)) * np.cos(2 * np.pi * apart / (23.9345 * HOUR))
    )


def instants(dive):
    return dive.time_ns / 1e9 + dive.seconds * ((np.arange(4) + 0.5) / 4 - 0.5)


def of_way(dive):
    east, north = dive.way
    return np.array([[east, -north], [north, east]])


def joint(dives, settings, h):
    """Mean currents of all dives, with what their inverted currents say of the flight model, and the covariance of these."""
    along = settings.amplitude[h] ** 2 * settings.axes[h] @ settings.axes[h].T
    flight = settings.flight[h] ** 2 * np.diag([1.0, 0.25])
    rows = [(dive, current) for dive in dives for current in (True, False)]
    rows = [(dive, current) for dive, current in rows if current or dive.inverted is not None]
    values = [dive.velocity - (0.0 if current else dive.inverted) for dive, current in rows]
    blocks = []
    for i, (first, one) in enumerate(rows):
        line = []
        for j, (second, other) in enumerate(rows):
            block = of_way(first) @ flight @ of_way(second).T
            if one and other:
                apart = np.abs(instants(first)[:, None] - instants(second))
                block = block + kernel(settings, h, apart).mean() * along
            if i == j:
                error = (first.position_std / first.seconds) ** 2 + (0.003 if one else 0.03) ** 2
                planned = 1.25 * (settings.flight[h] * first.way_std) ** 2
                block = block + (error + planned) * np.eye(2)
                block = block + (settings.white[h] ** 2 * along if one else 0.0)
            line.append(block)
        blocks.append(line)
    return np.concatenate(values), np.block(blocks)


def forecast(dives, coming, settings, h):
    """Mean and covariance of a coming dive's mean current, and the log-density of those before."""
    values, cov = joint([*dives, coming], settings, h)
    return conditional(values, cov, len(values) - 2)


def conditional(values, cov, known):
    """Mean and covariance of the rest given the first ``known`` values, and the log-density of these."""
    a, b = slice(0, known), slice(known, None)
    gain = cov[b, a] @ np.linalg.inv(cov[a, a])
    density = log_density(values[a], 0.0, cov[a, a]) - 0.5 * known * np.log(2 * np.pi)
    return gain @ values[a], cov[b, b] - gain @ cov[a, b], density


def mean_along(times, depths, levels, current):
    """Mean of a current by depth along a path of straight lines in time and depth, second by second."""
    seconds = np.arange(times[0], times[-1]) + 0.5
    found = [
        [np.interp(depth, levels, component) for component in current.T]
        for depth in np.interp(seconds, times, depths)
    ]
    return np.mean(found, axis=0)
