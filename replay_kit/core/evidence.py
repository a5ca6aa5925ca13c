"""Log evidence (marginal likelihood) of forecasts, their comparison, bootstrap intervals, and scores of Gaussian predictions.

Results are read with what is here, so that scipy is imported where a score is computed.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array, Times


def bootstrap_interval(
    statistic: Callable[[Times], Array],
    cases: int,
    resamples: int = 2000,
    share: float = 0.9,
) -> tuple[float, float]:
    """Return the ends of the central interval of a statistic of resampled cases, by the percentile method.

    Source: Efron and Tibshirani (1993), An Introduction to the Bootstrap, section 13.3.

    Args:
        statistic: Takes the positions of the drawn cases, shape (resamples, cases), and returns its value of each row, shape (resamples,).
        cases: Number of cases, at least 1.
        resamples: Number of times that as many cases are drawn.
        share: Of the resampled values inside the interval.
    """
    drawn = np.random.default_rng(0).integers(cases, size=(resamples, cases))
    low, high = np.quantile(statistic(drawn), [0.5 - 0.5 * share, 0.5 + 0.5 * share])
    return float(low), float(high)


_HOUR_NS = 3600 * 10**9
_LOG_2_PI = math.log(2.0 * math.pi)
# Resamples of the interval, and the least number of dives of which one is made.
_RESAMPLES, _LEAST = 4000, 3


@dataclass(frozen=True, slots=True)
class BlockEvidence:
    """The log evidence of the measurements of one dive, or of one hour of a log without dives.

    Attributes:
        log_density: Sum of the logarithms of the measurements' densities, each given those before; without the constant of 2 pi.
        values: Number of values measured: components of bins.
        measurements: Number of profiles and mean currents.
    """

    log_density: float = 0.0
    values: int = 0
    measurements: int = 0

    def __add__(self, other: "BlockEvidence") -> "BlockEvidence":
        """Return the sums of both."""
        return BlockEvidence(
            self.log_density + other.log_density,
            self.values + other.values,
            self.measurements + other.measurements,
        )

    @property
    def log_evidence(self) -> float:
        """Logarithm of the joint density [(m/s)^-values]."""
        return self.log_density - 0.5 * self.values * _LOG_2_PI


@dataclass(frozen=True, slots=True)
class Evidence:
    """The log evidence of a log under one forecast.

    Attributes:
        blocks: By number of the dive; before the first dive and without dives by hour, as minus the hours since 1970.
    """

    blocks: Mapping[int, BlockEvidence]

    @property
    def total(self) -> BlockEvidence:
        """Of the whole log."""
        return sum(self.blocks.values(), BlockEvidence())

    @property
    def by_dive(self) -> dict[int, BlockEvidence]:
        """Of each dive, in order."""
        return {dive: self.blocks[dive] for dive in sorted(self.blocks) if dive > 0}


def block_of(dive: int, time_ns: int) -> int:
    """Return the key of a measurement's block."""
    return dive if dive > 0 else -(time_ns // _HOUR_NS)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two forecasts compared by the same measurements.

    Attributes:
        blocks: Number of dives, or of hours, compared.
        skipped: Number of those that were not, because the two forecasts do not cover the same measurements of them.
        gain: Log evidence of the first less that of the second, in all.
        mean: The same a block.
        interval: Ends of the 90 % interval of the mean, from resampling the blocks; NaN with fewer than three.
    """

    blocks: int
    skipped: int
    gain: float
    mean: float
    interval: tuple[float, float]

    @property
    def verdict(self) -> str:
        """Which explained the log better: ``first``, ``second``, or ``undecided`` where the interval holds zero or there is none."""
        low, high = self.interval
        return "first" if low > 0.0 else "second" if high < 0.0 else "undecided"


def compare(one: Evidence, other: Evidence) -> Comparison:
    """Return the comparison of two forecasts, block by block; a block counts where both have as many values of it.

    The interval is the percentile bootstrap's of the mean over blocks (Efron and Tibshirani 1993, chapter 13): measurements of one dive
    share the errors of the estimate, and one dive that a forecast misses altogether must not decide alone.
    """
    keys = sorted(one.blocks.keys() | other.blocks.keys())
    nothing = BlockEvidence()
    pairs = [(one.blocks.get(key, nothing), other.blocks.get(key, nothing)) for key in keys]
    gains = [
        first.log_density - second.log_density
        for first, second in pairs
        if first.values == second.values > 0
    ]
    gain = math.fsum(gains)
    mean = gain / len(gains) if gains else math.nan
    return Comparison(len(gains), len(keys) - len(gains), gain, mean, _interval(gains))


def _interval(gains: Sequence[float]) -> tuple[float, float]:
    if len(gains) < _LEAST:
        return math.nan, math.nan
    return bootstrap_interval(
        lambda drawn: np.array(gains)[drawn].mean(axis=1), len(gains), _RESAMPLES
    )


def coverage(error: Array, std: Array, share: float, scatter: Array | None = None) -> float:
    """Return the share of errors inside the central interval that has a probability of ``share``.

    Args:
        error: Predicted mean minus the outcome, any shape.
        std: Predicted standard deviation, broadcast against it.
        share: The probability.
        scatter: Standard deviation of a Gaussian noise of the errors, whose mean is taken; None for none.
    """
    from scipy.special import ndtr, ndtri

    half = ndtri(0.5 + 0.5 * share) * std
    if scatter is None:
        return float(np.mean(np.abs(error) <= half))
    blur = np.maximum(scatter, 1e-12)
    return float(np.mean(ndtr((half - error) / blur) - ndtr((-half - error) / blur)))


def crps_gaussian(error: Array, std: Array, scatter: Array | float = 0.0) -> Array:
    """Return the continuous ranked probability score of Gaussian predictions (Gneiting et al. 2005, Mon. Wea. Rev. 133, eq. 5).

    It is the mean distance to the prediction less half of the mean distance of two predictions, and the mean of the first over a noise
    of the errors is that of a wider prediction.

    Args:
        error: Predicted mean minus the outcome, any shape.
        std: Predicted standard deviation, broadcast against it; where it is 0 the score is the absolute error.
        scatter: Standard deviation of a Gaussian noise of the errors, whose mean is taken.
    """
    from scipy.special import ndtr

    error, std, total = np.broadcast_arrays(error, std, np.hypot(std, scatter))
    z = np.divide(error, total, out=np.zeros(error.shape), where=total > 0.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = total * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density) - std / np.sqrt(np.pi)
    return np.where(total > 0.0, spread, np.abs(error))
