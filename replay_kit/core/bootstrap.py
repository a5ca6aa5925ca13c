"""Intervals of a statistic by the bootstrap: the cases are resampled with replacement, with a fixed seed."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


def bootstrap_interval(
    statistic: Callable[[NDArray[np.int64]], Array],
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
