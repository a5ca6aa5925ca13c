"""What is asked for and what comes of it: status, hours and words of missions of every kind, flown by another simulator."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Bathymetry, Glider, Line, MissionSettings, Mooring, Weights, plan_mission
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    request_between,
    still_flow,
    uniform_flow,
)
from tests.planners.mission.test_bottom import bathymetry, least_height
from tests.reference.vehicle import Sea, fly_commands

STILL = still_flow()
NOWHERE = replace(STILL, latent=np.nan * STILL.latent)
EDDIES, STRONG = eddying_flow(3, speed=0.2), eddying_flow(4, speed=0.4)
SETTINGS = MissionSettings(depth=300.0)
WAY = (-9e3, 0.0), (9e3, 0.0)
HERE = (0.0, 0.0), (0.0, 0.0)
WALL = forbidden(STILL, -1e3, -60e3, 1e3, 60e3)
ROCK = forbidden(STILL, -1e3, -2e3, 1e3, 1.5e3)
LANE = forbidden(STILL, -0.7e3, -6e3, 0.7e3, 6e3, surface_only=True)
BANDS = tuple(
    forbidden(STILL, west, south, west + 20.1e3, north)
    for west in np.arange(-60e3, 60e3, 20e3)
    for south, north in ((-90e3, -0.2e3), (0.2e3, 90e3))
)
SHELF = bathymetry(lambda x, y: 60.0 + np.where(x > 152.6, 900.0, 0.0 * x))
SILL = bathymetry(lambda x, y: np.where(np.abs(x - 152.5) < 0.02, 150.0, 900.0))
RIDGE = bathymetry(lambda x, y: np.where((np.abs(x - 152.5) < 0.03) & (y < -39.75), 225.0, 900.0))
POWERED = Glider(1.0, volume=0.0, thrust=30.0, hotel=2.0)
LEGS = "limit: max_legs = 12 (--max-legs)"

# flow, places, settings, what else is asked for, status, hours, words
CASES = {
    "straight": (STILL, WAY, {}, {}, "reached", 17.17, "meets the goal at"),
    "there and back": (
        EDDIES,
        ((-6e3, 0.0), (6e3, 0.0), (-6e3, 0.0)),
        {},
        {},
        "reached",
        23.50,
        "goal 2 at",
    ),
    "below": (
        EDDIES,
        ((-6e3, -4e3, 40.0), (6e3, 4e3, 200.0)),
        {},
        {},
        "reached",
        13.94,
        "meets the goal",
    ),
    "passed below": (
        EDDIES,
        ((-6e3, -4e3), (0.0, 2e3, 120.0), (6e3, 4e3)),
        {},
        {},
        "reached",
        14.15,
        "goal 1",
    ),
    "several dives": (
        EDDIES,
        WAY,
        {"yos": 3, "depth": 120.0},
        {},
        "reached",
        16.94,
        "meets the goal",
    ),
    "already there": (
        EDDIES,
        ((0.0, 0.0), (180.0, -150.0)),
        {},
        {},
        "reached",
        0.00,
        "already there",
    ),
    "too few legs": (STILL, WAY, {"legs": 3}, {}, "unreachable", 6.44, "limit: 3 legs"),
    "most legs": (
        STILL,
        ((-25e3, 0.0), (25e3, 0.0)),
        {"max_legs": 12},
        {},
        "unreachable",
        25.76,
        LEGS,
    ),
    "too late": (
        STILL,
        ((-20e3, 0.0), (20e3, 0.0)),
        {"max_duration": 5e4},
        {},
        "unreachable",
        13.89,
        "within 13.9 h no vehicle of this speed",
    ),
    "too strong": (
        uniform_flow(-0.4, 0.0),
        ((-20e3, 0.0), (20e3, 0.0)),
        {"max_legs": 12},
        {},
        "unreachable",
        0.97,
        "the current stops a glider of 0.29 m/s",
    ),
    "no number": (NOWHERE, WAY, {}, {}, "failed", 0.00, "the current is not a number"),
    "a battery": (EDDIES, WAY, {"battery": 2e4}, {}, "unreachable", 16.50, "limit: the battery"),
    "little energy": (
        STILL,
        ((-4e3, 0.0), (4e3, 0.0)),
        {"depth": 100.0, "speeds": (0.2, 1.0), "objective": "energy"},
        {"vehicle": POWERED},
        "reached",
        7.16,
        "meets",
    ),
    "weighed": (
        STILL,
        ((-2e3, 0.0), (2e3, 0.0)),
        {"objective": Weights(1.0, closest=0.8)},
        {},
        "unreachable",
        1.10,
        "limit: the weights",
    ),
    "a range of depths": (
        EDDIES,
        WAY,
        {"depths": (150.0, 390.0), "depth": 390.0},
        {},
        "reached",
        16.33,
        "meets",
    ),
    "a wall": (
        STILL,
        WAY,
        {},
        {"no_go": (WALL,)},
        "unreachable",
        7.69,
        "a constraint closes every route",
    ),
    "round an area": (STILL, WAY, {}, {"no_go": (ROCK,)}, "reached", 17.67, "meets"),
    "under a lane": (STILL, WAY, {}, {"no_go": (LANE,)}, "reached", 17.40, "meets"),
    "a channel": (STILL, WAY, {}, {"no_go": BANDS}, "reached", 17.17, "meets"),
    "over a sill": (STILL, WAY, {}, {"bathymetry": SILL}, "reached", 17.27, "meets"),
    "along a ridge": (
        STILL,
        ((-8e3, -15e3), (8e3, -15e3)),
        {"depth": 390.0},
        {"bathymetry": RIDGE},
        "reached",
        15.43,
        "meets",
    ),
    "a shelf": (
        STILL,
        ((-5e3, 0.0), (5e3, 0.0)),
        {"max_legs": 12},
        {"bathymetry": SHELF},
        "unreachable",
        2.58,
        LEGS,
    ),
    "a mooring": (
        uniform_flow(0.2, 0.1),
        HERE,
        {},
        {"shape": Mooring(1e3, 3.6e4)},
        "reached",
        10.65,
        "from the mooring at most",
    ),
    "too strong to moor": (
        uniform_flow(0.4, 0.0),
        HERE,
        {},
        {"shape": Mooring(1e3, 2.16e4)},
        "unreachable",
        6.00,
        "farther than 1000 m",
    ),
    "a line": (
        STRONG,
        ((-8e3, -4e3), (6e3, 6e3)),
        {"legs": 12},
        {"shape": Line()},
        "unreachable",
        25.76,
        "farther than 2000 m",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_comes_of_what_is_asked(name):
    flow, places, settings, more, status, hours, words = CASES[name]
    request = request_between(flow, *places, settings=replace(SETTINGS, **settings), **more)
    plan = plan_mission(flow, request)
    assert (plan.status, plan.duration / 3600.0) == (status, pytest.approx(hours, rel=0.01))
    assert words in plan.message
    if len(plan.headings_deg) == 0:
        return
    track = fly_commands(Sea([flow], request.start_time_ns, 120.0), plan)
    assert np.linalg.norm(track[-1, :2] - plan.track[-1, :2]) < 12.0
    if isinstance(request.bathymetry, Bathymetry):
        assert least_height(flow, track, request.bathymetry) > 19.9
