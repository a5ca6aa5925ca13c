"""Scores against brute force."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import MeasurementError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation.evidence import crps_gaussian
from replay_kit.workflows.replay.conclude import rms_length, scored_points
from tests import synthetic
from tests.reference import baselines as slow

LEVELS = np.array([5.0, 90.0])
MEMBERS = synthetic.ensemble(n_members=4, shape=(4, 5), levels=LEVELS)
TRUTH = Ensemble(MEMBERS.grid, MEMBERS.velocity[:1], None, "truth")


@pytest.mark.parametrize(("error", "std"), [(0.0, 1.0), (0.7, 0.5), (-2.0, 0.8), (0.3, 2.0)])
def test_crps_equals_the_integral(error, std):
    found = float(crps_gaussian(np.array(error), np.array(std)))
    assert found == pytest.approx(slow.crps_by_quadrature(error, std), abs=1e-7)
    # without spread it is the absolute error
    assert crps_gaussian(np.array(error), np.zeros(())) == pytest.approx(abs(error))


def test_only_wet_points_inside_region_and_levels_are_scored():
    wet = TRUTH.grid.wet.copy()
    wet[1, 2, 3] = False
    holed = replace(TRUTH, grid=replace(TRUTH.grid, wet=wet))
    at = scored_points(MEMBERS.grid, holed)
    assert at.depth.size == wet.sum()
    assert rms_length(np.array([[3.0, 4.0]])) == 5.0
    elsewhere = synthetic.ensemble(n_members=1, shape=(4, 5), levels=LEVELS, west=10.0)
    with pytest.raises(MeasurementError, match="no wet point"):
        scored_points(MEMBERS.grid, elsewhere)
