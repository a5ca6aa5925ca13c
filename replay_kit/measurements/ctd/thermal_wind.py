"""Geostrophic current across a line of profiles relative to its depth mean, with its error (thermal wind).

The slope of the geopotential along the line, by generalised least squares, gives the current across it. The error includes internal waves
and tides, curvature and change of the signal, ageostrophic and unresolved currents; it is large for a short line.

Waves and signal are fitted by likelihood. Each vertical mode k has the covariance s2 (R + q K) between profiles: R of internal waves and
the semidiurnal tide in time, K of the signal in space and time, averaged over their posterior on a grid of settings. The waves of all
modes have a common level relative to Garrett and Munk's, with a spread between modes that is estimated too.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import cho_factor, cho_solve
from scipy.special import gammaln, logsumexp, softmax

from replay_kit.core.arrays import Array, Indices
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0, Section

# Grid of settings: decay of the waves in units of 1/f and share of the tide; length of the signal in Rossby radii, with its log prior
# weight; signal over noise.
_DECAYS, _TIDES = (0.15, 0.4, 1.0), (0.0, 0.3, 0.6, 0.85)
_LENGTHS, _WEIGHTS = np.array([1.0, 1.6, 2.5]), np.array([-0.5, 0.0, -0.5])
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
# Depth of the water, which is not known [m].
_BOTTOM = 4000.0
# Share of the largest variance of waves below which a mode has none but by rounding.
_NO_WAVES = 1e-9


def signal_correlation(away: Array, later: Array, length: float, lasting: float) -> Array:
    """Return the correlation of the signal for separations in space and time [m, s], with length [m] and time [s] scales."""
    return np.exp(-0.5 * (away / length) ** 2 - 0.5 * (later / lasting) ** 2)


class Statistics(NamedTuple):
    """Covariances of the geopotential on a line.

    Attributes:
        modes: shape (Z, k), orthonormal vertical modes.
        noise: shape (k, n, n) [m4/s4], noise covariance of each mode between profiles, averaged over the posterior.
        lengths: shape (l,) [m], length scales of the signal, see ``signal_correlation``.
        lasting: shape (l,) [s], its time scales.
        signal: shape (l, k) [m4/s4], its variance in each mode times the posterior probability of the length.
        outside: [m4/s4], variance outside the modes of a profile at a level.
    """

    modes: Array
    noise: Array
    lengths: Array
    lasting: Array
    signal: Array
    outside: float


def garrett_munk(levels: Array, n2: Array, to_geopotential: Array) -> Array:
    """Return the covariance of the geopotential by Garrett and Munk's internal waves, shape (Z, Z) [m4/s4].

    Args:
        levels: shape (Z,) [m].
        n2: shape (Z,) [1/s2], squared buoyancy frequency.
        to_geopotential: shape (Z, Z), from anomalies of specific volume to geopotential without its depth mean.

    Source: Garrett and Munk (1975), modes after Wentzel, Kramers and Brillouin with weights 1/(j^2 + 9), displacements of 7.3 m at 5.2e-3
    1/s.
    """
    n = np.sqrt(n2)
    stretched = cumulative_trapezoid(n, levels, initial=0.0)
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


def fit(
    section: Section, geopotential: Array, waves: Array, radius: float, speed: float
) -> Statistics:
    """Return the statistics of a line, averaged over the posterior of the settings.

    Args:
        section: Line of profiles.
        geopotential: shape (n, Z) [m2/s2], of the profiles.
        waves: shape (Z, Z) [m4/s4], covariance of Garrett and Munk's internal waves.
        radius: First baroclinic Rossby radius [m].
        speed: RMS speed of the region's currents over the levels [m/s].
    """
    along, time, f = section.along, section.time, abs(section.coriolis)
    free, z, trend = along.size - 2, geopotential.shape[1], trend_of(along)
    centred = geopotential - geopotential.mean(axis=0)
    # modes of residuals alone span too few directions on a short line, and all others would look free of noise: the slope is left in,
    # and internal waves are blended in
    residual = geopotential - trend @ np.linalg.lstsq(trend, geopotential)[0]
    scatter = float((residual**2).sum()) / free
    counts = _MODE_COUNTS * min(1.0, scatter / float(np.trace(waves))) / free
    modes = np.linalg.eigh(centred.T @ centred + counts * waves)[1][:, : -_MODES - 1 : -1]
    usual = np.einsum("zk,zy,yk->k", modes, waves, modes)
    # of few levels a mode is constant over them, which no geopotential without its depth mean has
    modes, usual = (each[..., usual > _NO_WAVES * usual.max()] for each in (modes, usual))
    values = centred @ modes
    noises, lengths = _noises(time, f), _LENGTHS * radius
    lasting = np.clip(_TURNOVER * lengths / speed, _SHORTEST, _LONGEST)
    away, later = along[:, None] - along, time[:, None] - time
    signals = [
        signal_correlation(away, later, *scales) for scales in zip(lengths, lasting, strict=True)
    ]
    misfits = [
        _misfit(noise + ratio * signal, trend, values)
        for noise, signal, ratio in product(noises, signals, _RATIOS)
    ]
    # modes are orthonormal over the levels: their squares sum up over these
    usual_speed = _SPEED * np.sqrt(usual / usual.sum() * z) * f
    to_flow = np.sqrt(_RATIOS)[:, None] / lengths[:, None, None] / usual_speed
    grid = len(noises), lengths.size, _RATIOS.size, -1
    misfit, log_det = (np.array(part).reshape(grid) for part in zip(*misfits, strict=True))
    known = _WEIGHTS[:, None, None] - 0.5 * log_det
    variances = _variances(misfit, known, to_flow, usual, free)
    return Statistics(
        modes,
        np.einsum("alrk,aij->kij", variances, noises),
        lengths,
        lasting,
        np.einsum("alrk,r->lk", variances, _RATIOS),
        float(((centred - values @ modes.T) ** 2).sum() / max(free, 1) / z),
    )


def _variances(misfit: Array, known: Array, to_flow: Array, usual: Array, free: int) -> Array:
    """Return the mean wave variance of each mode times the probability of each setting, shape (..., k).

    A mode's variance has an inverse-gamma prior about a common wave level times ``usual``; its degrees of freedom and the level are
    estimated from all modes, as few profiles do not determine a single mode.

    Args:
        misfit: shape (..., k), see ``_misfit``, by setting and mode.
        known: shape (..., 1), log prior weight of each setting less half the log determinant.
        to_flow: shape (..., k), factor from the root of a variance to the signal's speed relative to the usual one.
        usual: shape (k,), variance of the waves at level 1.
        free: Degrees of freedom of a mode's values.
    """
    settings, logs, found = (0, 1, 2), [], []
    for level, counts in product(_LEVELS, _COUNTS):
        scale, half = counts * level * usual, 0.5 * (counts + free)
        variance = (scale + misfit) / (2.0 * half - 2.0)
        unusual = (np.log(to_flow) + 0.5 * np.log(variance)) / _SPEED_SPREAD
        log = known - half * np.log(scale + misfit) - 0.5 * unusual**2
        log += 0.5 * counts * np.log(scale) + gammaln(half) - gammaln(0.5 * counts)
        total = logsumexp(log, axis=settings)
        logs.append(total.sum() - 0.5 * (np.log(level) / _SPREAD) ** 2)
        found.append(np.exp(log - total) * variance)
    return np.tensordot(softmax(logs), np.array(found), 1)


def rossby_radius(levels: Array, n2: Array, coriolis: float) -> float:
    """Return the first baroclinic Rossby radius [m] in the WKB approximation.

    The stratification is constant above the levels and decays below them over 1300 m.

    Args:
        levels: shape (Z,) [m].
        n2: shape (Z,) [1/s2], squared buoyancy frequency.
        coriolis: Coriolis parameter [1/s].

    Source: Chelton et al. (1998), equation 2.2.
    """
    n, scale = np.sqrt(n2), 1300.0
    below = scale * (1.0 - np.exp(min(levels[-1] - _BOTTOM, 0.0) / scale))
    total = n[0] * levels[0] + np.trapezoid(n, levels) + n[-1] * below
    return float(total / (np.pi * abs(coriolis)))


def trend_of(along: Array) -> Array:
    """Return the basis of a linear trend along the line, shape (n, 2)."""
    return np.stack([np.ones(along.size), along - along.mean()], axis=1)


def _noises(time: Array, coriolis: float) -> Array:
    """Return the correlations of the noise between profiles for each decay and tide, shape (d, n, n)."""
    apart = np.abs(time[:, None] - time)
    decay, tide = np.array(list(product(_DECAYS, _TIDES))).T[..., None, None]
    waves = (1.0 - _WHITE) * np.exp(-apart * coriolis / decay) + _WHITE * (apart == 0.0)
    tides = np.cos(2.0 * np.pi * apart / _TIDE_PERIOD) * np.exp(-apart / _TIDE_DECAY)
    return np.asarray((1.0 - tide) * waves + tide * tides)


def _misfit(covariance: Array, trend: Array, values: Array) -> tuple[Array, float]:
    """Return the weighted squares of detrended values, shape (k,), and the log determinant of the restricted likelihood.

    Args:
        covariance: shape (n, n), covariance up to a variance factor.
        trend: shape (n, 2), basis of the trend.
        values: shape (n, k).

    Source: Patterson and Thompson (1971).
    """
    n = values.shape[0]
    factor = cho_factor(covariance + 1e-10 * np.trace(covariance) / n * np.eye(n), lower=True)
    solved = cho_solve(factor, np.concatenate([trend, values], axis=1))
    of_trend, of_values = solved[:, :2], solved[:, 2:]
    normal, left = trend.T @ of_trend, values.T @ of_trend
    misfit = (values * of_values).sum(axis=0) - (left @ np.linalg.inv(normal) * left).sum(axis=1)
    log_determinants = 2.0 * np.log(np.diag(factor[0])).sum() + np.linalg.slogdet(normal)[1]
    return np.maximum(misfit, 0.0), float(log_determinants)


#: Degrees from the equator, within which there is no geostrophic balance to use.
EQUATOR = 5.0
# Least share of the shear that is not geostrophic, and the error that always stays [m/s].
_AGEOSTROPHIC, _FLOOR = 0.05, 0.003
# Drift of a conductivity cell over a window, as salinity; and haline contraction of sea water.
_SALINITY_DRIFT, _HALINE_CONTRACTION = 0.002, 7.6e-4
# Speed of the signal in units of the region's, which counts as one further line; and lengths of a line that count as one.
_REGIONAL, _LINE = 0.25, 2.5


class GeostrophicShear(NamedTuple):
    """Current across a line relative to its mean over the levels, at one position and time.

    Attributes:
        levels: shape (Z,) [m], positive down.
        velocity: shape (Z,) [m/s], to the left of the line, minus its mean over the levels.
        covariance: shape (Z, Z) [m2/s2], error covariance.
        along: Position of the current on the line [m].
        direction: Direction of positive velocity, counter-clockwise from east [rad].
    """

    levels: Array
    velocity: Array
    covariance: Array
    along: float
    direction: float

    @property
    def standard_error(self) -> Array:
        """Standard error of the velocity, shape (Z,) [m/s]."""
        return np.sqrt(np.diag(self.covariance))


def radius_of(section: Section) -> float:
    """Return the first baroclinic Rossby radius of a line's region [m]."""
    return rossby_radius(section.levels, section.n2, section.coriolis)


def geopotential_matrix(levels: Array) -> Array:
    """Return the matrix from specific volume anomalies to geopotential without its depth mean, shape (Z, Z) [m2/s2 per m3/kg].

    Row z integrates from level z to the last one by the trapezoidal rule, which also gives the depth mean.
    """
    above = RHO0 * GRAVITY * cumulative_trapezoid(np.eye(levels.size), levels, initial=0.0).T
    integral = above[-1] - above
    return np.asarray(integral - depth_weights(levels) @ integral)


def depth_weights(levels: Array) -> Array:
    """Return the weights of the mean over levels by the trapezoidal rule, shape (Z,), which sum to 1."""
    return np.asarray(np.trapezoid(np.eye(levels.size), levels) / np.ptp(levels))


def slope_weights(along: Array, covariance: Array) -> Array:
    """Return the weights of the generalised least-squares slope, shape (n,) [1/m], for an error covariance, shape (n, n)."""
    trend = trend_of(along)
    solved = np.linalg.solve(covariance, trend)
    return np.asarray(np.linalg.solve(trend.T @ solved, solved.T)[1])


def place_of(along: Array, weights: Array) -> float:
    """Return the effective position of a slope on the line: the centre of the kernel of its weights [m]."""
    order = np.argsort(along, kind="stable")
    lengths, middles = np.diff(along[order]), 0.5 * (along[order][1:] + along[order][:-1])
    kernel = -np.cumsum(weights[order])[:-1] * lengths
    return float((kernel * middles).sum() / kernel.sum())


def shear_of(section: Section, speed: float, part: Indices) -> GeostrophicShear:
    """Return the shear of some profiles of a line at the time of the last one.

    Args:
        section: Line that provides the statistics.
        speed: RMS speed of the region's currents over the levels [m/s], for example of an ensemble.
        part: Indices of the profiles.
    """
    levels, f, radius = section.levels, section.coriolis, radius_of(section)
    to_geopotential = geopotential_matrix(levels)
    geopotential = section.anomaly @ to_geopotential.T
    waves = garrett_munk(levels, section.n2, to_geopotential)
    fitted, along = fit(section, geopotential, waves, radius, speed), section.along[part]
    noise = fitted.noise[:, part[:, None], part]
    weights = slope_weights(along, noise.sum(axis=0))
    at, velocity = place_of(along, weights), weights @ geopotential[part] / f
    found = float(np.sqrt(np.mean(velocity**2)))
    # one line knows its own slope alone: the size of the signal is blended from the shear found on it and the region's speed
    lines = max(0.5, np.ptp(section.along) / (_LINE * fitted.lengths.mean()))
    size = (lines * found**2 + (_REGIONAL * speed) ** 2) / (lines + 1.0)
    variance = noise @ weights @ weights + size * _curvature(section, fitted, part, weights, at)
    modes = fitted.modes / f
    beside = max(_AGEOSTROPHIC, float(np.hypot(found, speed)) / (abs(f) * 1.6 * radius)) * velocity
    # what a drift of the salinity by its standard error changes of the geopotential
    drift = _HALINE_CONTRACTION * _SALINITY_DRIFT / (RHO0 * float(np.ptp(along)) * f)
    drifted = to_geopotential.sum(axis=1) * drift
    unresolved = fitted.outside * float(weights @ weights) / f**2 + _FLOOR**2
    covariance = (
        modes * variance @ modes.T
        + np.outer(beside, beside)
        + np.outer(drifted, drifted)
        + unresolved * np.eye(levels.size)
    )
    return GeostrophicShear(levels, velocity, covariance, at, section.direction + 0.5 * np.pi)


def _curvature(
    section: Section, fitted: Statistics, part: Indices, weights: Array, at: float
) -> Array:
    """Return the variance by mode of the profiles' slope minus that at a position and the last time, shape (k,) [1/s4].

    In units of the mean square of the signal's shear [m2/s2].
    """
    away, later = section.along[part] - at, section.time[part] - section.time[part].max()
    seen = []
    for length, lasting in zip(fitted.lengths, fitted.lasting, strict=True):
        pairs = signal_correlation(away[:, None] - away, later[:, None] - later, length, lasting)
        both = weights @ (away / length**2 * signal_correlation(away, later, length, lasting))
        seen.append(weights @ pairs @ weights - 2.0 * both + 1.0 / length**2)
    # modes are orthonormal over the levels: of a level it is the mean
    mean_square = fitted.signal.sum(axis=1) @ fitted.lengths**-2.0 / section.levels.size
    return np.asarray(seen @ fitted.signal * section.coriolis**2 / mean_square)
