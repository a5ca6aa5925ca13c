"""A glide's program: the bounds on its depth, and the start that an earlier plan gives."""

from dataclasses import replace

import numpy as np
import pytest

from planners import GlideSettings, plan
from planners.glide.transcription import Glide, GlideTask, solve_glide
from planners.hazards.domain import Region
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_local
from replay_kit.core.grid import Projection
from tests.planners.flow_samples import eddying_flow, place, still_flow


@pytest.mark.parametrize(
    ("goal_depth", "deepest", "ends_at"),
    [(350.0, 200.0, 200.0), (350.0, 400.0, 350.0), (-40.0, 400.0, 0.0)],
    ids=["below the deepest level", "within", "above the surface"],
)
def test_a_glide_ends_between_the_surface_and_the_deepest_level(goal_depth, deepest, ends_at):
    flow = still_flow()
    start, goal = np.array([-3e3, 1e3, 100.0]), np.array([4e3, 2e3, goal_depth])
    region = Region(replace(flow.grid, levels=flow.grid.levels * deepest / flow.levels[-1]))
    task = GlideTask(flow, region, start, goal, GlideSettings(max_duration=2e5))
    way = goal - start
    guess = Glide(
        float(np.arctan2(way[0], way[1])),
        float(np.arctan2(way[2], np.hypot(*way[:2]))),
        float(np.linalg.norm(way)) / 0.3,
    )
    found = solve_glide(task, guess, np.linspace(0.0, 1.0, 9), bounded=True)
    # in still water the nearest point that is allowed is straight above or below the goal
    assert 100.0 + 0.3 * np.sin(found.glide.glide_angle) * found.glide.duration == pytest.approx(
        ends_at, abs=0.1
    )
    assert found.distance == pytest.approx(abs(goal_depth - ends_at), abs=0.1)
    free = solve_glide(task, guess, np.linspace(0.0, 1.0, 9), bounded=False)
    assert free.distance < 0.1


def _far_from_its_centre(flow, longitude):
    """Return a flow on the same places, whose local frame has its centre on another meridian, so that it is turned there."""
    centre = Projection(longitude, -40.0)
    east, north = to_local(centre, flow.grid.longitude, flow.grid.latitude)
    grid = replace(flow.grid, projection=centre, east=east, north=north)
    return replace(flow, grid=grid, horizontal=replace(flow.horizontal, nodes=grid.nodes))


@pytest.mark.full
def test_an_earlier_plan_is_begun_from_at_its_own_heading_where_the_frame_is_turned():
    flow = _far_from_its_centre(eddying_flow(21), 165.0)
    east, north = float(flow.grid.east.mean()), float(flow.grid.north.mean())
    start = place(flow, east - 1.2e4, north - 8e3)
    goal = place(flow, east + 1e4, north + 9e3, 250.0)
    turn = np.rad2deg(
        grid_bearing_of_true_north(flow.grid.projection, start.longitude, start.latitude)
    )
    assert abs(turn) > 7.0
    cold = plan(flow, start, goal, settings=GlideSettings(tolerance=10.0))
    assert cold.status == "reached"
    warm = plan(flow, start, goal, settings=GlideSettings(tolerance=10.0), warm=cold)
    # what is told is of true north; flown again as it was told, it passes the goal, and nothing else is tried
    assert warm.statistics["best_seed_distance"] == pytest.approx(cold.closest_approach, abs=1.0)
    assert warm.statistics["starts"] == 1
    assert warm.heading_deg == pytest.approx(cold.heading_deg, abs=0.01)
