"""Profiles reduced to the few numbers that the checks remember, those of a block of messages together, and an ensemble to its speeds.

Profiles that lack the same bins are reduced in one array; what is found of one does not depend on the others.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import IN_MEMORY, Array, one_by_one
from replay_kit.core.observation import Observation, Reason
from replay_kit.measurements.consistency.sources import NearMean

# m/s; no region's currents have an RMS speed outside
_LEAST_RMS, _MOST_RMS, _PERCENTILE = 0.004, 1.5, 99.9
#: m/s; no model resolves much faster currents.
MOST_SPEED = 4.0


def odd_ensemble_speeds(velocity: Array) -> str:
    """Return how the speeds of an ensemble, shape (E, 2, ...) [m/s], cannot be those of currents; empty when they can."""
    # of an ensemble larger than memory some members tell as much
    squared = np.square(velocity[:: max(1, velocity.nbytes // IN_MEMORY)]).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    if not squared.any():
        # without a wet point, or at rest: another matter
        return ""
    rms, fastest = (
        math.sqrt(float(squared.mean())),
        math.sqrt(float(np.percentile(squared, _PERCENTILE))),
    )
    if _LEAST_RMS <= rms <= _MOST_RMS and fastest <= MOST_SPEED:
        return ""
    return f"RMS speed {rms:.3g} m/s, {_PERCENTILE:g} % below {fastest:.3g} m/s"


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleSpeeds:
    """How fast the currents of an ensemble are.

    Attributes:
        levels: shape (Z,) [m].
        mean_square: shape (Z,), mean squared speed at the levels [m^2/s^2].
    """

    levels: Array
    mean_square: Array


def ensemble_speeds(levels: Array, velocity: Array) -> EnsembleSpeeds:
    """Return the speeds of an ensemble, shape (E, 2, Z, J, I) [m/s], NaN where dry; a dry level has those of the first one."""
    total, count = np.zeros(levels.size), np.zeros(levels.size, dtype=np.int64)
    for member in one_by_one(velocity):
        squared = np.square(member).sum(axis=0)
        wet = np.isfinite(squared)
        count += wet.sum(axis=(1, 2))
        total += np.where(wet, squared, 0.0).sum(axis=(1, 2))
    mean = total / np.maximum(count, 1)
    return EnsembleSpeeds(levels, np.where(count > 0, mean, mean[0]))


class PingSpeed(NamedTuple):
    """How fast a ping is.

    Attributes:
        measured: The upper median of its bins' squared speeds [m^2/s^2].
        typical: Mean squared speed of the ensemble at their depths [m^2/s^2].
        error_std: Mean error of a component of its bins [m/s].
    """

    measured: float
    typical: float
    error_std: float


# m from the first bin; what is farther is less like the water at the vehicle
_NEAR = 100.0
#: Bins bad only in a way that a wrong unit or axis could have made them.
REPAIRABLE = Reason.GROSS_RANGE | Reason.HIGH_SPEED | Reason.OUTLIER
_NOT_REPAIRABLE = ~np.int32(REPAIRABLE)
_AT_SURFACE = np.int32(Reason.AT_SURFACE)
# Bins from which noise is told; median size of a normal variable of unit variance.
_LEAST_BINS, _MEDIAN = 5, 0.6745


@dataclass(frozen=True, slots=True)
class PingSummary:
    """What the checks need of a ping.

    Attributes:
        near: Its bins near the instrument; None without a bin there.
        is_above: Whether most of its bins are above the surface; None without a bin that tells.
        speed: Its speed, and the ensemble's at its depths; None where it is relative, or nothing is compared.
        noise: Logarithm of the scatter of neighbouring bins over their stated errors; None where either is not known.
    """

    near: NearMean | None = None
    is_above: bool | None = None
    speed: PingSpeed | None = None
    noise: float | None = None


# Pings in the order of their times, and what the checks need of each.
Pings = Sequence[Observation]
Summaries = Sequence[PingSummary]


def summaries(pings: Sequence[Observation], ensemble: EnsembleSpeeds | None) -> list[PingSummary]:
    """Return what the checks need of pings.

    Args:
        pings: The pings.
        ensemble: Speeds of the ensemble's currents; None compares none.
    """
    near: dict[int, NearMean] = {}
    above: dict[int, bool] = {}
    speeds: dict[int, PingSpeed] = {}
    noise: dict[int, float] = {}
    sizes: dict[int, list[int]] = {}
    for i, ping in enumerate(pings):
        sizes.setdefault(ping.depth.size, []).append(i)
    for at in sizes.values():
        some = [pings[i] for i in at]
        depth, velocity = (
            np.array([ping.depth for ping in some]),
            np.array([ping.velocity for ping in some]),
        )
        reasons = np.array([ping.reasons for ping in some])
        repairable = (reasons & _NOT_REPAIRABLE) == 0
        for rows, bins in _alike(repairable & np.isfinite(velocity[..., 0] + velocity[..., 1])):
            means = _near_means(depth[np.ix_(rows, bins)], velocity[np.ix_(rows, bins)])
            near |= {at[i]: _near_mean(some[i], *mean) for i, mean in zip(rows, means, strict=True)}
        measured = np.isfinite(velocity[..., 0]) & ((reasons & _AT_SURFACE) == 0)
        counts, over = (
            np.count_nonzero(measured, axis=1),
            np.count_nonzero(measured & (depth < 0.0), axis=1),
        )
        above |= {
            at[i]: 2 * high > count
            for i, (count, high) in enumerate(zip(counts.tolist(), over.tolist(), strict=True))
            if count
        }
        error_std = np.array([ping.error_std for ping in some])
        noise |= _noises(at, some, velocity, error_std)
        if ensemble is None:
            continue
        absolute = np.array([math.isfinite(ping.common_std) for ping in some])
        squared = np.square(velocity).sum(axis=2)
        for rows, bins in _alike(repairable & np.isfinite(squared + error_std) & absolute[:, None]):
            cut = np.ix_(rows, bins)
            speeds |= zip(
                (at[i] for i in rows),
                _speeds(depth[cut], squared[cut], error_std[cut], ensemble),
                strict=True,
            )
    return [
        PingSummary(near.get(i), above.get(i), speeds.get(i), noise.get(i))
        for i in range(len(pings))
    ]


def _noises(
    at: Sequence[int], pings: Sequence[Observation], velocity: Array, error_std: Array
) -> Iterator[tuple[int, float]]:
    """Yield numbers of pings of one size and the logarithm of their noise, by second differences, over their stated errors.

    Bins whose errors are correlated say nothing, nor do fewer than five.
    """
    if velocity.shape[1] < _LEAST_BINS:
        return
    second = np.diff(velocity, 2, axis=1)
    white = np.array([not ping.correlation_depth > 0.0 for ping in pings])
    for rows, bins in _alike(np.isfinite(second[..., 0]) & white[:, None]):
        sizes = np.abs(second[np.ix_(rows, bins)]).reshape(len(rows), -1)
        # of white noise the second differences have six times its variance; outliers, of which there may be many, leave the median alone
        middle = sizes.shape[1] // 2
        size = np.partition(sizes, middle, axis=1)[:, middle] / (_MEDIAN * math.sqrt(6.0))
        stated = error_std[:, 1:-1][np.ix_(rows, bins)].mean(axis=1)
        for i, noise, error in zip(rows, size.tolist(), stated.tolist(), strict=True):
            if noise > 0.0 and error > 0.0:
                yield at[i], math.log(noise / error)


def _alike(good: NDArray[np.bool_]) -> Iterator[tuple[list[int], list[int]]]:
    """Yield the rows of profiles with the same good bins, and these; profiles without any are left out."""
    if good.all():
        yield list(range(len(good))), list(range(good.shape[1]))
        return
    patterns: dict[bytes, list[int]] = {}
    for i, row in enumerate(good):
        patterns.setdefault(row.tobytes(), []).append(i)
    for rows in patterns.values():
        if (bins := np.flatnonzero(good[rows[0]]).tolist()) != []:
            yield rows, bins


def _near_means(depth: Array, velocity: Array) -> Iterator[tuple[float, list[float]]]:
    """Yield depth of the first bin and mean velocity of those near it, of profiles of shapes (s, k) and (s, k, 2)."""
    near = np.abs(depth - depth[:, :1]) <= _NEAR
    total = np.add.reduce(np.where(near[..., None], velocity, 0.0), axis=1)
    mean = total / np.count_nonzero(near, axis=1)[:, None]
    yield from zip(depth[:, 0].tolist(), mean.tolist(), strict=True)


def _near_mean(ping: Observation, depth: float, mean: list[float]) -> NearMean:
    east, north = mean
    relative = not math.isfinite(ping.common_std)
    return NearMean(
        ping.time_ns,
        ping.longitude,
        ping.latitude,
        depth,
        (east, north),
        ping.platform_velocity,
        relative,
    )


def _speeds(
    depth: Array, squared: Array, error_std: Array, ensemble: EnsembleSpeeds
) -> Iterator[PingSpeed]:
    """Yield the speeds of profiles of shape (s, k), and those of the ensemble at their depths."""
    typical = np.interp(depth, ensemble.levels, ensemble.mean_square).mean(axis=1)
    # the upper median, without the cost of NumPy's own
    middle = depth.shape[1] // 2
    measured = np.partition(squared, middle, axis=1)[:, middle]
    error = error_std.mean(axis=1)
    for one in zip(measured.tolist(), typical.tolist(), error.tolist(), strict=True):
        yield PingSpeed(*one)
