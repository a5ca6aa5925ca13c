"""The dense flight: its order, its steps at the levels, closest approach and region."""

from dataclasses import replace

import numpy as np
import pytest

from planners.hazards.domain import Region
from planners.track import Track, fly_glide, fractions_of_duration
from tests.planners.flow_samples import LEVELS, eddying_flow, still_flow

# of a grid: south, east, north, west
EDGES = (np.s_[0, :], np.s_[:, -1], np.s_[-1, :], np.s_[:, 0])


def test_fractions_step_on_every_level_crossed():
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
def test_flight_is_of_fourth_order(kind):
    flow = eddying_flow(7, kind)
    velocity, duration = np.array([0.2, 0.1, 0.004]), 8e4

    def end(steps):
        fractions = fractions_of_duration(0.0, velocity[2] * duration, flow.levels, steps)
        return fly_glide(
            flow, np.array([-1e4, -5e3, 0.0]), velocity, fractions * duration
        ).position[-1]

    exact, counts = end(1600), np.array([40, 80, 160])
    errors = [float(np.linalg.norm(end(int(n)) - exact)) for n in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert 3.6 < order < 4.8


def test_closest_approach_is_continuous():
    # A straight line through two far points passes (0, 30, 40) at 50 m, between the points where it is known.
    position = np.array([[-1000.0, 0.0, 0.0], [500.0, 0.0, 0.0]])
    velocity = np.array([[1.0, 0.0, 0.0]] * 2)
    track = Track(np.array([0.0, 1500.0]), position, velocity)
    time, distance = track.closest(np.array([0.0, 30.0, 40.0]), 1500.0)
    assert time == pytest.approx(1000.0, abs=0.1)
    assert distance == pytest.approx(50.0, abs=1e-5)
    time, distance = track.closest(np.array([0.0, 30.0, 40.0]), 600.0)
    assert time == pytest.approx(600.0)
    assert distance == pytest.approx(np.hypot(400.0, 50.0))


def test_track_ends_where_it_leaves_the_region():
    flow = still_flow()
    region = Region(flow.grid)
    track = fly_glide(flow, np.zeros(3), np.array([0.3, 0.0, 0.0]), np.linspace(0.0, 4e5, 20))
    until = track.allowed_until(region.allowed)
    east = track.at(np.array([until]))[0, 0]
    assert abs(east - flow.grid.east.max()) < 200.0
    assert region.allowed(track.at(np.array([until])))[0]


def test_a_track_ends_where_it_first_leaves_even_if_it_comes_back():
    position = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [2000.0, 0.0, 0.0]])
    velocity = np.array([[1.0, 0.0, 0.0]] * 3)
    track = Track(np.array([0.0, 1000.0, 2000.0]), position, velocity)
    # out of it for a while, in again, and out at the point that is known
    until = track.allowed_until(
        lambda at: (at[:, 0] < 210.7) | ((at[:, 0] > 300.0) & (at[:, 0] < 999.0))
    )
    assert until == pytest.approx(210.7, abs=1e-3)
    assert until < 210.7


@pytest.mark.parametrize("shape", [(12, 30), (2, 30), (12, 2)])
def test_sides_keep_every_grid_point_inside(shape):
    grid = still_flow(shape=shape).grid
    points = np.column_stack([grid.east.ravel(), grid.north.ravel()]) / 1e3
    for normal_east, normal_north, tangent_east, tangent_north, *fit in Region(grid).sides():
        along = points @ [tangent_east, tangent_north]
        beyond = points @ [normal_east, normal_north] - np.polynomial.polynomial.polyval(along, fit)
        assert beyond.max() <= 1e-9
        assert beyond.max() > -1e-2
        # a parallel bends by a kilometre over the width of the grid: the side follows it to ten metres
        assert min(np.abs(beyond.reshape(grid.east.shape)[edge]).max() for edge in EDGES) < 1e-2


def test_a_track_that_begins_where_it_may_not_be_is_allowed_for_no_time():
    track = Track(
        np.array([0.0, 10.0]),
        np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]),
        np.array([[1.0, 0.0, 0.0]] * 2),
    )
    assert track.allowed_until(lambda at: at[:, 0] > 5.0) == 0.0
    assert track.allowed_until(lambda at: at[:, 0] > -1.0) == 10.0


def test_steps_left_over_go_where_most_was_rounded_off():
    # a quarter and three quarters of the way: of five steps one each, 0.75 and 2.25 more, and the one left over to the 0.75
    np.testing.assert_allclose(
        fractions_of_duration(0.0, 100.0, np.array([25.0]), 5), [0.0, 0.125, 0.25, 0.5, 0.75, 1.0]
    )
    np.testing.assert_allclose(
        fractions_of_duration(100.0, 0.0, np.array([25.0]), 5), [0.0, 0.25, 0.5, 0.75, 0.875, 1.0]
    )


def test_a_track_between_its_points_is_the_cubic_of_places_and_velocities():
    time = np.array([0.0, 1.0, 4.0])
    cubic = np.column_stack([time**3, 2.0 * time**2 - time, 5.0 - time])
    slope = np.column_stack([3.0 * time**2, 4.0 * time - 1.0, -np.ones(3)])
    at = np.array([0.0, 0.3, 1.0, 2.5, 4.0])
    np.testing.assert_allclose(
        Track(time, cubic, slope).at(at),
        np.column_stack([at**3, 2.0 * at**2 - at, 5.0 - at]),
        atol=1e-12,
    )


def test_regions_end_at_the_surface_and_the_deepest_level_to_a_millimetre():
    region = Region(still_flow().grid)
    depths = np.array([-0.002, -0.0005, 0.0, 399.0, 400.0005, 400.002])
    points = np.column_stack([np.zeros((6, 2)), depths])
    assert region.inside(points).tolist() == [False, True, True, True, True, False]
    assert region.allowed(points).tolist() == region.inside(points).tolist()
    # outside of the outline no depth is inside
    assert not region.inside(points + np.array([1e6, 0.0, 0.0])).any()


def test_a_level_holds_from_its_depth_to_the_next_and_so_does_its_land():
    grid = still_flow().grid
    levels = Region(grid).level_at(
        np.array([-1.0, 4.9, 5.0, 39.9, 40.0, 110.0, 399.9, 400.0, 999.0])
    )
    assert levels.tolist() == [0, 0, 0, 0, 1, 2, 3, 4, 4]
    # one column has land from 110 m down
    wet, row, column = grid.wet.copy(), 3, 4
    wet[2:, row, column] = False
    region = Region(replace(grid, wet=wet))
    here, beside = ((grid.east[row, at], grid.north[row, at]) for at in (column, column + 1))
    assert region.wet(
        np.array([[*here, 109.9], [*here, 110.0], [*here, 400.0], [*beside, 400.0]])
    ).tolist() == [True, False, False, True]
    by_level = region.wet_by_level(np.array([here, beside]))
    assert by_level.tolist() == [
        [True, True],
        [True, True],
        [False, True],
        [False, True],
        [False, True],
    ]
    # one place, and rows of places
    for places in ([here], [[here, beside, here]]):
        found = region.wet_by_level(np.array(places))[:2]
        assert found.shape == (2, *np.shape(places)[:-1])
        assert found.all()


def test_the_sides_of_a_grid_of_two_by_two_are_its_edges_and_point_outwards():
    grid = still_flow(shape=(2, 2)).grid
    middle = np.array([grid.east.mean(), grid.north.mean()]) / 1e3
    corners = np.column_stack([grid.east.ravel(), grid.north.ravel()]) / 1e3
    sides = Region(grid).sides()
    for normal_east, normal_north, tangent_east, tangent_north, *fit in sides:
        beyond = corners @ [normal_east, normal_north] - np.polynomial.polynomial.polyval(
            corners @ [tangent_east, tangent_north], fit
        )
        assert np.sum(np.abs(beyond) < 1e-9) >= 2
        assert middle @ [normal_east, normal_north] < np.polynomial.polynomial.polyval(
            middle @ [tangent_east, tangent_north], fit
        )
    # south, east, north, west
    np.testing.assert_allclose(
        sides[:, :2], [[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]], atol=0.01
    )
