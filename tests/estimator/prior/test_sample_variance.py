"""The spread over few members, by hand: every estimator's prior divides by one less than their number.

Members are one field times 1, 2 and 6, so the variance is ((1 - 3)^2 + (2 - 3)^2 + (6 - 3)^2) / 2 = 7 times the field's square; divided
by the number of members it would be 4.67.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planners.mission.flights import surfacing_ellipses
from planners.mission.solve.optimum import SafetyMargin, tolerance_factor
from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.estimator import build
from replay_kit.estimator.baselines import naive_3d
from tests import synthetic

TIMES = np.array([1.0, 2.0, 6.0])
VARIANCE = 7.0
ONE = synthetic.ensemble(n_members=2, shape=(4, 5), levels=np.array([5.0, 90.0]))
MEMBERS = replace(ONE, velocity=TIMES[:, None, None, None, None] * ONE.velocity[:1])
PLAIN = EstimatorConfig(
    sample_share=1.0,
    shift_distance=0.0,
    mean_variance=0.0,
    dropped_std=0.0,
    representation_error_std=0.0,
)
PAPER = EstimatorConfig(preset="paper", length_vertical=10.0)


@pytest.mark.parametrize(
    "estimator",
    [
        build([MEMBERS], PLAIN),
        build([MEMBERS], PLAIN, None, TimeConfig(scale="static")),
        build([MEMBERS], PAPER),
        naive_3d(MEMBERS, PLAIN),
    ],
    ids=["static", "through time", "paper", "naive"],
)
def test_the_estimate_before_any_observation(estimator):
    """Of independent weights, as the paper's, the variance is that of the sum of squares over the modes."""
    flow, nodes = estimator.flow(estimator.initial()), MEMBERS.grid.nodes
    at = nodes[:, 0], nodes[:, 1], 5.0
    one = 3.0 * flow.velocity(*at) / 9.0
    expected = np.sqrt(VARIANCE) * np.abs(one)
    found = flow.standard_error(*at)
    assert np.sum(found**2) == pytest.approx(np.sum(expected**2), rel=0.02)
    if flow.depth_functions.kind != "gaussian":
        np.testing.assert_allclose(found, expected, atol=1e-3 * expected.max())


def test_the_margin_of_a_plan_for_samples():
    """Three flights that are off by 1, 2 and 6 m towards a boundary."""
    deviations = np.zeros((3, 1, 2))
    deviations[:, 0, 0] = TIMES
    margin = SafetyMargin(deviations, 0.9, 0.5).margins(np.array([[[1.0, 0.0]]]))
    assert margin == pytest.approx(3.0 + tolerance_factor(3, 0.9) * np.sqrt(VARIANCE) + 0.5)


def test_the_ellipse_of_a_surfacing():
    """Three flights that surface 1, 2 and 6 km east, and as far north, of a place: Hotelling's factor of three is the root of 264."""
    place = 1e3 * np.stack([TIMES, TIMES], axis=1)[:, None]
    flights = SimpleNamespace(place=place, time=np.array([0.0]), projection=MEMBERS.grid.projection)
    ((_, _, major, minor, _),) = surfacing_ellipses(
        flights, SimpleNamespace(surfacing_times=np.array([0.0]))
    )
    assert major == pytest.approx(np.sqrt(264.0) * 1e3 * np.sqrt(2.0 * VARIANCE))
    assert minor == pytest.approx(0.0, abs=0.1)
