"""Ellipses of few samples: they hold the next surfacing as often as they say."""

import numpy as np
import pytest

from planners.mission.flights import ellipse_factor


@pytest.mark.parametrize("count", [3, 5, 10, 20, 50])
def test_an_ellipse_of_few_points_holds_nine_of_ten_others(count: int):
    rng, held = np.random.default_rng(count), []
    # two directions of different size that are correlated
    root = np.array([[300.0, 0.0], [120.0, 80.0]])
    for _ in range(1000):
        points, other = (
            rng.standard_normal((count, 2)) @ root.T,
            rng.standard_normal((40, 2)) @ root.T,
        )
        away = other - points.mean(axis=0)
        scaled = np.sum(away * np.linalg.solve(np.cov(points.T), away.T).T, axis=1)
        held.append(np.mean(scaled <= ellipse_factor(count) ** 2))
    assert 0.87 < np.mean(held) < 0.93


def test_the_factor_of_many_points_is_that_of_a_known_normal_distribution():
    assert ellipse_factor(10**6) == pytest.approx(np.sqrt(-2.0 * np.log(0.1)), rel=1e-5)
    # 2 (N - 1) (N + 1) F / (N (N - 2)) with F(2, 8) = 3.1131
    assert ellipse_factor(10) == pytest.approx(np.sqrt(2.0 * 9.0 * 11.0 * 3.11312 / 80.0), rel=1e-5)
