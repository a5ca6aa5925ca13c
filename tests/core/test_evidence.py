"""The log evidence: sums over blocks, and which of two forecasts explained a log better."""

import math
import statistics

import numpy as np
import pytest
from scipy.stats import norm

from replay_kit.core.observation.evidence import (
    BlockEvidence,
    Evidence,
    block_of,
    bootstrap_interval,
    compare,
)


def evidence(densities, values=4):
    return Evidence({k: BlockEvidence(each, values, 1) for k, each in enumerate(densities, 1)})


def test_the_evidence_is_the_density_of_the_values_in_blocks_of_dives_or_hours():
    values, std = np.array([0.1, -0.2, 0.3]), 0.2
    whitened = -0.5 * np.sum((values / std) ** 2) - 3.0 * math.log(std)
    block = BlockEvidence(whitened, 3, 1)
    assert block.log_evidence == pytest.approx(norm(0.0, std).logpdf(values).sum())
    both = Evidence({3: block, -5: block, 1: block})
    assert both.total == BlockEvidence(3.0 * whitened, 9, 3)
    assert list(both.by_dive) == [1, 3]
    hour = 3600 * 10**9
    assert block_of(3, 5 * hour) == 3
    assert block_of(0, 5 * hour) == block_of(0, 6 * hour - 1) == -5


def test_the_better_forecast_is_found_whichever_comes_first():
    rng = np.random.default_rng(0)
    worse, gains = rng.normal(0.0, 30.0, 12), rng.normal(2.0, 1.0, 12)
    both = evidence(worse + gains), evidence(worse)
    found = compare(*both)
    assert (found.verdict, compare(*both[::-1]).verdict) == ("first", "second")
    assert found.mean == pytest.approx(gains.mean())
    # the interval of a mean of twelve, by Student's t
    half = 1.796 * gains.std(ddof=1) / math.sqrt(12)
    np.testing.assert_allclose(np.subtract(found.interval, found.mean), [-half, half], rtol=0.3)


def test_one_dive_alone_decides_nothing_and_only_dives_with_the_same_values_are_compared():
    other = np.zeros(8)
    other[3] = -500.0
    assert compare(evidence(np.zeros(8)), evidence(other)).verdict == "undecided"
    assert compare(evidence([5.0, 5.0]), evidence([0.0, 0.0])).verdict == "undecided"
    one, other = Evidence({1: BlockEvidence(1.0, 4), 2: BlockEvidence(9.0, 8)}), evidence([0.0])
    found = compare(one, other)
    assert found.blocks == found.skipped == found.gain == 1
    assert math.isnan(compare(evidence([]), other).mean)


def test_the_interval_of_a_resampled_median_is_that_of_cases_drawn_one_by_one():
    values = np.random.default_rng(1).lognormal(size=7)
    rng = np.random.default_rng(0)
    drawn = [statistics.median(values[case] for case in rng.integers(7, size=7)) for _ in range(60)]
    found = bootstrap_interval(
        lambda cases: np.median(values[cases], axis=1), 7, resamples=60, share=0.8
    )
    np.testing.assert_allclose(found, np.quantile(drawn, [0.1, 0.9]), rtol=1e-12)
