"""Figures can be read: no two of their texts lie over each other, and none leaves the figure."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Seabed
from replay_kit.core.observation import Innovation
from replay_kit.core.plan import Area, Odds, Plan
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results import ResultWriter
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.kinds import KINDS, drawn
from replay_kit.show.figures.map import Chosen
from tests.results.cases import on, one_bin, turned, write
from tests.show.figures.texts import complaints
from tests.synthetic_flow import synthetic_flow

HOUR = 3_600 * 10**9


def scaled(east: float, north: float, latitude: float = 62.0) -> FlowEstimate:
    """Return a flow on a grid of another width and height."""
    flow = synthetic_flow(latitude=latitude)
    return on(flow, east * flow.grid.east, north * flow.grid.north)


PILOT = "as wide as the pilot's of the README"
REGIONS = {
    PILOT: lambda: scaled(6.0, 5.5),
    "wide": lambda: scaled(12.0, 2.0),
    "high": lambda: scaled(0.5, 3.0),
    "small": lambda: scaled(0.05, 0.05),
    "turned": lambda: turned(synthetic_flow(), 35.0),
    "far north": lambda: scaled(2.0, 2.0, latitude=80.0),
}


def crowded(path: Path, flow: FlowEstimate, innovation: Innovation, plan: Plan) -> Contents:
    """Write a result with everything that figures show: dives with mean currents, surfacings, a plan of legs among areas, the bottom."""
    centre, start = flow.grid.projection, flow.time_ns or 0
    size = max(float(np.ptp(flow.grid.longitude)), 1e-3)
    ellipse = {"ellipse_major_m": 3_000.0, "ellipse_minor_m": 1_500.0, "ellipse_bearing_deg": 30.0}
    leg = {"heading_deg": 45.0, "glide_angle_deg": 15.0, "depth_m": 300.0, **ellipse}
    legs = {}
    for k in range(1, 6):
        place = {"longitude": centre.longitude + 0.02 * size * k, "latitude": centre.latitude}
        centred = {f"ellipse_{name}": value for name, value in place.items()}
        when = {"leg": k, "surfacing_s": 1_800.0 * k}
        legs[f"leg_{k:03d}"] = json.dumps({**leg, **when, **place, **centred})
    corners = tuple(
        (centre.longitude + size * x, centre.latitude + 0.1 * size * y)
        for x, y in ((0.1, 0.1), (0.2, 0.1), (0.2, 0.3))
    )
    wide = flow.grid.east.max()
    track = np.column_stack(
        [
            np.linspace(0.0, 0.3 * wide, 9),
            np.linspace(0.0, 0.1 * wide, 9),
            np.tile([0.0, 300.0], 5)[:9],
        ]
    )
    known = {
        "odds": Odds(40, 0.725, 0.9, 250.0, 9e4, 7e4, 8e4),
        "areas": (Area("range", False, corners),),
        "energy": 92_400.0,
        "battery": 2e6,
    }
    way = {
        "track": track,
        "track_time": 1_800.0 * np.arange(9.0),
        "bottom": np.linspace(800.0, 400.0, 9),
    }
    whole = replace(
        plan, status="uncertain", statistics={**plan.statistics, **legs}, **known, **way
    )

    def more(writer: ResultWriter) -> None:
        hill = 1_000.0 - 950.0 * np.exp(
            -np.add.outer(np.linspace(-3, 3, 40) ** 2, np.linspace(-3, 3, 40) ** 2)
        )
        writer.seabed(
            start, Seabed(np.linspace(-wide, wide, 40), np.linspace(-wide, wide, 40), hill)
        )
        for k in range(5):
            place = centre.longitude + 0.05 * size * (k - 3), centre.latitude
            surfacing = Surfacing(start + k * HOUR, *place, Ellipse(*place, 3_000.0, 1_000.0, 40.0))
            writer.outcome(
                SurfacingOutcome(
                    start,
                    surfacing,
                    start + k * HOUR,
                    place[0] + 0.005 * size,
                    place[1],
                    500.0,
                    90.0,
                )
            )

    profiles = [replace(innovation, dive=k + 1) for k in range(5)]
    current = {"mean_current": np.array([0.1, -0.2]), "mean_kind": "dac"}
    of_dive = one_bin(innovation, source=replace(innovation.source, topic="/dac"), **current)
    innovations = [
        each
        for k, profile in enumerate(profiles)
        for each in (profile, replace(of_dive, dive=k + 1))
    ]
    return write(path, flow, innovations, whole, more=more)


@pytest.mark.parametrize(
    ("region", "columns"),
    [
        pytest.param(*each, marks=() if each == (PILOT, 2) else pytest.mark.full)
        for each in product(REGIONS, (1, 2))
    ],
)
def test_no_text_lies_over_another_or_leaves_the_figure(
    tmp_path, innovation, plan, region, columns
):
    contents = crowded(tmp_path / "crowded.mcap", REGIONS[region](), innovation, plan)
    # a map depends on its region, the others do not
    found = {
        kind: complaints(drawn(contents, kind, columns=columns))
        for kind in (KINDS if region == PILOT else ("map", "plan"))
    }
    assert {kind: texts for kind, texts in found.items() if texts} == {}


@pytest.mark.full
def test_the_map_has_the_plan_and_its_goal(tmp_path, innovation, plan):
    contents = crowded(tmp_path / "crowded.mcap", scaled(6.0, 5.5), innovation, plan)
    axes = drawn(contents, "map").axes[0]
    (goal,) = (line for line in axes.lines if line.get_label() == "goal")
    at = contents.last_plan.goal.longitude, contents.last_plan.goal.latitude
    np.testing.assert_allclose([*goal.get_xdata(), *goal.get_ydata()], at, atol=1e-6)
    assert axes.bbox.contains(*axes.transData.transform(at))
    longitude, latitude = contents.track.longitude[-1], contents.track.latitude[-1]
    figure = drawn(contents, "map", Chosen((longitude, latitude, 0.0)))
    (place,) = (line for line in figure.axes[0].lines if line.get_label() == "requested place")
    np.testing.assert_allclose([*place.get_xdata(), *place.get_ydata()], [longitude, latitude])


def test_texts_that_overlap_or_leave_a_figure_are_found():
    figure = Figure(figsize=(2.0, 1.0))
    figure.text(0.1, 0.5, "one", rotation=30.0)
    figure.text(0.15, 0.55, "other", rotation=30.0)
    figure.text(0.9, 0.2, "outside")
    figure.text(0.5, 0.8, "apart")
    assert complaints(figure) == ["'one' lies over 'other'", "'outside' leaves the figure"]
