"""What the map draws: the mean over a dive, the coast, land at its place, the numbers as people write them."""

import numpy as np
import pytest

from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.show.figures.map import Extent
from replay_kit.show.numbers import error_text, fixed, hours_text, minutes_text, nice_number
from replay_kit.show.page.map import coast_near, frame_of


def area(ring: np.ndarray) -> float:
    """The area within a closed ring [km^2]."""
    x, y = ring.T / 1e3
    return float(0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def test_an_island_lies_where_it_is_and_has_its_area():
    # Gran Canaria: 1560 square kilometres
    projection = Projection(-15.6, 27.95)
    rings = coast_near(projection, np.array([-15.9, -15.3]), np.array([27.7, 28.2]))
    assert len(rings) == 1
    assert area(rings[0]) == pytest.approx(1560.0, rel=0.05)
    assert np.abs(rings[0].mean(axis=0)).max() < 20e3
    # of a box within it all is land
    (inside,) = coast_near(projection, np.array([-15.65, -15.55]), np.array([27.9, 28.0]))
    assert area(inside) == pytest.approx(9.85 * 11.1, rel=0.02)


@pytest.mark.parametrize("longitude", [179.0, 181.0])
def test_land_on_both_sides_of_the_antimeridian_is_found(longitude):
    box = np.array([longitude - 4.0, longitude + 4.0])
    rings = coast_near(Projection(180.0, 66.0), box, np.array([64.0, 69.0]))
    east = np.concatenate(rings)[:, 0]
    assert east.min() < -50e3 < 50e3 < east.max()
    # the open ocean has none
    assert coast_near(Projection(-150.0, 30.0), box + 30.0, np.array([28.0, 32.0])) == []


@pytest.mark.parametrize("latitude", [0.0, 45.0, 80.0])
def test_degrees_between_nodes_are_linear_within_metres(latitude):
    projection = Projection(20.0, latitude)
    frame = frame_of(projection, Extent(-150.0, 150.0, -100.0, 100.0))
    west, east, south, north = frame["ends"]
    nodes = np.array([frame["longitude"], frame["latitude"]]).reshape(2, frame["nodes"], -1)
    # the centre of each cell
    mean = 0.25 * (nodes[:, 1:, 1:] + nodes[:, :-1, 1:] + nodes[:, 1:, :-1] + nodes[:, :-1, :-1])
    axes = (np.linspace(*ends, frame["nodes"]) for ends in ((west, east), (south, north)))
    middle = np.array(np.meshgrid(*(500.0 * (axis[1:] + axis[:-1]) for axis in axes)))
    found = np.stack(to_local(projection, *mean))
    inside = (np.abs(middle[0]) < 150e3) & (np.abs(middle[1]) < 100e3)
    assert np.hypot(*(found - middle))[inside].max() < 100.0


def test_numbers_are_written_as_people_do():
    assert [fixed(value, 2) for value in (-0.001, 1234.5)] == ["0.00", "1,234.50"]
    assert [fixed(value, 1, True) for value in (-0.01, 0.3)] == ["0.0", "+0.3"]
    assert [hours_text(value) for value in (7100.0, 9000.0, 2e5)] == [
        "118 min",
        "2.5 h",
        "2.3 days",
    ]
    assert minutes_text(-179.9999, -40.0) == "40°00.0′S 180°00.0′W"
    assert minutes_text(190.5, 0.26) == "0°15.6′N 169°30.0′W"
    assert [error_text(value) for value in (0.0001, 0.034)] == ["0.1 or less", "3.4"]
    assert [nice_number(value) for value in (0.19, 0.2, 1.7, 0.099)] == [0.1, 0.2, 1.0, 0.05]
