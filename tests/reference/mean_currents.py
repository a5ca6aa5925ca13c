"""Slow obvious twin of the process of mean currents: one Gaussian of all dives, for one setting, every kernel written out."""

import numpy as np

from tests.reference.next_dive import conditional

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
