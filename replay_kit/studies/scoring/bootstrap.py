"""Bootstrap intervals of medians."""

import numpy as np

from replay_kit.core.arrays import Array

_RESAMPLES = 2000


def bootstrap_median(values: Array, share: float = 0.9) -> tuple[float, float]:
    """Return the ends of the bootstrap interval of a median, percentile method, resampled with a fixed seed.

    Args:
        values: shape (n,).
        share: Of the resampled medians inside.
    """
    drawn = np.random.default_rng(0).integers(values.size, size=(_RESAMPLES, values.size))
    low, high = np.quantile(np.median(values[drawn], axis=1), [0.5 - share / 2.0, 0.5 + share / 2.0])
    return float(low), float(high)


def bootstrap_ratio(values: Array, others: Array, share: float = 0.9) -> tuple[float, float]:
    """Return the ends of the bootstrap interval of the ratio of two medians over the same cases, resampled together.

    Args:
        values: shape (n,), above the line.
        others: shape (n,), below it.
        share: Of the resampled ratios inside.
    """
    drawn = np.random.default_rng(0).integers(values.size, size=(_RESAMPLES, values.size))
    ratios = np.median(values[drawn], axis=1) / np.median(others[drawn], axis=1)
    low, high = np.quantile(ratios, [0.5 - share / 2.0, 0.5 + share / 2.0])
    return float(low), float(high)
