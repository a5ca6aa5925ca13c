"""The dense flight: its order, its steps at the levels, closest approach and region."""

import numpy as np
import pytest

from planners.region import region_of
from planners.track import Track, fly_glide, fractions_of_duration
from tests.planners.flow_samples import LEVELS, eddying_flow, still_flow


def test_fractions_step_on_every_level_crossed() -> None:
    levels = np.array(LEVELS)
    for begin, end in [(0.0, 300.0), (300.0, 0.0), (50.0, 50.0), (40.0, 110.0), (0.0, 1e-9)]:
        fractions = fractions_of_duration(begin, end, levels, 17)
        assert fractions.size == 18
        assert fractions[0] == 0.0
        assert fractions[-1] == 1.0
        assert np.all(np.diff(fractions) > 0.0)
        depths = begin + (end - begin) * fractions
        crossed = levels[(levels > min(begin, end)) & (levels < max(begin, end))]
        assert all(np.min(np.abs(depths - level)) < 1e-9 for level in crossed)


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_flight_is_of_fourth_order(kind: str) -> None:
    flow = eddying_flow(7, "hat" if kind == "hat" else "gaussian")
    velocity, duration = np.array([0.2, 0.1, 0.004]), 8e4

    def end(steps: int) -> np.ndarray:
        fractions = fractions_of_duration(0.0, velocity[2] * duration, flow.levels, steps)
        return fly_glide(flow, np.array([-1e4, -5e3, 0.0]), velocity, fractions * duration).position[-1]

    exact, counts = end(1600), np.array([40, 80, 160])
    errors = [float(np.linalg.norm(end(int(n)) - exact)) for n in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert 3.6 < order < 4.8


def test_closest_approach_is_continuous() -> None:
    # A straight line through two far points passes (0, 30, 40) at 50 m, between the points where it is known.
    position, velocity = np.array([[-1000.0, 0.0, 0.0], [500.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]] * 2)
    track = Track(np.array([0.0, 1500.0]), position, velocity)
    time, distance = track.closest(np.array([0.0, 30.0, 40.0]), 1500.0)
    assert time == pytest.approx(1000.0, abs=0.1)
    assert distance == pytest.approx(50.0, abs=1e-5)
    time, distance = track.closest(np.array([0.0, 30.0, 40.0]), 600.0)
    assert time == pytest.approx(600.0)
    assert distance == pytest.approx(np.hypot(400.0, 50.0))


def test_track_ends_where_it_leaves_the_region() -> None:
    flow = still_flow()
    region = region_of(flow.grid)
    track = fly_glide(flow, np.zeros(3), np.array([0.3, 0.0, 0.0]), np.linspace(0.0, 4e5, 20))
    until = track.allowed_until(region.allowed)
    east = track.at(np.array([until]))[0, 0]
    assert abs(east - flow.grid.east.max()) < 200.0
    assert region.allowed(track.at(np.array([until])))[0]


def test_a_track_ends_where_it_first_leaves_even_if_it_comes_back() -> None:
    position, velocity = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [2000.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]] * 3)
    track = Track(np.array([0.0, 1000.0, 2000.0]), position, velocity)
    # out of it for a while, in again, and out at the point that is known
    until = track.allowed_until(lambda at: (at[:, 0] < 210.7) | ((at[:, 0] > 300.0) & (at[:, 0] < 999.0)))
    assert until == pytest.approx(210.7, abs=1e-3)
    assert until < 210.7


@pytest.mark.parametrize("shape", [(12, 30), (2, 30), (12, 2)])
def test_sides_keep_every_grid_point_inside(shape: tuple[int, int]) -> None:
    grid = still_flow(shape=shape).grid
    points = np.column_stack([grid.east.ravel(), grid.north.ravel()]) / 1e3
    for normal_east, normal_north, tangent_east, tangent_north, *fit in region_of(grid).sides():
        along = points @ [tangent_east, tangent_north]
        beyond = points @ [normal_east, normal_north] - np.polynomial.polynomial.polyval(along, fit)
        assert beyond.max() <= 1e-9
        assert beyond.max() > -1e-2
