"""Virtual moorings and lines: in a uniform current, in still water, in eddies, and what cannot be asked for."""

from dataclasses import replace

import numpy as np
import pytest

from planners import Line, MissionRequest, MissionSettings, Mooring, plan_mission
from tests.planners.flow_samples import (
    eddying_flow,
    place,
    request_between,
    still_flow,
    uniform_flow,
)

SETTINGS = MissionSettings(depth=300.0)
HOURS = 3600.0


def moored(flow, request, mooring):
    return plan_mission(flow, replace(request, shape=mooring))


def along(flow, request, line=None):
    return plan_mission(flow, replace(request, shape=line or Line()))


def test_a_mooring_heads_against_a_uniform_current_at_the_angle_that_makes_no_way():
    flow, bearing = uniform_flow(0.27 * np.sin(0.7), 0.27 * np.cos(0.7)), np.rad2deg(0.7)
    here = place(flow, 0.0, 0.0)
    result = moored(
        flow, MissionRequest(here, (here,), settings=SETTINGS), Mooring(1000.0, 10.0 * HOURS)
    )
    assert result.status == "reached"
    np.testing.assert_allclose(result.headings_deg, bearing + 180.0, atol=1.0)
    # 0.3 m/s through water: the glide angle whose cosine makes 0.27 m/s of it
    np.testing.assert_allclose(result.glide_angles_deg, np.rad2deg(np.arccos(0.9)), atol=1.0)
    assert result.duration >= 10.0 * HOURS * (1.0 - 1e-9)
    # a dive bows away from its place by nothing in a current that is the same at all depths
    assert result.statistics["rms_m"] < 50.0


def test_in_still_water_a_glider_cannot_stand_but_surfaces_to_either_side():
    flow = still_flow()
    here = place(flow, 0.0, 0.0)
    result = moored(
        flow,
        MissionRequest(here, (here,), settings=SETTINGS),
        Mooring(900.0, 10.0 * HOURS, surfacings_only=True),
    )
    hop = 600.0 / np.tan(np.deg2rad(35.0))
    assert result.status == "reached"
    # from the mooring the first dive leads a hop away; after that half a hop is the least that all can be away
    assert hop / 2.0 - 1.0 < result.statistics["rms_m"] < 1.2 * hop / 2.0
    assert result.statistics["farthest_m"] == pytest.approx(hop, rel=0.02)


def test_a_line_is_held_by_a_crab_angle():
    flow = uniform_flow(0.0, 0.12)
    result = along(flow, request_between(flow, (-6e3, 0.0), (5e3, 0.0), settings=SETTINGS))
    crab = np.rad2deg(np.arcsin(0.12 / 0.3 / np.cos(np.deg2rad(result.glide_angles_deg))))
    assert result.status == "reached"
    np.testing.assert_allclose(result.headings_deg, 90.0 + crab, atol=0.3)
    assert result.statistics["farthest_m"] < 20.0


def test_a_line_costs_time_and_the_more_it_weighs_the_nearer_it_is():
    flow = eddying_flow(7, speed=0.3)
    begin, end = place(flow, -8e3, -4e3), place(flow, 6e3, 6e3)
    settings = replace(SETTINGS, legs=6)
    free = plan_mission(flow, MissionRequest(begin, (end,), settings=settings))
    loose, tight = (
        along(flow, MissionRequest(begin, (end,), settings=settings), Line(weight=weight))
        for weight in (0.0, 30.0)
    )
    assert loose.status == tight.status == "reached"
    assert loose.duration == pytest.approx(free.duration, rel=1e-3)
    assert tight.duration > free.duration
    assert tight.statistics["rms_m"] < 0.3 * loose.statistics["rms_m"]
