"""Headings of true north, held by a compass: a straight leg of the local frame ends where one flown on the ellipsoid does."""

import numpy as np
import pytest
from pyproj import Geod

from planners.mission.flight import compass_turn
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection

ELLIPSOID = Geod(ellps="WGS84")


def held_by_compass(longitude: float, latitude: float, heading: float, length: float) -> tuple[float, float]:
    """Return where a heading [degrees] held over a length [m] leads, in steps of 100 m on the ellipsoid."""
    for _ in range(round(length / 100.0)):
        longitude, latitude, _ = ELLIPSOID.fwd(longitude, latitude, heading, 100.0)
    return longitude, latitude


@pytest.mark.parametrize("heading", [0.0, 60.0, 200.0, 315.0])
def test_a_compass_held_leg_at_the_region_s_edge_points_where_it_should(heading: float):
    # 300 km from the centre, at 60 degrees north, where true north turns by half a degree within 20 km
    frame, length = Projection(10.0, 60.0), 20e3
    east, north = 250e3, 165e3
    longitude, latitude = (float(value) for value in to_geographic(frame, east, north))
    begin = np.array([[east, north]])
    end = np.array([to_local(frame, *held_by_compass(longitude, latitude, heading, length))]).reshape(1, 2)
    local = np.deg2rad(heading) + compass_turn(frame, begin, end)[0]
    flown = begin[0] + length * np.array([np.sin(local), np.cos(local)])
    across = np.array([np.cos(local), -np.sin(local)])
    # the projection stretches lengths across its radius by up to 4e-4, 8 m of 20 km, and turns a heading by half of that
    assert abs(float((end[0] - flown) @ across)) < 5.0
    at_begin = np.deg2rad(heading) + compass_turn(frame, begin, begin)[0]
    simple = begin[0] + length * np.array([np.sin(at_begin), np.cos(at_begin)])
    if abs(np.sin(np.deg2rad(heading))) > 0.5:
        assert abs(float((end[0] - simple) @ across)) > 20.0
