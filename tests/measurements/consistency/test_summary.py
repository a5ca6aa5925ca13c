"""Profiles reduced together to what the checks need: as bin by bin, and whatever comes with them."""

import numpy as np
import pytest

from replay_kit.core.observation import Reason
from replay_kit.measurements.consistency.summary import REPAIRABLE, EnsembleSpeeds, summaries
from tests.measurements.samples import profile
from tests.reference import ping_summary as slow

SPEEDS = EnsembleSpeeds(np.array([0.0, 50.0, 300.0]), np.array([0.2, 0.1, 0.04]))
REASONS = [
    0,
    0,
    0,
    Reason.OUTLIER,
    Reason.HIGH_SPEED | Reason.TILT,
    Reason.AT_SURFACE,
    Reason.MISSING,
]


def _pings(count):
    """Return profiles of several sizes, half of them with bins that are bad or lack numbers, some above the surface, some relative."""
    rng = np.random.default_rng(11)
    for k in range(count):
        n = int(rng.choice([1, 5, 22]))
        depth = (rng.choice([-30.0, 5.0, 40.0]) + 16.0 * np.arange(n)) * rng.choice(
            [1.0, 1.0, -1.0]
        )
        velocity, reasons = rng.normal(0.0, 0.3, (n, 2)), np.zeros(n, np.int32)
        if k % 2:
            velocity[rng.random(n) < 0.2] = np.nan
            reasons = rng.choice(REASONS, n).astype(np.int32)
        yield profile(
            velocity,
            depth,
            rng.uniform(0.01, 0.1, n),
            k,
            (10.0, 60.0),
            reasons=reasons,
            common_std=np.inf if k % 5 == 0 else 0.0,
        )


def test_a_block_is_reduced_as_bin_by_bin():
    pings = list(_pings(60))
    seen = set()
    for ping, found in zip(pings, summaries(pings, SPEEDS), strict=True):
        near, above, speed = slow.summary(
            ping, REPAIRABLE, Reason.AT_SURFACE, SPEEDS.levels.tolist(), SPEEDS.mean_square.tolist()
        )
        seen.add((near is None, above, speed is None))
        assert found.is_above == above
        assert (found.near is None) == (near is None)
        assert (found.speed is None) == (speed is None)
        if found.near is not None:
            assert (found.near.depth, *found.near.velocity) == pytest.approx(near, abs=1e-12)
        if found.speed is not None:
            assert tuple(found.speed) == pytest.approx(speed, rel=1e-12)
    assert len(seen) > 4


def test_what_is_found_of_a_ping_does_not_depend_on_the_others():
    pings = list(_pings(60))
    assert summaries(pings, SPEEDS) == [
        found for ping in pings for found in summaries([ping], SPEEDS)
    ]
    assert all(found.speed is None for found in summaries(pings, None))
