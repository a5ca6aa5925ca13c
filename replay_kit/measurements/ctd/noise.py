"""Internal waves and mesoscale signal in profiles of geopotential, fitted to a line by their likelihood.

Each vertical mode k of the geopotential has the covariance s2 (R + q K) between profiles: R of internal waves and the semidiurnal tide in
time, K of the signal in place and time. No single fit is trusted: covariances are averaged over their posterior on a grid of settings. The
waves of all modes have one level over Garrett and Munk's, from which a mode differs by as much as all of them show.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaln

from replay_kit.core.arrays import Array
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0

# Grid of settings: decay of the waves in units of 1/f, share of the tide, length of the signal in Rossby radii, signal over noise.
_DECAYS, _TIDES = (0.15, 0.4, 1.0), (0.0, 0.3, 0.6, 0.85)
_LENGTHS = ((1.0, -0.5), (1.6, 0.0), (2.5, -0.5))
_RATIOS = 10.0 ** np.arange(-1.5, 3.6, 0.5)
_TIDE_PERIOD, _TIDE_DECAY = 12.42 * 3600.0, 72.0 * 3600.0
_WHITE = 0.1
# The signal's time is this many times its length over the speed of the region, between a day and twenty [s]: geopotential of
# quasi-geostrophic forecasts changes by 0.4 of its size in two days where currents have 0.21 m/s and lengths of 40 km.
_TURNOVER, _SHORTEST, _LONGEST = 2.5, 86_400.0, 20.0 * 86_400.0
# Level of a line's waves over Garrett and Munk's, spread of its logarithm, prior counts of a mode's variance about it; and counts of the
# modes' covariance.
_LEVELS, _SPREAD, _COUNTS, _MODE_COUNTS = 2.0 ** np.arange(-2, 5), 1.0, (2.2, 5.0, 12.0, 30.0), 60.0
# Median speed of all modes [m/s], and the spread of its logarithm.
_SPEED, _SPEED_SPREAD = 0.05, 1.3
_MODES, _WAVE_MODES = 10, 30
# Share of the largest variance of waves below which a mode has none but by rounding.
_NO_WAVES = 1e-9


@dataclass(frozen=True, slots=True)
class Regime:
    """What sets the scales of a region's currents.

    Attributes:
        coriolis: Coriolis parameter [1/s]; negative in the south.
        rossby_radius: First baroclinic [m].
        speed: Rms speed of the currents over the levels [m/s].
    """

    coriolis: float
    rossby_radius: float
    speed: float


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """The signal of one mode in place and time: amplitude times exp(-ds^2/2L^2 - dt^2/2T^2), averaged over what is not known.

    Attributes:
        length: L [m].
        time: T [s].
        amplitude: shape (k,) [m4/s4], of each mode's geopotential, times its posterior probability.
    """

    length: float
    time: float
    amplitude: Array

    def covariance(self, along: Array, time: Array) -> Array:
        """Return the correlations of profiles, shape (n, n)."""
        return np.asarray(
            np.exp(
                -0.5 * ((along[:, None] - along) / self.length) ** 2
                - 0.5 * ((time[:, None] - time) / self.time) ** 2
            )
        )

    def with_slope(self, along: Array, time: Array, at: float) -> Array:
        """Return the correlations of profiles with the slope of the signal at a place and at time 0, shape (n,) [1/m]."""
        away = along - at
        near = np.exp(-0.5 * (away / self.length) ** 2 - 0.5 * (time / self.time) ** 2)
        return np.asarray(away / self.length**2 * near)


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Covariances of the geopotential on a line.

    Attributes:
        modes: shape (Z, k), orthonormal vertical modes.
        noise: shape (k, n, n) [m4/s4], of each mode between profiles, averaged over the posterior.
        kernels: Of the signal, by its length.
        outside: [m4/s4], variance of the geopotential outside the modes, of a profile and level.
    """

    modes: Array
    noise: Array
    kernels: tuple[Kernel, ...]
    outside: float


def garrett_munk(levels: Array, n2: Array, to_geopotential: Array) -> Array:
    """Return the covariance of the geopotential by internal waves as Garrett and Munk describe them, shape (Z, Z) [m4/s4].

    Args:
        levels: shape (Z,) [m].
        n2: shape (Z,) [1/s2].
        to_geopotential: shape (Z, Z), from anomalies of specific volume to geopotential without its depth mean.

    Source: Garrett and Munk (1975), modes after Wentzel, Kramers and Brillouin with weights 1/(j^2 + 9), displacements of 7.3 m at
    5.2e-3 1/s.
    """
    n = np.sqrt(n2)
    stretched = np.concatenate([[0.0], np.cumsum(0.5 * (n[1:] + n[:-1]) * np.diff(levels))])
    # the ends of the levels are neither surface nor bottom: half a level's spacing beyond them
    edge = 0.5 * (levels[1] - levels[0]) * n[[0, -1]]
    xi = (stretched + edge[0]) / (stretched[-1] + edge.sum())
    orders = np.arange(1, _WAVE_MODES + 1)
    weights = 1.0 / (orders**2 + 9.0)
    # sin^2 has the mean 1/2
    shapes = np.sin(np.pi * np.outer(xi, orders)) * np.sqrt(2.0 * weights / weights.sum())
    displacement = np.minimum(7.3 * np.sqrt(5.24e-3 / n), 40.0)
    volume = -n2 * displacement / (GRAVITY * RHO0)
    waves = to_geopotential @ (volume[:, None] * shapes)
    return np.asarray(waves @ waves.T)


def fit(geopotential: Array, along: Array, time: Array, waves: Array, regime: Regime) -> Statistics:
    """Return the statistics of a line, averaged over the posterior of their settings.

    Args:
        geopotential: shape (n, Z) [m2/s2], of the profiles.
        along: shape (n,) [m].
        time: shape (n,) [s].
        waves: shape (Z, Z) [m4/s4], covariance of internal waves as Garrett and Munk describe them.
        regime: Of the region.
    """
    n = along.size
    modes = _vertical_modes(geopotential, along, waves)
    usual = np.einsum("zk,zy,yk->k", modes, waves, modes)
    # of few levels a mode is constant over them, which no geopotential without its depth mean has
    modes, usual = (each[..., usual > _NO_WAVES * usual.max()] for each in (modes, usual))
    values = (geopotential - geopotential.mean(axis=0)) @ modes
    trend = np.stack([np.ones(n), along - along.mean()], axis=1)
    settings = list(_settings(along, time, regime))
    misfits = [
        _misfit(noise + ratio * kernel.covariance(along, time), trend, values)
        for noise, kernel, ratio, _ in settings
    ]
    # modes are orthonormal over the levels: their squares sum up over these
    speed = _SPEED * np.sqrt(usual / usual.sum() * geopotential.shape[1]) * abs(regime.coriolis)
    to_flow = [np.sqrt(ratio) / kernel.length / speed for _, kernel, ratio, _ in settings]
    weights = np.array([each[-1] for each in settings])
    variances = _variances(misfits, np.array(to_flow), weights, usual, n - 2)
    mean_noise = sum(
        own[:, None, None] * noise for own, (noise, *_) in zip(variances, settings, strict=True)
    )
    signal = dict[tuple[float, float], Array]()
    for own, (_, kernel, ratio, _) in zip(variances, settings, strict=True):
        scales = kernel.length, kernel.time
        signal[scales] = signal.get(scales, 0.0) + ratio * own
    kernels = tuple(Kernel(*scales, amplitude) for scales, amplitude in signal.items())
    inside = (geopotential - geopotential.mean(axis=0)) - values @ modes.T
    outside = float((inside**2).sum() / max(n - 2, 1) / geopotential.shape[1])
    return Statistics(modes, np.asarray(mean_noise), kernels, outside)


def _variances(
    misfits: Sequence[tuple[Array, float]],
    to_flow: Array,
    weights: Array,
    usual: Array,
    free: int,
) -> Array:
    """Return the mean variance of the waves in each mode times the probability of each setting, shape (s, k).

    A mode's variance has an inverse-gamma prior about a common level of the waves times ``usual``; how many counts it has, and the level,
    are what all modes together make likely: a few profiles do not tell of one mode what all of them tell.

    Args:
        misfits: Of each setting and mode, and the log determinants, as of ``_misfit``.
        to_flow: shape (s, k), takes the square root of a variance to the speed of the signal in units of what is usual.
        weights: shape (s,), log prior weights.
        usual: shape (k,), variance of the waves at level 1.
        free: Degrees of freedom of a mode's values.
    """
    misfit, log_det = (
        np.array([each for each, _ in misfits]),
        np.array([each for _, each in misfits]),
    )
    known, logs, found = (weights - 0.5 * log_det)[:, None], [], []
    for level, counts in product(_LEVELS.tolist(), _COUNTS):
        scale, half = counts * level * usual, 0.5 * (counts + free)
        variance = (scale + misfit) / (2.0 * half - 2.0)
        unusual = (np.log(to_flow) + 0.5 * np.log(variance)) / _SPEED_SPREAD
        log = known - half * np.log(scale + misfit) - 0.5 * unusual**2
        log = log + 0.5 * counts * np.log(scale) + gammaln(half) - gammaln(0.5 * counts)
        largest = log.max(axis=0)
        share = np.exp(log - largest)
        total = share.sum(axis=0)
        logs.append(float((largest + np.log(total)).sum()) - 0.5 * (np.log(level) / _SPREAD) ** 2)
        found.append(share / total * variance)
    probability = np.exp(np.array(logs) - max(logs))
    return np.tensordot(probability / probability.sum(), np.array(found), 1)


def rossby_radius(levels: Array, n2: Array, coriolis: float, bottom: float) -> float:
    """Return the first baroclinic Rossby radius [m], by the approximation of Wentzel, Kramers and Brillouin.

    The stratification is constant above the levels and falls off below them over 1300 m.

    Args:
        levels: shape (Z,) [m].
        n2: shape (Z,) [1/s2].
        coriolis: [1/s].
        bottom: Depth of the water [m].

    Source: Chelton et al. (1998), equation 2.2.
    """
    n, scale = np.sqrt(n2), 1300.0
    within = float(np.sum(0.5 * (n[1:] + n[:-1]) * np.diff(levels)))
    below = max(bottom - levels[-1], 0.0)
    total = n[0] * levels[0] + within + n[-1] * scale * (1.0 - np.exp(-below / scale))
    return float(total / (np.pi * abs(coriolis)))


def _vertical_modes(geopotential: Array, along: Array, waves: Array) -> Array:
    """Return the first modes of the geopotential with its slope left in, blended with internal waves, shape (Z, k).

    Modes of residuals alone span too few directions on a short line: all others would look free of noise.
    """
    n = along.size
    centred, span = geopotential - geopotential.mean(axis=0), along - along.mean()
    residual = centred - np.outer(span, span @ centred) / (span @ span)
    scatter = float((residual**2).sum()) / (n - 2)
    scaled = waves * min(1.0, scatter / float(np.trace(waves)))
    counts = _MODE_COUNTS / (n - 2)
    blended = (centred.T @ centred + counts * scaled) / (n - 2 + counts)
    vectors = np.linalg.eigh(blended)[1][:, ::-1]
    return np.asarray(vectors[:, :_MODES])


def _settings(
    along: Array, time: Array, regime: Regime
) -> Iterator[tuple[Array, Kernel, float, float]]:
    """Yield correlations of the noise, shape (n, n), kernel and size of the signal, and log prior weight of each setting."""
    apart = np.abs(time[:, None] - time)
    nothing = np.empty(0)
    for decay, tide in product(_DECAYS, _TIDES):
        waves = (1.0 - _WHITE) * np.exp(-apart * abs(regime.coriolis) / decay) + _WHITE * (
            apart == 0.0
        )
        tides = np.cos(2.0 * np.pi * apart / _TIDE_PERIOD) * np.exp(-apart / _TIDE_DECAY)
        noise = (1.0 - tide) * waves + tide * tides
        for radii, log_weight in _LENGTHS:
            length = radii * regime.rossby_radius
            lasting = float(np.clip(_TURNOVER * length / regime.speed, _SHORTEST, _LONGEST))
            for ratio in _RATIOS.tolist():
                yield noise, Kernel(length, lasting, nothing), ratio, log_weight


def _misfit(covariance: Array, trend: Array, values: Array) -> tuple[Array, float]:
    """Return the weighted squares of values beside a trend, shape (k,), and the log determinants of the restricted likelihood.

    Args:
        covariance: shape (n, n), but for the variance.
        trend: shape (n, 2), what is fitted beside it.
        values: shape (n, k).

    Source: Patterson and Thompson (1971).
    """
    n = values.shape[0]
    factor = cho_factor(covariance + 1e-10 * np.trace(covariance) / n * np.eye(n), lower=True)
    solved = cho_solve(factor, np.concatenate([trend, values], axis=1))
    of_trend, of_values = solved[:, :2], solved[:, 2:]
    normal = trend.T @ of_trend
    left = values.T @ of_trend
    misfit = np.einsum("nk,nk->k", values, of_values) - np.einsum(
        "ka,ab,kb->k", left, np.linalg.inv(normal), left
    )
    log_determinants = 2.0 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(normal)[1]
    return np.maximum(misfit, 0.0), float(log_determinants)
