"""Scores against brute force."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation.evidence import coverage, crps_gaussian
from replay_kit.workflows.replay.scoring import rms_length, scored_points
from tests import synthetic
from tests.reference import baselines as slow

MEMBERS = synthetic.ensemble(n_members=4, shape=(4, 5), levels=np.array([5.0, 90.0]))
TRUTH = Ensemble(MEMBERS.grid, MEMBERS.velocity[:1], None, "truth")


@pytest.mark.parametrize(("error", "std"), [(0.0, 1.0), (0.7, 0.5), (-2.0, 0.8), (0.3, 2.0)])
def test_crps_equals_the_integral(error, std):
    assert float(crps_gaussian(np.array(error), np.array(std))) == pytest.approx(
        slow.crps_by_quadrature(error, std), abs=1e-7
    )


def test_crps_without_spread_is_the_absolute_error():
    np.testing.assert_allclose(crps_gaussian(np.array([0.3, -0.2]), np.zeros(2)), [0.3, 0.2])


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_coverage_of_gaussian_errors_is_their_share(share):
    rng = np.random.default_rng(0)
    std = rng.uniform(0.1, 2.0, 40_000)
    error = std * rng.standard_normal(std.size)
    assert coverage(error, std, share) == pytest.approx(share, abs=0.01)
    inside = sum(
        abs(e) <= {0.5: 0.6744897501960817, 0.9: 1.6448536269514722}[share] * s
        for e, s in zip(error, std, strict=True)
    )
    assert coverage(error, std, share) == inside / std.size


def test_only_wet_points_inside_region_and_levels_are_scored():
    wet = TRUTH.grid.wet.copy()
    wet[1, 2, 3] = False
    holed = replace(TRUTH, grid=replace(TRUTH.grid, wet=wet))
    at = scored_points(MEMBERS.grid, holed)
    assert at.depth.size == wet.sum()
    assert rms_length(np.array([[3.0, 4.0]])) == 5.0
    elsewhere = synthetic.ensemble(
        n_members=2, shape=(4, 5), levels=np.array([5.0, 90.0]), west=10.0
    )
    with pytest.raises(MeasurementError, match="no wet point"):
        scored_points(
            MEMBERS.grid, Ensemble(elsewhere.grid, elsewhere.velocity[:1], None, "elsewhere")
        )
