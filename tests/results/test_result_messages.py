"""The messages of a result: what other readers find in them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Source, VehicleState
from replay_kit.logs import open_log
from replay_kit.measurements.observed import new_stream
from replay_kit.results import ResultWriter
from tests.measurements.samples import interpret
from tests.results.result_samples import DEPTHS, TOPICS, decoded
from tests.synthetic_flow import TIME_NS

FIELDS = ["u", "v", "speed", "u_standard_error", "v_standard_error"]


def test_every_channel_decodes_with_stock_readers(result, flow):
    assert set(result) == set(TOPICS)
    assert len(result["/vehicle/fix"]) == len(result["/flow/innovation"]) == 300
    for topic in ("/vehicle/fix", "/flow/estimate", "/plan/controls"):
        log_time, value = result[topic][-1]
        assert log_time == value.timestamp.seconds * 10**9 + value.timestamp.nanos


def value_of(result, topic):
    return result[topic][-1][1]


@settings(max_examples=20)
@given(st.floats(-180.0, 360.0), st.floats(0.0, 6e3) | st.just(np.nan), st.booleans())
def test_a_fix_of_a_result_is_read_back_as_it_was(tmp_path_factory, longitude, depth, reckoned):
    path = tmp_path_factory.mktemp("fix") / "out.mcap"
    written = VehicleState(TIME_NS, longitude, 62.02, depth, reckoned, Source(0, "/gps", 1, 0))
    with ResultWriter(path) as writer:
        writer.fix(written)
    (found,) = fixes(open_log(path).messages())
    turned = longitude if longitude <= 180.0 else longitude - 360.0
    assert found.longitude == pytest.approx(turned, abs=1e-12)
    assert (found.time_ns, found.latitude) == (TIME_NS, 62.02)
    np.testing.assert_equal((found.depth, found.dead_reckoned), (depth, reckoned))
    # for viewers
    np.testing.assert_array_equal(decoded(path)["/vehicle/fix"][0][1].altitude, -depth)


def fixes(messages):
    memory = new_stream()
    for message in messages:
        memory, events = interpret(memory, message, MeasurementConfig())
        yield from (event for event in events if isinstance(event, VehicleState))


def cells_of(grid):
    """Return a grid's cells, shape (rows, columns), read as Foxglove documents them: by the strides and each field's offset."""
    fields = {
        "names": [field.name for field in grid.fields],
        "formats": ["<f4"] * len(grid.fields),
        "offsets": [field.offset for field in grid.fields],
        "itemsize": grid.cell_stride,
    }
    assert grid.row_stride == grid.column_count * grid.cell_stride
    assert {field.type for field in grid.fields} == {7}
    return np.frombuffer(grid.data, np.dtype(fields)).reshape(-1, grid.column_count)


def test_a_grid_holds_the_flow_and_its_error_where_they_are_known(flow, tmp_path):
    depths = (*DEPTHS, 500.0)
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.grids(flow.time_ns, flow, depths)
        writer.grids(flow.time_ns, flow.mean_flow(), [1.0])
    found = decoded(tmp_path / "out.mcap")
    assert cells_of(value_of(found, "/flow/grid/1m")).dtype.names == ("u", "v", "speed")
    for depth in depths:
        grid = value_of(found, f"/flow/grid/{depth:g}m")
        cells = cells_of(grid)
        assert (grid.frame_id, grid.pose.position.z, [*cells.dtype.names]) == (
            "map",
            -depth,
            FIELDS,
        )
        place, size = grid.pose.position, grid.cell_size
        east = place.x + size.x * (np.arange(7) + 0.5)
        north = place.y + size.y * (np.arange(5) + 0.5)
        np.testing.assert_allclose(east, flow.grid.east[0])
        np.testing.assert_allclose(north, flow.grid.north[:, 0])
        wet = flow.grid.wet[np.argmin(np.abs(flow.levels - depth))] & (depth < 500.0)
        velocity = flow.velocity(east, north[:, None], depth)
        error = flow.standard_error(east, north[:, None], depth)
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        expected = np.dstack([velocity, speed, error]).astype(np.float32)
        expected[~wet] = np.nan
        for k, name in enumerate(FIELDS):
            np.testing.assert_allclose(cells[name], expected[..., k], rtol=1e-6)


def test_arrows_show_the_current_in_one_scale(flow, tmp_path):
    still = replace(flow, latent=np.zeros_like(flow.latent))
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for k, value in enumerate((still, flow, replace(flow, latent=0.5 * flow.latent))):
            writer.grids(flow.time_ns + k, value, DEPTHS)
    found, longest = decoded(tmp_path / "out.mcap"), 0.0
    for depth in DEPTHS:
        nothing, *moving = (one.entities[0] for _, one in found[f"/flow/arrows/{depth:g}m"])
        assert (len(nothing.arrows), nothing.id) == (0, f"flow {depth:g} m")
        for factor, entity in zip((1.0, 0.5), moving, strict=True):
            scale = float(entity.metadata[0].value)
            for arrow in entity.arrows:
                where, turn = arrow.pose.position, arrow.pose.orientation
                velocity = factor * flow.velocity(where.x, where.y, depth)
                length = arrow.shaft_length + arrow.head_length
                yaw = 2.0 * np.arctan2(turn.z, turn.w)
                drawn = length * np.array([np.cos(yaw), np.sin(yaw)])
                np.testing.assert_allclose(drawn, scale * velocity, atol=1e-9 * scale)
                assert where.z == -depth
                longest = max(longest, length)
    assert longest == pytest.approx(1.5 * 5_000.0)


def test_viewers_find_the_last_plan_alone(plan, failed_plan, flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for one in (failed_plan, plan):
            writer.plan(one, flow.grid.projection)
    found = decoded(tmp_path / "out.mcap")
    ((_, drawn),), (empty, path) = found["/plan/geojson"], (one for _, one in found["/plan/path"])
    line, *points = json.loads(drawn.geojson)["features"]
    assert (line["properties"]["status"], len(points), len(empty.poses)) == ("reached", 2, 0)
    places = to_geographic(flow.grid.projection, *plan.track.T[:2])
    np.testing.assert_allclose(line["geometry"]["coordinates"], np.transpose(places), atol=1e-7)
    places = [(one.position.x, one.position.y, -one.position.z) for one in path.poses]
    np.testing.assert_array_equal(places, plan.track)
    # they look along the glide
    turn = path.poses[0].orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    ahead = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    through_water = plan.velocity_through_water * [1, 1, -1]
    np.testing.assert_allclose(ahead, through_water / np.linalg.norm(through_water), atol=1e-12)


def test_a_line_is_continuous_across_the_antimeridian(plan, tmp_path):
    start, goal = replace(plan.start, longitude=179.99), replace(plan.goal, longitude=-179.99)
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.plan(replace(plan, start=start, goal=goal), Projection(179.99, 62.0))
    ((_, drawn),) = decoded(tmp_path / "out.mcap")["/plan/geojson"]
    line, *points = json.loads(drawn.geojson)["features"]
    assert [point["geometry"]["coordinates"][0] for point in points] == [179.99, 180.01]
    longitude = np.array(line["geometry"]["coordinates"])[:, 0]
    assert longitude[-1] > 180.0
    assert np.abs(np.diff(longitude)).max() < 0.1
