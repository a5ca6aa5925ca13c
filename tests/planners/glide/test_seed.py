"""The search before a glide's optimiser: its table, its fans, and flights through still water."""

from dataclasses import replace

import numpy as np
import pytest

from planners.glide.seeds import _fans, _fly_all, find_seeds, tabulate
from planners.glide.transcription import GlideSettings, GlideTask
from planners.hazards.domain import Region
from tests.planners.flow_samples import eddying_flow, still_flow

SPEED, LONGEST = 0.3, 2e5


@pytest.mark.parametrize("kind", ["hat", "gaussian"])
def test_the_table_is_the_flow_at_its_points_and_linear_or_constant_elsewhere(kind):
    flow = eddying_flow(3, kind)
    table = tabulate(flow, Region(flow.grid))
    assert np.all(table.spacing <= np.array([12e3, 10.8e3]) / 3.0)
    n_north, n_east = table.velocity.shape[2:]
    last = table.origin + table.spacing * [n_east - 1, n_north - 1]
    np.testing.assert_allclose(
        [table.origin, last],
        [[f(flow.grid.east), f(flow.grid.north)] for f in (np.min, np.max)],
        atol=1e-6,
    )
    # a Gaussian bends between its levels, where the table has three more depths
    assert (table.depths.size - 1) == (flow.levels.size - 1) * (1 if kind == "hat" else 4)
    column, row, depth = 5, 8, float(table.depths[2])
    one, next_ = (table.origin + table.spacing * [at, row] for at in (column, column + 1))
    exact = [flow.velocity(*at, depth) for at in (one, next_)]
    found = table.velocity_at(
        np.array([[*one, depth], [*next_, depth], [*(0.75 * one + 0.25 * next_), depth]])
    )
    np.testing.assert_allclose(
        found[:, :2], [*exact, 0.75 * exact[0] + 0.25 * exact[1]], atol=1e-12
    )
    assert np.all(found[:, 2] == 0.0)
    outside = table.velocity_at(np.array([[*(table.origin - 5e4), -10.0], [*table.origin, 0.0]]))
    np.testing.assert_allclose(outside[0], outside[1], atol=1e-12)


def flow_with_land():
    """Return a flow at rest with land below its first level, the region and the table of it."""
    flow = still_flow()
    wet = flow.grid.wet.copy()
    wet[1:, 3:5, 4:6] = False
    flow = replace(flow, grid=replace(flow.grid, wet=wet))
    region = Region(flow.grid)
    return flow, region, tabulate(flow, region)


def test_the_table_allows_what_the_region_allows():
    _, region, table = flow_with_land()
    rng = np.random.default_rng(0)
    low = table.origin - 1e4
    high = table.origin + table.spacing * np.array(table.velocity.shape[:1:-1]) + 1e4
    points = np.column_stack([rng.uniform(low, high, (3000, 2)), rng.uniform(0.0, 400.0, 3000)])
    # inside a cell all of whose corners are allowed the two may differ by what a cell of the table cuts off a coast
    shifts = 2500.0 * np.array([[0, 0, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    sure = np.array([region.allowed(points + shift) for shift in shifts])
    same = np.all(sure == sure[0], axis=0)
    assert np.mean(same) > 0.6
    assert np.array_equal(table.allowed_at(points)[same], sure[0][same])
    assert {True, False} == set(sure[0][same].tolist())
    assert not table.allowed_at(np.array([[np.nan, 0.0, 10.0]]))[0]


def test_where_a_corner_of_a_cell_is_not_allowed_the_region_itself_is_asked():
    flow, region, table = flow_with_land()
    rng = np.random.default_rng(1)
    # about the land, below the first level that has any
    inner = flow.grid.east[2, 3], flow.grid.north[2, 3]
    points = np.column_stack(
        [rng.uniform(inner, np.add(inner, [30e3, 30e3]), (2000, 2)), rng.uniform(45.0, 400.0, 2000)]
    )
    cell = table.origin + table.spacing * np.floor((points[:, :2] - table.origin) / table.spacing)
    corners = [
        np.column_stack([cell + table.spacing * np.array(shift), points[:, 2]])
        for shift in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
    ]
    mixed = ~np.all([region.allowed(corner) for corner in corners], axis=0)
    assert set(region.allowed(points[mixed]).tolist()) == {True, False}
    np.testing.assert_array_equal(table.allowed_at(points)[mixed], region.allowed(points)[mixed])
    assert table.allowed_at(points)[~mixed].all()


@pytest.mark.parametrize(("begin", "end"), [(0.0, 300.0), (350.0, 50.0), (120.0, 120.0)])
def test_one_fan_arrives_at_the_goal_s_depth_and_the_other_uses_the_water_there_is(begin, end):
    flow = eddying_flow(4, speed=0.25)
    table = tabulate(flow, Region(flow.grid))
    start, goal = np.array([-8e3, 0.0, begin]), np.array([9e3, 4e3, end])
    (rates, times), (steady, lasting) = _fans(table, start, goal, SPEED, LONGEST)
    if begin == end:
        # a goal at the depth of the start is on the horizontal glide of the other fan
        assert rates.size == times.size == 0
    else:
        np.testing.assert_allclose(rates * times, end - begin)
        assert np.all(np.abs(rates) <= SPEED)
        assert times[-1] == pytest.approx(LONGEST)
        # no current carries it there sooner
        fastest = SPEED + np.max(np.linalg.norm(table.velocity, axis=0))
        assert times[0] >= np.hypot(17e3, 4e3) / fastest * (1.0 - 1e-12)
        assert times[0] < 1.3 * np.hypot(17e3, 4e3) / fastest
    assert 0.0 in steady
    assert np.all(np.diff(steady) > 0.0)
    assert np.all(np.abs(steady) < SPEED)
    assert (steady.min() < 0.0) == (begin > 0.0)
    # a glide ends at the surface, at the deepest level, or after the longest time
    depths = begin + steady * lasting
    assert np.all(depths >= -1e-9)
    assert np.all(depths <= 400.0 + 1e-9)
    assert np.all((lasting == LONGEST) | (np.abs(depths) < 1e-9) | (np.abs(depths - 400.0) < 1e-9))
    assert lasting[steady == 0.0] == LONGEST
    assert np.all(lasting > 0.0)


def test_in_still_water_the_closest_approach_of_each_glide_is_that_of_a_straight_line():
    flow = still_flow()
    table = tabulate(flow, Region(flow.grid))
    start, goal = np.array([-9e3, 1e3, 0.0]), np.array([6e3, 3e3, 200.0])
    rng = np.random.default_rng(1)
    velocity = np.column_stack([rng.uniform(-0.25, 0.25, (40, 2)), rng.uniform(0.0, 0.004, 40)])
    duration = rng.uniform(1e4, 8e4, 40)
    time, distance = _fly_all(table, start, goal, velocity, duration)
    # the foot of the perpendicular from the goal, no later than the glide's end
    foot = np.clip(velocity @ (goal - start) / np.sum(velocity**2, axis=1), 0.0, duration)
    np.testing.assert_allclose(
        distance, np.linalg.norm(start + foot[:, None] * velocity - goal, axis=1), rtol=1e-9
    )
    nearer = foot > 0.0
    np.testing.assert_allclose(time[nearer], foot[nearer], rtol=1e-9)
    assert np.all(time[~nearer] == 0.0)


def test_a_glide_counts_until_it_leaves_the_water_and_not_after_it_is_back():
    flow = still_flow()
    edge = float(flow.grid.east.max())
    table = tabulate(flow, Region(flow.grid))
    start, goal = np.array([edge - 5e3, 0.0, 0.0]), np.array([edge + 50e3, 0.0, 0.0])
    time, distance = _fly_all(table, start, goal, np.array([[0.25, 0.0, 0.0]]), np.array([1e5]))
    # of 48 steps of 521 m the tenth ends beyond the edge
    assert distance[0] == pytest.approx(55e3 - 9 * 25e3 / 48, rel=1e-9)
    assert time[0] == pytest.approx(9 * 1e5 / 48, rel=1e-9)


def test_seeds_are_the_nearest_first_and_no_more_than_asked_for():
    flow = eddying_flow(6, speed=0.2)
    region = Region(flow.grid)
    start = np.array([-1e4, -6e3, 0.0])
    goal = np.array([9e3, 5e3, 250.0])
    task = GlideTask(flow, region, start, goal, GlideSettings(SPEED, max_duration=LONGEST))
    every, few = (find_seeds(task, count) for count in (1000, 3))
    distances = [seed.distance for seed in every]
    assert distances == sorted(distances)
    assert few == every[:3]
    assert len({(seed.glide.heading, seed.glide.glide_angle) for seed in every}) == len(every) > 3
    assert all(
        0.0 <= seed.glide.heading < 2.0 * np.pi and 0.0 < seed.glide.duration <= LONGEST
        for seed in every
    )
    assert few[0].distance < 500.0
