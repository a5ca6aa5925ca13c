import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.message import Message
from replay_kit.core.observation import VehicleState
from replay_kit.logs import open_log
from replay_kit.measurements.observed import begun
from replay_kit.results import ResultWriter
from tests.measurements.samples import interpret
from tests.results.result_samples import DEPTHS, TOPICS, decoded


def time_ns(stamp: Any) -> int:
    return int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos)


def test_every_channel_decodes_with_stock_readers(result):
    assert set(result) == set(TOPICS)
    assert len(result["/vehicle/fix"]) == len(result["/flow/innovation"]) == 300


def test_fix(result, state):
    log_time, fix = result["/vehicle/fix"][0]
    assert log_time == time_ns(fix.timestamp) == state.time_ns
    assert (fix.longitude, fix.latitude, fix.altitude) == (
        state.longitude,
        state.latitude,
        -state.depth,
    )
    assert [(pair.key, pair.value) for pair in fix.metadata] == [
        ("dead_reckoned", "1"),
        ("depth", "12.5"),
    ]


def test_unknown_depth_is_not_the_surface(state, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.fix(replace(state, depth=np.nan))
    fix = decoded(tmp_path / "out.mcap")["/vehicle/fix"][0][1]
    assert np.isnan(fix.altitude)
    assert [pair.key for pair in fix.metadata] == ["dead_reckoned"]


@pytest.mark.parametrize("depth", [0.0, 12.5, 1.0 / 3.0, np.float64(987.654321), np.nan])
@pytest.mark.parametrize("dead_reckoned", [False, True])
def test_a_fix_of_a_result_is_read_back_as_it_was(state, tmp_path, depth, dead_reckoned):
    written = replace(state, depth=depth, dead_reckoned=dead_reckoned)
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.fix(written)
    log, memory, read = open_log(tmp_path / "out.mcap"), begun(), []
    for message in log.messages():
        memory, events = interpret(memory, message, MeasurementConfig())
        read += [event for event in events if isinstance(event, VehicleState)]
    (fix,) = read
    assert (fix.time_ns, fix.longitude, fix.latitude) == (
        written.time_ns,
        written.longitude,
        written.latitude,
    )
    np.testing.assert_equal((fix.depth, fix.dead_reckoned), (depth, dead_reckoned))


def test_the_altitude_of_another_writer_s_fix_is_no_depth(state):
    payload = {"longitude": 5.0, "latitude": 62.0, "altitude": -120.0, "metadata": []}
    message = Message(state.time_ns, "/vehicle/fix", "foxglove.LocationFix", payload, 0, 0)
    _, events = interpret(begun(), message, MeasurementConfig())
    assert [np.isnan(event.depth) for event in events if isinstance(event, VehicleState)] == [True]


def test_longitudes_of_a_full_circle_are_turned(state, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.fix(replace(state, longitude=355.5))
    assert decoded(tmp_path / "out.mcap")["/vehicle/fix"][0][1].longitude == -4.5


def test_estimate(result, flow):
    log_time, value = result["/flow/estimate"][-1]
    assert log_time == time_ns(value.timestamp)
    np.testing.assert_array_equal(value.x, flow.unknowns.x.astype(np.float32))


def unpacked(grid: Any) -> np.ndarray:
    """Return a grid's cells, shape (rows, columns, fields), read as Foxglove documents them: by the strides and each field's offset."""
    rows, columns = len(grid.data) // grid.row_stride, grid.column_count
    assert rows * grid.row_stride == len(grid.data)
    cells = [
        [
            np.frombuffer(
                grid.data,
                "<f4",
                1,
                row * grid.row_stride + column * grid.cell_stride + field.offset,
            )[0]
            for column in range(columns)
            for field in grid.fields
        ]
        for row in range(rows)
    ]
    return np.array(cells, dtype=np.float32).reshape(rows, columns, len(grid.fields))


@pytest.mark.parametrize("depth", DEPTHS)
def test_grid(result, flow, depth):
    _, value = result[f"/flow/grid/{depth:g}m"][0]
    names = ["u", "v", "speed", "u_standard_error", "v_standard_error"]
    assert [(field.name, field.offset, field.type) for field in value.fields] == [
        (name, 4 * k, 7) for k, name in enumerate(names)
    ]
    packed = unpacked(value)
    assert packed.shape == (5, value.column_count, 5)
    assert (value.frame_id, value.pose.position.z) == ("map", -depth)
    assert (value.cell_size.x, value.cell_size.y) == (5_000.0, 5_000.0)
    east = value.pose.position.x + value.cell_size.x * (np.arange(7) + 0.5)
    north = value.pose.position.y + value.cell_size.y * (np.arange(5) + 0.5)
    np.testing.assert_allclose(east, flow.grid.east[0])
    expected = flow.velocity(east, north[:, None], depth)
    wet = flow.grid.wet[np.argmin(np.abs(flow.levels - depth))]
    np.testing.assert_array_equal(packed[wet, :2], expected[wet].astype(np.float32))
    np.testing.assert_allclose(packed[wet, 2], np.hypot(*expected[wet].T), rtol=1e-6)
    error = flow.standard_error(east, north[:, None], depth)
    assert (error[wet] > 0.0).all()
    np.testing.assert_array_equal(packed[wet, 3:], error[wet].astype(np.float32))
    assert np.isnan(packed[~wet]).all()


def test_a_grid_below_the_last_level_states_nothing(flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.grids(flow.time_ns, flow, [500.0])
    packed = unpacked(decoded(tmp_path / "out.mcap")["/flow/grid/500m"][0][1])
    assert np.isnan(packed).all()


def test_a_grid_of_a_flow_without_uncertainty_has_no_fields_of_errors(flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.grids(flow.time_ns, flow.mean_flow(), [0.5])
    value = decoded(tmp_path / "out.mcap")["/flow/grid/0.5m"][0][1]
    assert [field.name for field in value.fields] == ["u", "v", "speed"]
    assert unpacked(value).shape == (5, 7, 3)


def test_arrows(result, flow):
    lengths, scales = [], set()
    for depth in DEPTHS:
        (entity,) = result[f"/flow/arrows/{depth:g}m"][0][1].entities
        assert (entity.id, entity.frame_id) == (f"flow {depth:g} m", "map")
        scale = float({pair.key: pair.value for pair in entity.metadata}["arrow_metres_per_m_s"])
        scales.add(scale)
        for arrow in entity.arrows:
            where, turn = arrow.pose.position, arrow.pose.orientation
            u, v = flow.velocity(where.x, where.y, depth)
            assert where.z == -depth
            yaw = 2.0 * np.arctan2(turn.z, turn.w)
            np.testing.assert_allclose(
                [np.cos(yaw), np.sin(yaw)], [u, v] / np.hypot(u, v), atol=1e-12
            )
            lengths.append(arrow.shaft_length + arrow.head_length)
            assert lengths[-1] == pytest.approx(scale * np.hypot(u, v))
    assert len(scales) == 1
    assert max(lengths) == pytest.approx(1.5 * 5_000.0)


def test_later_arrows_keep_the_scale(flow, tmp_path):
    still = replace(flow, latent=np.zeros_like(flow.latent))
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for factor, value in ((0, still), (1, flow), (2, replace(flow, latent=0.5 * flow.latent))):
            writer.grids(flow.time_ns + factor, value, [10.0])
    nothing, first, second = [
        message.entities[0] for _, message in decoded(tmp_path / "out.mcap")["/flow/arrows/10m"]
    ]
    assert len(nothing.arrows) == 0
    assert second.arrows[3].shaft_length + second.arrows[3].head_length == pytest.approx(
        0.5 * (first.arrows[3].shaft_length + first.arrows[3].head_length)
    )


def test_plan(result, flow, plan):
    log_time, controls = result["/plan/controls"][0]
    assert log_time == time_ns(controls.timestamp) == plan.start_time_ns
    for name in (
        "status",
        "message",
        "heading_deg",
        "glide_angle_deg",
        "speed",
        "duration",
        "closest_approach",
    ):
        assert getattr(controls, name) == getattr(plan, name)
    assert (controls.goal.longitude, controls.goal.latitude, controls.goal.depth) == (
        5.1,
        62.05,
        100.0,
    )
    np.testing.assert_array_equal(controls.velocity_through_water, plan.velocity_through_water)
    np.testing.assert_array_equal(controls.track_time, plan.track_time)
    np.testing.assert_array_equal(
        np.column_stack([controls.track_east, controls.track_north, controls.track_depth]),
        plan.track,
    )
    assert (controls.statistics[0].name, controls.statistics[0].value) == ("iterations", "17")
    _, path = result["/plan/path"][0]
    assert path.frame_id == "map"
    np.testing.assert_array_equal(
        [[pose.position.x, pose.position.y, -pose.position.z] for pose in path.poses], plan.track
    )
    line = json.loads(result["/plan/geojson"][0][1].geojson)["features"][0]
    assert line["properties"]["status"] == "reached"
    longitude, latitude = to_geographic(flow.grid.projection, plan.track[:, 0], plan.track[:, 1])
    np.testing.assert_allclose(
        line["geometry"]["coordinates"], np.column_stack([longitude, latitude]), atol=1e-7
    )


def test_viewers_find_the_last_plan_alone(plan, flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for message in ("stale", "last"):
            writer.plan(replace(plan, message=message), flow.grid.projection)
        assert "/plan/geojson" in writer.topics
    found = decoded(tmp_path / "out.mcap")
    assert [value.message for _, value in found["/plan/controls"]] == ["stale", "last"]
    ((_, drawn),) = found["/plan/geojson"]
    assert json.loads(drawn.geojson)["features"][0]["properties"]["message"] == "last"


def test_path_poses_look_along_the_glide(result, plan):
    turn = result["/plan/path"][0][1].poses[0].orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    ahead = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    np.testing.assert_allclose(
        ahead,
        plan.velocity_through_water * [1, 1, -1] / np.linalg.norm(plan.velocity_through_water),
        atol=1e-12,
    )


def test_failed_plan_is_valid_json_without_a_line(failed_plan, flow, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.plan(failed_plan, flow.grid.projection)
    result = decoded(tmp_path / "out.mcap")
    kinds = [
        feature["geometry"]["type"]
        for feature in json.loads(result["/plan/geojson"][0][1].geojson)["features"]
    ]
    assert kinds == ["Point", "Point"]
    assert result["/plan/controls"][0][1].closest_approach == np.inf
    assert len(result["/plan/path"][0][1].poses) == 0


def test_line_is_continuous_across_the_antimeridian(plan, tmp_path):
    projection = Projection(179.99, 62.0)
    crossing = replace(
        plan,
        start=replace(plan.start, longitude=179.99),
        goal=replace(plan.goal, longitude=-179.99),
    )
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.plan(crossing, projection)
    line, *points = json.loads(decoded(tmp_path / "out.mcap")["/plan/geojson"][0][1].geojson)[
        "features"
    ]
    assert [point["geometry"]["coordinates"][0] for point in points] == [179.99, 180.01]
    longitude = np.array(line["geometry"]["coordinates"])[:, 0]
    assert longitude[-1] > 180.0
    assert np.abs(np.diff(longitude)).max() < 0.1
