"""Profiles relative to a platform of unknown velocity: two bins have a difference, one has none."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.observation import Flag, Reason
from replay_kit.estimator.update.screening import screen
from tests import synthetic

GRID = synthetic.ensemble(n_members=2).grid


@pytest.mark.parametrize(
    ("n_bins", "relative", "used"), [(1, True, 0), (2, True, 2), (3, True, 3), (3, False, 0)]
)
def test_two_bins_are_enough_where_a_profile_without_a_reference_can_be_used(
    n_bins, relative, used
):
    profile = synthetic.profile(
        GRID, 0.0, 0.0, 20.0 + 20.0 * np.arange(n_bins), np.full((n_bins, 2), 0.1)
    )
    flags, reasons = screen(replace(profile, common_std=np.inf), GRID, relative)
    assert np.count_nonzero(flags == Flag.GOOD) == used
    assert np.count_nonzero(reasons & Reason.PLATFORM_REFERENCE) == n_bins - used
