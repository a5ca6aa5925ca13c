"""The current beside the estimate: what the estimate's own error explains is none, what it does not is found."""

import numpy as np
import pytest

from replay_kit.core.flow.local import LocalCurrent
from replay_kit.estimator.next_dive.corrections import local_step

HOUR = 3600 * 10**9


def after(innovations, std, every=3 * HOUR):
    state = None
    for k, innovation in enumerate(innovations):
        state = local_step(state, k * every, np.asarray(innovation), np.full(2, std))
    return state


def none_of(local: LocalCurrent) -> float:
    """The probability that there is no current beside the estimate."""
    return float(local.probability[local.std == 0.0].sum())


@pytest.mark.parametrize("std", [0.02, 0.06])
def test_what_the_estimate_s_own_error_explains_is_no_current_beside_it(std):
    rng = np.random.default_rng(1)
    found = [after(std * rng.standard_normal((12, 2)), std) for _ in range(20)]
    assert np.mean([none_of(one) for one in found]) > 0.8
    assert np.mean([one.standard_error(one.time_ns) for one in found]) < 0.35 * std


def test_a_current_that_lasts_is_found_with_its_size_and_its_error():
    found = after([[0.1, -0.05]] * 8, 0.02)
    assert none_of(found) < 1e-3
    np.testing.assert_allclose(found.velocity(found.time_ns), [0.1, -0.05], atol=0.01)
    assert found.standard_error(found.time_ns) < 0.02
    # and forgotten, to the spread that such currents have
    later = found.time_ns + 400 * HOUR
    assert np.hypot(*found.velocity(later)) < 0.01
    assert found.standard_error(later) > 0.04


def test_errors_of_drawn_currents_are_as_large_as_stated():
    rng, squares, stated = np.random.default_rng(5), [], []
    for _ in range(60):
        kept = np.exp(-3.0 / 24.0)
        course = [0.08 * rng.standard_normal(2)]
        for _ in range(12):
            course.append(
                kept * course[-1] + 0.08 * np.sqrt(1.0 - kept**2) * rng.standard_normal(2)
            )
        found = after(np.array(course[:-1]) + 0.03 * rng.standard_normal((12, 2)), 0.03)
        coming = found.time_ns + 3 * HOUR
        squares.append(np.sum((course[-1] - found.velocity(coming)) ** 2))
        stated.append(2.0 * found.standard_error(coming) ** 2)
    assert 0.75 < np.mean(squares) / np.mean(stated) < 1.3


def test_innovations_of_metres_a_second_leave_probabilities_that_can_change():
    found = after([[-6.0, 2.0]] * 4 + [[0.0, 0.0]] * 40, 0.02)
    assert found.probability.sum() == pytest.approx(1.0)
    assert np.hypot(*found.velocity(found.time_ns)) < 0.01
