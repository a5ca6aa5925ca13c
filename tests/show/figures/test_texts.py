"""Figures can be read: no two of their texts lie over each other, and none leaves the figure."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Seabed
from replay_kit.core.observation import Innovation
from replay_kit.core.plan import Area
from replay_kit.core.surfacing import Ellipse, Surfacing, SurfacingOutcome
from replay_kit.results import ResultWriter
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.kinds import KINDS, drawn_figure
from tests.results.cases import on, one_bin, turned, write
from tests.show.figures.texts import complaints
from tests.show.status.held_samples import plan as planned
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


def crowded(path: Path, flow: FlowEstimate, innovation: Innovation) -> Contents:
    """Write a result with everything that figures show: dives with mean currents, surfacings, a plan of legs among areas, the bottom."""
    centre, start = flow.grid.projection, flow.time_ns or 0
    size, wide = max(float(np.ptp(flow.grid.longitude)), 1e-3), float(flow.grid.east.max())

    def at(x: float, y: float = 0.0) -> tuple[float, float]:
        return centre.longitude + size * x, centre.latitude + size * y

    mission, legs = planned(start), []
    for k in range(1, 6):
        place = dict(zip(("longitude", "latitude"), at(0.02 * k), strict=True))
        centred = {f"ellipse_{name}": value for name, value in place.items()}
        legs.append({**mission.legs[0], "leg": k, "surfacing_s": 1_800.0 * k, **place, **centred})
    flown = np.linspace([0.0, 0.0], [0.3 * wide, 0.1 * wide], 9)
    whole = replace(
        mission,
        status="uncertain",
        legs=tuple(legs),
        areas=(Area("range", False, (at(0.1, 0.01), at(0.2, 0.01), at(0.2, 0.03))),),
        track=np.column_stack([flown, np.tile([0.0, 300.0], 5)[:9]]),
        track_time=1_800.0 * np.arange(9.0),
        bottom=np.linspace(800.0, 400.0, 9),
    )

    def more(writer: ResultWriter) -> None:
        ends, far = np.linspace(-wide, wide, 40), np.linspace(-3, 3, 40) ** 2
        hill = 1_000.0 - 950.0 * np.exp(-np.add.outer(far, far))
        writer.seabed(start, Seabed(ends, ends, hill))
        for k in range(5):
            (x, y), time_ns = at(0.05 * (k - 3)), start + k * HOUR
            surfacing = Surfacing(time_ns, x, y, Ellipse(x, y, 3_000.0, 1_000.0, 40.0))
            actual = time_ns, x + 0.005 * size, y, 500.0, 90.0
            writer.outcome(SurfacingOutcome(start, surfacing, *actual))

    current = {"mean_current": np.array([0.1, -0.2]), "mean_kind": "dac"}
    of_dive = one_bin(innovation, source=replace(innovation.source, topic="/dac"), **current)
    each = [replace(one, dive=k + 1) for k in range(5) for one in (innovation, of_dive)]
    return write(path, flow, each, whole, more=more)


@pytest.mark.parametrize(
    ("region", "columns"),
    [
        pytest.param(*each, marks=() if each == (PILOT, 2) else pytest.mark.full)
        for each in product(REGIONS, (1, 2))
    ],
)
def test_no_text_lies_over_another_or_leaves_the_figure(tmp_path, innovation, region, columns):
    contents = crowded(tmp_path / "crowded.mcap", REGIONS[region](), innovation)
    # a map depends on its region, the others do not
    found = {
        kind: complaints(drawn_figure(contents, kind, columns=columns))
        for kind in (KINDS if region == PILOT else ("map", "plan"))
    }
    assert {kind: texts for kind, texts in found.items() if texts} == {}


def test_texts_that_overlap_or_leave_a_figure_are_found():
    figure = Figure(figsize=(2.0, 1.0))
    figure.text(0.1, 0.5, "one", rotation=30.0)
    figure.text(0.15, 0.55, "other", rotation=30.0)
    figure.text(0.9, 0.2, "outside")
    figure.text(0.5, 0.8, "apart")
    assert complaints(figure) == ["'one' lies over 'other'", "'outside' leaves the figure"]
