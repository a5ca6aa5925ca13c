"""Missions over a bottom: they turn above it, go round what is too shallow, and never go below it."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from scipy.interpolate import RegularGridInterpolator

from planners import Bathymetry, MissionSettings
from planners.clearance import clearances
from planners.simulation.fly import Flights
from planners.task import task_of
from replay_kit.core.geodesy import to_geographic
from tests.planners.flow_samples import request_between, still_flow
from tests.planners.hazardous import LATITUDE, LONGITUDE


def bathymetry(depth):
    """Return a bathymetry of a function of longitude and latitude."""
    longitude, latitude = np.meshgrid(LONGITUDE, LATITUDE)
    return Bathymetry(
        longitude,
        latitude,
        np.broadcast_to(depth(longitude, latitude), longitude.shape).astype(float),
    )


def least_height(flow, track, bottom):
    """Return the least height [m] of a track above the bottom, linear between its points, at steps of a metre."""
    points = np.concatenate(
        [np.linspace(a, b, int(np.linalg.norm(b - a)) + 2) for a, b in pairwise(track)]
    )
    longitude, latitude = to_geographic(flow.grid.projection, points[:, 0], points[:, 1])
    depth = RegularGridInterpolator((LATITUDE, LONGITUDE), bottom.depth)(
        np.column_stack([latitude, longitude])
    )
    return float(np.min(depth - points[:, 2]))


def request(flow, begin, end, depth, bottom):
    settings = MissionSettings(depth=depth, max_legs=90)
    return request_between(flow, (begin, 0.0), (end, 0.0), settings=settings, bathymetry=bottom)


@pytest.mark.parametrize("skew", [0.0, 400.0])
def test_shallows_count_for_the_legs_that_dive_too_deep_for_them(skew):
    flow, bottom = still_flow(), bathymetry(lambda x, y: np.where(x < 152.5, 900.0, 100.0))
    task = task_of(flow, request(flow, -3e3, 6e3, 300.0, bottom))
    # two legs that turn at 300 m before the step and at a given depth behind it
    east = np.array([-4.2e3, -3e3, -1.8e3, 100.0, 2e3]) - skew
    places, leg = np.column_stack([east, np.zeros(5)])[None], np.array([0, 0, 0, 1, 1])
    none, times = np.zeros((1, 1)), np.arange(5)[None] * 3600.0

    def apart(deep):
        depth = np.array([[0.0, 300.0, 0.0, deep, 0.0]])
        flown = Flights(none, none, places, times, depth, leg, np.array([2, 4]))
        return clearances(task, flown)

    rings = shapely.unary_union([ring.area for ring in task.bottom.rings(300.0)])
    away = shapely.distance(rings, shapely.linestrings(places[0, :3]))
    # those farther away than a step is long do not count, nor do those that are dived above
    found = apart(60.0).get("shallower than 320 m", np.array([np.inf]))
    np.testing.assert_allclose(found, [away if away < 1.2e3 else np.inf])
    deep = apart(200.0)
    assert deep["shallower than 220 m"] <= 0.0
