"""The front: its edges and labels against slow twins, its times against physics, obstacles to the metre."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planners.hazards.areas import Ring
from planners.route.current import CurrentLattice, current_lattice, edge_durations, shares_of_levels
from planners.route.front import sea_of, spread_front
from planners.route.obstacles import directions_around, obstacles_of
from planners.route.passage import relax
from planners.simulation.currents import currents_of
from tests.planners.flow_samples import eddying_flow
from tests.reference.front import arrivals, edge_duration, touches

NONE = np.zeros(0, dtype=int)


def lattice(seed, fastest, times=3, shape=(7, 8), divisions=1):
    """Return a smooth random current on a lattice of 1 km, at times a day apart."""
    rng = np.random.default_rng(seed)
    rows, columns = ((count - 1) * divisions + 1 for count in shape)
    y, x = np.meshgrid(np.linspace(0.0, 2.0, rows), np.linspace(0.0, 2.0, columns), indexing="ij")
    turns = rng.uniform(0.0, 6.0, (times, 2))
    values = np.stack([np.sin(y + a) + 1j * np.sin(x + b) for a, b in turns])
    return CurrentLattice(
        np.array([-3e3, -2e3]),
        1e3,
        86400.0 * np.arange(times),
        fastest / np.abs(values).max() * values,
        divisions,
    )


def ring(*corners, outside=False):
    return Ring(np.array(corners, dtype=float), outside, "wall")


def box(west, south, east, north, outside=False):
    return ring((west, south), (east, south), (east, north), (west, north), outside=outside)


def front_of(current, speed, ends, walls=None, waits=False):
    """Return the front from the first of some places."""
    sea = sea_of(current, speed, np.array(ends), walls, waits=waits)
    return spread_front(sea, np.array([current.places.size]), np.zeros(1), np.inf, NONE)


def still(half, spacing=1e3):
    count = int(2 * half / spacing) + 1
    return CurrentLattice(
        np.array([-half, -half]), spacing, np.zeros(1), np.zeros((1, count, count), dtype=complex)
    )


def test_edges_take_as_long_as_their_twins_and_are_closed_where_those_are():
    current, rng = lattice(3, 0.4), np.random.default_rng(4)
    begin, end = rng.uniform(-3e3, 4e3, (2, 60)) + 1j * rng.uniform(-2e3, 4e3, (2, 60))
    depart = rng.uniform(0.0, 1e5, 60)
    found = edge_durations(current, 0.3, begin, end, depart, 700.0)

    def at(place, time):
        return complex(current.at(np.array([place]), np.array([time]))[0])

    twins = [
        edge_duration(at, 0.3, *given, 700.0)
        for given in zip(begin.tolist(), end.tolist(), depart.tolist(), strict=True)
    ]
    np.testing.assert_allclose(found, twins, rtol=1e-9)
    assert 5 < np.isinf(found).sum() < 55


@pytest.mark.parametrize("seed", range(4))
def test_labels_are_those_of_dijkstra_on_the_same_lattice(seed):
    current = lattice(seed, 0.2)
    sea = sea_of(current, 0.3, np.zeros(0, dtype=complex))
    front = spread_front(sea, np.array([19]), np.zeros(1), np.inf, NONE)

    def duration(here, there, now):
        ends = sea.places[[here]], sea.places[[there]]
        return float(sea.durations(*ends, np.array([now]))[0])

    np.testing.assert_allclose(front.times, arrivals(current.shape, 5, 19, duration), rtol=1e-12)


def test_an_edge_that_opens_later_is_waited_for():
    # an eastward current of 0.5 m/s that stops after a day: a vehicle of 0.3 m/s then goes west
    values = np.zeros((3, 3, 9), dtype=complex)
    values[:2] = 0.5
    current = CurrentLattice(np.array([-4e3, -1e3]), 1e3, np.array([0.0, 86400.0, 86401.0]), values)
    west = [0j, -3e3 + 0j]
    assert np.isinf(front_of(current, 0.3, west).times[-1])
    assert front_of(current, 0.3, west, waits=True).times[-1] == pytest.approx(
        86401.0 + 3e3 / 0.3, rel=1e-3
    )


def gap(apart, offset=0.0):
    """Walls across the way, so far apart."""
    middle = offset + 0.5 * apart, offset - 0.5 * apart
    return [box(-100.0, middle[0], 100.0, 30e3), box(-100.0, -30e3, 100.0, middle[1])]


@pytest.mark.parametrize(
    ("walls", "margin", "passes"),
    [
        *[(gap(99.0, offset), 50.0, False) for offset in (0.0, 333.0)],
        *[(gap(101.0, offset), 50.0, True) for offset in (0.0, 333.0)],
        # without a margin, land that touches land or the region's edge
        *[([box(-100.0, -8e3, 100.0, 8e3 - apart)], 0.0, False) for apart in (-1.0, 0.0, 0.2)],
        ([box(-100.0, -8e3, 100.0, 5e3)], 0.0, True),
        *[
            ([box(-30e3, -30e3, 0.0, 0.0), box(apart, apart, 30e3, 30e3)], 0.0, passes)
            for apart, passes in ((0.0, False), (0.2, False), (2.5, True))
        ],
    ],
)
def test_a_gap_is_passed_when_it_is_wider_than_two_margins(walls, margin, passes):
    ends = np.array([-5e3 + 1e3j, 5e3 - 1e3j])
    frame = box(-8e3, -8e3, 8e3, 8e3, outside=True)
    front = front_of(still(8e3), 0.3, [*ends], obstacles_of([*walls, frame], margin, ends))
    assert np.isfinite(front.times[-1]) == passes


def test_round_an_area_the_way_is_the_shortest_past_its_corner_less_the_margin():
    ends, wall = np.array([-5e3 + 0j, 5e3 + 0j]), box(-1e3, -2e3, 1e3, 2.6e3)
    frame = box(-9e3, -9e3, 9e3, 9e3, outside=True)
    walls = obstacles_of([wall, frame], 50.0, ends)
    front = front_of(still(9e3), 0.3, [*ends], walls)
    corner = complex(1.05e3, -2.05e3)
    shortest = (2.0 * abs(ends[1] - corner) + 2.1e3) / 0.3
    route = relax(front.sea, front.route_to(front.sea.current.places.size + 1, 0.0, True), 0.0)
    assert shortest <= route.times[-1] + 1e-6
    assert route.times[-1] <= 1.002 * shortest


@pytest.mark.parametrize("clear", [11.0, 70.0])
def test_near_a_start_or_goal_the_margin_shrinks(clear):
    # a goal so near to a wall that the margin would forbid it
    ends = np.array([-5e3 + 0j, 0j])
    walls = [box(clear, -3e3, 2e3, 3e3), box(-8e3, -8e3, 8e3, 8e3, outside=True)]
    front = front_of(still(8e3), 0.3, [*ends], obstacles_of(walls, 50.0, ends))
    assert front.times[front.sea.current.places.size + 1] == pytest.approx(5e3 / 0.3, rel=2e-3)
    # elsewhere along the wall it does not
    far = obstacles_of(walls, 50.0, ends)
    assert not far.free(np.array([complex(clear - 30.0, 2e3)]))[0]
    assert far.free(np.array([complex(clear - 55.0, 2e3)]))[0]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_lines_touch_the_outline_as_their_twins_say(seed):
    rng = np.random.default_rng(seed)
    corners = (
        1e3
        * np.sort(rng.uniform(0.3, 1.0, 7))
        * np.exp(1j * np.sort(rng.uniform(0.0, 2.0 * np.pi, 7)))
    )
    wall = ring(*zip(corners.real, corners.imag, strict=True))
    walls = obstacles_of(
        [wall, box(-5e3, -5e3, 5e3, 5e3, outside=True)], 0.2, np.array([4e3 + 4e3j])
    )
    begin, end = 1.5e3 * (rng.uniform(-1.0, 1.0, (2, 20)) + 1j * rng.uniform(-1.0, 1.0, (2, 20)))
    edges = list(zip(corners, np.roll(corners, -1), strict=True))
    twins = [any(touches(b, e, *edge) for edge in edges) for b, e in zip(begin, end, strict=True)]
    if wall.area.geom_type == "Polygon":
        np.testing.assert_array_equal(walls.crossed(begin, end), twins)


def test_a_disc_lies_within_the_places_around_it():
    around = directions_around(3.0 + 4.0j, 250.0, 12)
    middles = 0.5 * (around + np.roll(around, -1))
    assert np.min(np.abs(middles - (3.0 + 4.0j))) == pytest.approx(250.0)


def test_a_flow_on_the_lattice_is_the_mean_of_the_flow_over_depth():
    flow = eddying_flow(4)
    shares = shares_of_levels(currents_of(flow), 300.0, 0.1)
    current = current_lattice(flow, flow.latent, np.zeros(1), 800.0, shares)
    rng = np.random.default_rng(0)
    points = rng.uniform([-35e3, -25e3], [35e3, 25e3], (40, 2))
    depths = np.linspace(0.0, 300.0, 101)

    def exact(point):
        dive = flow.velocity(*np.tile(point, (101, 1)).T, depths).mean(axis=0)
        east, north = 0.9 * dive + 0.1 * flow.velocity(point[0], point[1], 0.0)
        return complex(east, north)

    found = current.at(points[:, 0] + 1j * points[:, 1], np.zeros(40))
    assert np.max(np.abs(found - [exact(point) for point in points])) < 2e-3
