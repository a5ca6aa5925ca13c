"""What cannot be, and what cannot be asked for: each is refused by the name of the setting, place or area."""

from dataclasses import replace

import numpy as np
import pytest

from planners import (
    Glider,
    Line,
    MissionRequest,
    MissionSettings,
    Mooring,
    NoGo,
    Weights,
    plan_mission,
)
from planners.hazards.areas import no_go_rings
from planners.vehicle import SteadyFlight
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import forbidden, place, request_between, still_flow
from tests.planners.mission.test_bottom import bathymetry

NAN, INF = float("nan"), float("inf")
STILL = still_flow()
FRAME = STILL.grid.projection


@pytest.mark.parametrize(
    ("kind", "wrong", "words"),
    [
        *[
            (MissionSettings, wrong, "expected")
            for wrong in ({"depth": 0.0}, {"legs": 0}, {"surface_time": -1.0}, {"tolerance": NAN})
        ],
        *[
            (MissionSettings, {"depths": ends}, "two increasing numbers")
            for ends in ((-1.0, 300.0), (300.0, 200.0), (100.0, INF))
        ],
        *[
            (Weights, wrong, "numbers of 0 or more")
            for wrong in ({"time": -1.0}, {"time": 0.0}, {"energy": NAN}, {"closest": 0.0})
        ],
        *[
            (Glider, {name: value}, "expected")
            for name, values in {
                "min_angle": (0.0, 40.0),
                "max_angle": (90.0,),
                "speed": (0.0,),
                "hotel": (NAN,),
                "max_depth": (0.0,),
            }.items()
            for value in values
        ],
        (Glider, {"min_angle": 5.0, "flight": SteadyFlight()}, "glide angles from 5"),
        *[
            (Mooring, {"radius": radius, "duration": duration}, "two numbers above 0")
            for radius, duration in ((0.0, 1.0), (1.0, NAN), (1.0, INF), (INF, 1.0))
        ],
        (Line, {"weight": -1.0}, "a number of 0 or more"),
    ],
)
def test_values_that_cannot_be(kind, wrong, words):
    with pytest.raises(PlanError, match=words):
        kind(**wrong)


CORNERS = ((0.0, 0.0), (0.1, 0.1), (0.1, 0.0), (0.0, 0.1))


@pytest.mark.parametrize(
    ("polygon", "fence", "words"),
    [
        ((), False, "range has 0 corners"),
        (CORNERS[:2], False, "three pairs"),
        ((*CORNERS[:2], CORNERS[0]), False, "three pairs"),
        ((*CORNERS[:2], (0.1, NAN)), False, "three pairs"),
        (CORNERS, True, "encloses 2 separate waters"),
    ],
)
def test_areas_that_cannot_be(polygon, fence, words):
    with pytest.raises(PlanError, match=words):
        no_go_rings(FRAME, NoGo(polygon, "range", fence=fence))


BEGIN, END = (-3e3, 0.0), (3e3, 0.0)
WAY = BEGIN, END
WEST = forbidden(STILL, -3.1e3, -100.0, -2.9e3, 100.0)
WEST_A_TURN_ON = replace(WEST, polygon=tuple((x - 360.0, y) for x, y in WEST.polygon))
AT_START = "start is in a forbidden area: range; move it"
AT_GOAL = "goal is in a forbidden area: range; move it"
AROUND_WEST = {"no_go": (replace(forbidden(STILL, -5e3, -5e3, 0.0, 5e3), fence=True),)}
BESIDE_LAND = {"bathymetry": bathymetry(lambda x, y: np.where(x < 152.5, 25.0, 900.0))}
SHALLOW = {"bathymetry": bathymetry(lambda x, y: 120.0 + 0.0 * x)}


@pytest.mark.parametrize(
    ("places", "settings", "more", "words"),
    [
        (WAY, {"depth": 801.0}, {}, "deeper than twice the deepest level, 400 m"),
        (
            WAY,
            {"depth": 900.0},
            {"vehicle": Glider(max_depth=1000.0)},
            "deeper than twice the deepest level, 400 m",
        ),
        (WAY, {}, {"vehicle": Glider(max_depth=200.0)}, "the vehicle's limit, 200 m"),
        ((BEGIN, (3e3, 0.0, 350.0)), {}, {}, "deeper than the dives"),
        ((BEGIN, (0.0, 0.0, 310.0), END), {}, {}, "deeper than the dives"),
        ((BEGIN, (0.0, 0.0), END), {"legs": 1}, {}, "2 goals need as many legs"),
        ((BEGIN, (6e5, 0.0)), {}, {}, "outside the forecast"),
        (WAY, {"objective": Weights(time=1.0, closest=0.0)}, {}, "a weight of 0"),
        (WAY, {}, {"no_go": (WEST,)}, AT_START),
        (WAY, {}, {"no_go": (WEST_A_TURN_ON,)}, AT_START),
        (WAY[::-1], {}, {"no_go": (WEST_A_TURN_ON,)}, AT_GOAL),
        (WAY, {}, AROUND_WEST, AT_GOAL),
        (WAY[::-1], {}, AROUND_WEST, AT_START),
        (
            WAY,
            {},
            BESIDE_LAND,
            "start is too shallow for dives to 10 m: the bottom less a clearance of 20 m leaves 5 m",
        ),
        (WAY[::-1], {}, BESIDE_LAND, "goal is too shallow for dives to 10 m"),
        ((BEGIN, (3e3, 0.0, 110.0)), {}, SHALLOW, "goal is too shallow for dives to 110 m"),
        (WAY, {"depths": (200.0, 300.0)}, SHALLOW, r"expected a depth from 200 m.* to 100 m"),
        ((END, END), {}, {"shape": Mooring(1e3, 1e6)}, "max_legs = 60"),
        (((4.2e3, 0.0), END), {}, {"shape": Mooring(1e3, 3.6e4)}, "outside of its radius"),
        ((END, END), {}, {"shape": Line()}, "two places that are apart"),
    ],
)
def test_missions_that_cannot_be_asked_for(places, settings, more, words):
    settings = replace(MissionSettings(depth=300.0), **settings)
    with pytest.raises(PlanError, match=words):
        plan_mission(STILL, request_between(STILL, *places, settings=settings, **more))


def test_a_mission_needs_a_goal():
    with pytest.raises(PlanError, match="needs a goal"):
        plan_mission(STILL, MissionRequest(place(STILL, 0.0, 0.0), ()))
