"""Intervals by resampling: the slow twin."""

import math
import statistics

import numpy as np

from replay_kit.core.evidence import bootstrap_interval


def test_the_interval_is_that_of_cases_drawn_one_by_one():
    values = np.random.default_rng(1).lognormal(size=7)
    rng = np.random.default_rng(0)
    drawn = sorted(
        statistics.median(values[case] for case in rng.integers(7, size=7)) for _ in range(60)
    )

    def between(share):
        below, part = int(share * 59), math.fmod(share * 59, 1.0)
        return drawn[below] + part * (drawn[below + 1] - drawn[below])

    low, high = bootstrap_interval(
        lambda cases: np.median(values[cases], axis=1), 7, resamples=60, share=0.8
    )
    np.testing.assert_allclose((low, high), (between(0.1), between(0.9)), rtol=1e-12)
