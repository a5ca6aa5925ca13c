"""Log evidence (marginal likelihood) of forecasts, their comparison, bootstrap intervals, and scores of Gaussian predictions.

scipy is imported only where a score is computed, so that results can be read without it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from operator import add

import numpy as np

from replay_kit.core.arrays import Array, Times


def bootstrap_interval(
    statistic: Callable[[Times], Array], cases: int, resamples: int = 2000, share: float = 0.9
) -> tuple[float, float]:
    """Return the ends of the central interval of a statistic of resampled cases, by the percentile method.

    Source: Efron and Tibshirani (1993), An Introduction to the Bootstrap, section 13.3.

    Args:
        statistic: Function of the indices of the drawn cases, shape (resamples, cases), that returns a value per row, shape (resamples,).
        cases: Number of cases, at least 1.
        resamples: Number of resamples.
        share: Fraction of the resampled values inside the interval.
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
    """Log evidence of one dive, or of one hour of a log without dives.

    Attributes:
        log_density: Sum of the log densities of the measurements, each given the earlier ones, without the constant of 2 pi.
        values: Number of measured components of bins.
        measurements: Number of profiles and mean currents.
    """

    log_density: float = 0.0
    values: int = 0
    measurements: int = 0

    def __add__(self, other: "BlockEvidence") -> "BlockEvidence":
        """Return the sums of two blocks."""
        return BlockEvidence(*map(add, astuple(self), astuple(other)))

    @property
    def log_evidence(self) -> float:
        """Logarithm of the joint density [(m/s)^-values]."""
        return self.log_density - 0.5 * self.values * _LOG_2_PI


@dataclass(frozen=True, slots=True)
class Evidence:
    """Log evidence of a forecast by the measurements of a log.

    Attributes:
        blocks: Evidence by dive number; before the first dive and without dives by hour, as minus the hours since 1970.
    """

    blocks: Mapping[int, BlockEvidence]

    @property
    def total(self) -> BlockEvidence:
        """Log evidence of the whole log."""
        return sum(self.blocks.values(), BlockEvidence())

    @property
    def by_dive(self) -> dict[int, BlockEvidence]:
        """Log evidence by dive, in order."""
        return {dive: self.blocks[dive] for dive in sorted(self.blocks) if dive > 0}


def block_of(dive: int, time_ns: int) -> int:
    """Return the key of the block of a measurement."""
    return dive if dive > 0 else -(time_ns // _HOUR_NS)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of two forecasts by the same measurements.

    Attributes:
        blocks: Number of dives or hours compared.
        skipped: Number of dives or hours in which the two forecasts do not cover the same measurements.
        gain: Log evidence of the first minus that of the second.
        mean: Mean of this difference per block.
        interval: Ends of the 90 % bootstrap interval of the mean; NaN with fewer than three blocks.
    """

    blocks: int
    skipped: int
    gain: float
    mean: float
    interval: tuple[float, float]

    @property
    def verdict(self) -> str:
        """Better forecast: ``first``, ``second``, or ``undecided`` if the interval contains zero or is NaN."""
        low, high = self.interval
        return "first" if low > 0.0 else "second" if high < 0.0 else "undecided"


def compare(one: Evidence, other: Evidence) -> Comparison:
    """Return the comparison of two forecasts over the blocks in which both have equally many values.

    The interval is the percentile bootstrap's of the mean over blocks (Efron and Tibshirani 1993, chapter 13): measurements of one dive
    share the errors of the estimate, and one dive must not decide alone.
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


def crps_gaussian(error: Array, std: Array, scatter: Array | float = 0.0) -> Array:
    """Return the continuous ranked probability score of Gaussian predictions (Gneiting et al. 2005, Mon. Wea. Rev. 133, eq. 5).

    The score is the mean distance to the prediction less half of the mean distance between two predictions. Noise widens the first.

    Args:
        error: Predicted mean minus the outcome, any shape.
        std: Predicted standard deviation, broadcast against it; where it is 0 the score is the absolute error.
        scatter: Standard deviation of Gaussian noise in the errors, over which the score is averaged.
    """
    from scipy.special import ndtr

    error, std, total = np.broadcast_arrays(error, std, np.hypot(std, scatter))
    z = np.divide(error, total, out=np.zeros(error.shape), where=total > 0.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = total * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density) - std / np.sqrt(np.pi)
    return np.where(total > 0.0, spread, np.abs(error))
