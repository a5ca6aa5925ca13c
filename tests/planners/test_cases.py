"""What is asked for and what comes of it: status, hours and words of missions of every kind, flown by another simulator."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Bathymetry, Line, MissionSettings, Mooring, plan_mission
from planners.hazards.areas import no_go_rings
from tests.planners.flow_samples import (
    eddying_flow,
    forbidden,
    place,
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
# open to the south, between the two ends
BAY = replace(
    WALL,
    polygon=tuple(
        (there.longitude, there.latitude)
        for there in (
            place(STILL, 1e3 * x, 1e3 * y)
            for x, y in zip((-8, 8, 8, 2, 2, -2, -2, -8), (-8, -8, 4, 4, -4, -4, 4, 4), strict=True)
        )
    ),
    fence=True,
)
SHELF = bathymetry(lambda x, y: 60.0 + np.where(x > 152.6, 900.0, 0.0 * x))
SILL = bathymetry(lambda x, y: np.where(np.abs(x - 152.5) < 0.02, 150.0, 900.0))
SIDE = bathymetry(lambda x, y: np.where((x > 152.405) & (x < 152.455), 150.0, 900.0))
RIDGE = bathymetry(lambda x, y: np.where((np.abs(x - 152.5) < 0.03) & (y < -39.75), 225.0, 900.0))
SHALLOWS = replace(STILL.grid, wet=STILL.grid.wet & (np.arange(5) < 3)[:, None, None])
POND = replace(
    forbidden(STILL, -6e3, -6e3, 6e3, 6e3), holes=(forbidden(STILL, -3e3, -3e3, 3e3, 3e3).polygon,)
)
LEGS = "limit: max_legs = 12 (--max-legs)"

# flow, places, what else is asked for, status, hours, words
CASES = {
    "straight": (STILL, WAY, {}, "reached", 17.17, "meets the goal at"),
    "there and back": (
        EDDIES,
        ((-6e3, 0.0), (6e3, 0.0), (-6e3, 0.0)),
        {},
        "reached",
        23.50,
        "goal 2 at",
    ),
    "below": (
        EDDIES,
        ((-6e3, -4e3, 40.0), (6e3, 4e3, 200.0)),
        {},
        "reached",
        13.94,
        "meets the goal",
    ),
    "passed below": (
        EDDIES,
        ((-6e3, -4e3), (0.0, 2e3, 120.0), (6e3, 4e3)),
        {},
        "reached",
        14.15,
        "goal 1",
    ),
    "several dives": (EDDIES, WAY, {"yos": 3, "depth": 120.0}, "reached", 16.94, "meets the goal"),
    "too few legs": (STILL, WAY, {"legs": 3}, "unreachable", 6.44, "limit: 3 legs"),
    "most legs": (STILL, ((-25e3, 0.0), (25e3, 0.0)), {"max_legs": 12}, "unreachable", 25.76, LEGS),
    "too late": (
        STILL,
        ((-20e3, 0.0), (20e3, 0.0)),
        {"max_duration": 5e4},
        "unreachable",
        13.89,
        "within 13.9 h no vehicle of this speed",
    ),
    "too strong": (
        uniform_flow(-0.4, 0.0),
        ((-20e3, 0.0), (20e3, 0.0)),
        {"max_legs": 12},
        "unreachable",
        0.97,
        "the current stops a glider of 0.29 m/s",
    ),
    "no number": (NOWHERE, WAY, {}, "failed", 0.00, "the current is not a number"),
    "a battery": (EDDIES, WAY, {"battery": 2e4}, "unreachable", 16.50, "limit: the battery"),
    "below by a range": (
        uniform_flow(0.1, -0.1),
        ((-6e3, 2e3), (5e3, -6e3, 200.0), (1e3, -3e3, 100.0)),
        {"depths": (100.0, 390.0), "depth": 390.0},
        "reached",
        18.63,
        "goal 2 at",
    ),
    "a range of depths": (
        EDDIES,
        WAY,
        {"depths": (150.0, 390.0), "depth": 390.0},
        "reached",
        16.33,
        "meets",
    ),
    "a wall": (
        STILL,
        WAY,
        {"no_go": (WALL,)},
        "unreachable",
        7.69,
        "a constraint closes every route",
    ),
    "round an area": (STILL, WAY, {"no_go": (ROCK,)}, "reached", 17.67, "meets"),
    "under a lane": (STILL, WAY, {"no_go": (LANE,)}, "reached", 17.40, "meets"),
    "a channel": (STILL, WAY, {"no_go": BANDS}, "reached", 17.17, "meets"),
    "over a sill": (STILL, WAY, {"bathymetry": SILL}, "reached", 17.27, "meets"),
    "along a ridge": (
        STILL,
        ((-8e3, -15e3), (8e3, -15e3)),
        {"depth": 390.0, "bathymetry": RIDGE},
        "reached",
        15.43,
        "meets",
    ),
    "a shelf": (
        STILL,
        ((-5e3, 0.0), (5e3, 0.0)),
        {"max_legs": 12, "bathymetry": SHELF},
        "unreachable",
        2.58,
        LEGS,
    ),
    "by the mask": (
        replace(STILL, grid=SHALLOWS),
        ((-3e3, 0.0), (3e3, 0.0)),
        {},
        "reached",
        5.79,
        "meets",
    ),
    "beside a ridge": (
        STILL,
        ((-8.6e3, 0.0), (9e3, 0.0)),
        {"depth": 390.0, "max_legs": 90, "bathymetry": SIDE},
        "reached",
        17.06,
        "meets",
    ),
    "within a pond": (
        STILL,
        ((-2e3, 0.0), (2e3, 0.0)),
        {"no_go": (POND,)},
        "reached",
        3.87,
        "meets",
    ),
    "within a bay": (
        STILL,
        ((-5e3, 2e3), (5e3, 2e3)),
        {"no_go": (BAY,)},
        "reached",
        16.90,
        "meets",
    ),
    "out of a pond": (
        STILL,
        ((0.0, 0.0), (9e3, 0.0)),
        {"no_go": (POND,)},
        "unreachable",
        2.95,
        "closes every route",
    ),
    "a mooring": (
        uniform_flow(0.2, 0.1),
        HERE,
        {"shape": Mooring(1e3, 3.6e4)},
        "reached",
        10.65,
        "from the mooring at most",
    ),
    "too strong to moor": (
        uniform_flow(0.4, 0.0),
        HERE,
        {"shape": Mooring(1e3, 2.16e4)},
        "unreachable",
        6.00,
        "farther than 1000 m",
    ),
    "a line": (
        STRONG,
        ((-8e3, -4e3), (6e3, 6e3)),
        {"legs": 16, "shape": Line()},
        "unreachable",
        31.27,
        "farther than 2000 m",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_comes_of_what_is_asked(name):
    flow, places, asked, status, hours, words = CASES[name]
    more = {key: asked[key] for key in asked.keys() & {"no_go", "bathymetry", "shape"}}
    settings = {key: asked[key] for key in asked.keys() - more.keys()}
    request = request_between(flow, *places, settings=replace(SETTINGS, **settings), **more)
    plan = plan_mission(flow, request)
    assert (plan.status, plan.duration / 3600.0) == (status, pytest.approx(hours, rel=0.01))
    assert words in plan.message
    if len(plan.headings_deg) == 0:
        return
    track = fly_commands(Sea([flow], request.start_time_ns, 120.0), plan)
    assert np.linalg.norm(track[-1, :2] - plan.track[-1, :2]) < 12.0
    for area in request.no_go:
        counted = track[track[:, 2] <= 1e-3] if area.surface_only else track
        rings = no_go_rings(flow.grid.projection, area)
        assert not any(ring.forbids(counted[:, :2]).any() for ring in rings)
    assert track[:, 2].max() <= flow.levels[flow.grid.wet.any((1, 2))][-1] + 1e-3
    if isinstance(request.bathymetry, Bathymetry):
        assert least_height(flow, track, request.bathymetry) > 19.9
