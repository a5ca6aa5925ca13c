"""The current beside an estimate: its moments, and those of the courses drawn from it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.core.flow.made import HOUR, LOCAL
from tests.reference import local as slow
from tests.synthetic_flow import TIME_NS as NOW

TIMES = [NOW - HOUR, NOW, NOW + 5 * HOUR, NOW + 40 * HOUR]


@pytest.mark.parametrize("time_ns", TIMES)
def test_moments_are_those_of_the_average_of_the_processes_predicted_at_once_or_twice(time_ns):
    mean, cov = slow.moments(LOCAL, time_ns)
    for current in (LOCAL, LOCAL.at(min(time_ns, NOW + 2 * HOUR)).at(time_ns)):
        np.testing.assert_allclose(current.velocity(time_ns), mean, rtol=1e-12)
        error = np.sqrt(np.trace(cov) / 2.0)
        assert current.standard_error(time_ns) == pytest.approx(error, rel=1e-12)


def test_courses_have_the_moments_of_the_current_at_each_time_and_between_times():
    n, size = 40_000, 0.05 * np.abs(slow.moments(LOCAL, NOW)[1]).max()
    drawn = LOCAL.sample(TIMES, n, seed=3)
    # times before the last dive count as its time
    np.testing.assert_array_equal(drawn[:, 0], drawn[:, 1])
    np.testing.assert_array_equal(drawn, LOCAL.sample(TIMES, n, seed=3))
    for k, time_ns in enumerate(TIMES):
        mean, cov = slow.moments(LOCAL, time_ns)
        found = drawn[:, k].mean(axis=0)
        np.testing.assert_allclose(found, mean, atol=4.0 * np.sqrt(cov.max() / n))
        np.testing.assert_allclose(np.cov(drawn[:, k].T), cov, atol=0.05 * cov.max())
    for first, second in ((1, 2), (2, 3), (1, 3)):
        between = np.cov(drawn[:, first].T, drawn[:, second].T)[:2, 2:]
        expected = slow.lagged(LOCAL, TIMES[first], TIMES[second])
        np.testing.assert_allclose(between, expected, atol=size)


def test_no_velocity_includes_it(flow):
    beside = replace(flow, local=LOCAL)
    np.testing.assert_array_equal(beside.velocity(0.0, 0.0, 10.0), flow.velocity(0.0, 0.0, 10.0))
    assert beside.mean_flow().local is None
