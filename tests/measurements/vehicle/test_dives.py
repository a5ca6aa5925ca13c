"""The one rule for where a dive begins and ends."""

import math

import pytest

from replay_kit.measurements.vehicle.dives import dive_begins, is_submerged

SURFACE = 3.0


@pytest.mark.parametrize(
    ("depth", "begins"), [(-1.0, False), (6.0, False), (6.001, True), (math.nan, False)]
)
def test_a_dive_begins_below_twice_the_surface_depth(depth, begins):
    assert dive_begins(depth, SURFACE) == begins
    assert is_submerged(depth, SURFACE, before=False) == begins


@pytest.mark.parametrize(
    ("depth", "goes_on"), [(3.0, False), (3.001, True), (7.0, True), (math.nan, False)]
)
def test_a_dive_goes_on_below_the_surface_depth(depth, goes_on):
    assert is_submerged(depth, SURFACE, before=True) == goes_on
