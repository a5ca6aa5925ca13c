"""Estimates of several windows as one."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.flow.points import best_velocity_at
from tests.synthetic_flow import TIME_NS, synthetic_flow

PLACE = (5.03, 62.02, 40.0)


def windows(*factors):
    """The same flow, each time later and with another current, its standard errors multiplied by factors."""
    flow = synthetic_flow()
    return [
        replace(
            flow,
            latent=(k + 1.0) * flow.latent,
            covariance=factor**2 * flow.weight_cov,
            time_ns=TIME_NS + k * 10**9,
        )
        for k, factor in enumerate(factors)
    ]


@pytest.mark.parametrize(
    ("factors", "chosen"),
    [((1.0, 2.0), 0), ((2.0, 1.0), 1), ((1.0, 1.0), 1), ((1.0, 1.0, 2.0, 1.0, 1.5), 3)],
)
def test_the_surest_estimate_counts_and_of_equally_sure_ones_the_last(factors, chosen):
    flows = windows(*factors)
    found, expected = best_velocity_at(flows, *PLACE), flows[chosen].velocity_at(*PLACE)
    for name in ("u", "v", "u_standard_error", "v_standard_error", "time", "estimate_time"):
        assert getattr(found, name) == getattr(expected, name)


def test_where_no_window_holds_a_place_there_is_no_number():
    found = best_velocity_at(windows(1.0, 2.0), [PLACE[0], 9.0], PLACE[1], PLACE[2])
    assert np.isfinite(found.u).tolist() == [True, False]
