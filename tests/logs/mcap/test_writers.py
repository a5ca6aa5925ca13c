import base64
import json
import math

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mavlink.writer import MAX_CELLS, TlogFrames, write_tlog
from replay_kit.logs.mcap.writer import open_mcap_log, write_mcap_log
from tests.measurements.turned import stated as row_of

START = 1_542_326_400_000_000_000


def _message(payload, topic="/t", schema="some.Schema", time_ns=START):
    return Message(time_ns, topic, schema, payload, 0, 0)


def _ping(n_cells=2, **fields: object):
    payload = {
        "ping": 65_537,
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": n_cells,
        "cell_size": 32.0,
        "bin0_distance": 16.0,
        "velocity": [[0.5, -0.25, None]] * n_cells,
        "velocity_std": 0.125,
        "heading": 270.0,
        **fields,
    }
    return _message(payload, "/adcp", "replay_kit.AdcpPing")


def _fix(dead_reckoned):
    metadata = [
        {"key": "depth", "value": "12.345"},
        {"key": "dead_reckoned", "value": "true" if dead_reckoned else "false"},
    ]
    return _message(
        {"latitude": -40.1234567, "longitude": 152.7654321, "metadata": metadata},
        "/vehicle/fix",
        "foxglove.LocationFix",
    )


def test_json_has_null_for_nan_and_base64_for_bytes(tmp_path):
    payload = {
        "nan": math.nan,
        "inf": [math.inf, 1.0],
        "bytes": b"\x00\xff",
        "array": np.array([1.5, np.nan]),
        "pair": (1, 2),
        "big": 2**64 - 1,
    }
    write_mcap_log(tmp_path / "a.mcap", [_message(payload)])
    with (tmp_path / "a.mcap").open("rb") as file:
        ((schema, channel, message),) = make_reader(file, validate_crcs=True).iter_messages()
    assert schema is not None
    assert (schema.name, schema.encoding, json.loads(schema.data)) == (
        "some.Schema",
        "jsonschema",
        {"type": "object"},
    )
    assert (channel.topic, channel.message_encoding, message.log_time, message.publish_time) == (
        "/t",
        "json",
        START,
        START,
    )
    read = json.loads(message.data)
    assert (read["nan"], read["inf"], read["array"], read["pair"], read["big"]) == (
        None,
        [None, 1.0],
        [1.5, None],
        [1, 2],
        2**64 - 1,
    )
    assert base64.b64decode(read["bytes"]) == b"\x00\xff"


def test_known_schemas_are_described(tmp_path):
    written = write_mcap_log(tmp_path / "a.mcap", [_ping(), _fix(False)])
    assert written == {"/adcp": 1, "/vehicle/fix": 1}
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    described = {schema.name: json.loads(schema.data) for schema in summary.schemas.values()}
    assert set(described) == {"replay_kit.AdcpPing", "foxglove.LocationFix"}
    assert described["replay_kit.AdcpPing"]["properties"]["reference"]["enum"] == [
        "earth",
        "platform",
    ]


def test_a_message_without_a_schema_stays_without(tmp_path):
    write_mcap_log(tmp_path / "a.mcap", [_message({"a": 1}, schema="")])
    with (tmp_path / "a.mcap").open("rb") as file:
        ((schema, _, _),) = make_reader(file).iter_messages()
    assert schema is None


def test_what_was_written_is_read_back_without_loss(tmp_path):
    messages = [_message({"k": k}, f"/{k % 3}", time_ns=START + k) for k in range(50)]
    write_mcap_log(tmp_path / "a.mcap", messages)
    reader = open_log(tmp_path / "a.mcap")
    read, given = (
        [(m.time_ns, m.topic, m.schema, m.payload) for m in source]
        for source in (reader.messages(), messages)
    )
    assert read == given
    assert reader.report().losses == ()


def test_an_error_leaves_the_part_and_the_old_file(tmp_path):
    out = tmp_path / "a.mcap"
    out.write_bytes(b"old")

    def interrupted():
        with open_mcap_log(out) as writer:
            writer.write(_message({"a": 1}))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert out.read_bytes() == b"old"
    assert (tmp_path / "a.mcap.part").exists()


def test_a_place_that_cannot_be_written_is_said(tmp_path):
    with pytest.raises(ConfigError, match="cannot be written"):
        write_mcap_log(tmp_path / "no" / "a.mcap", [])


def test_a_payload_without_json_form_is_refused(tmp_path):
    with pytest.raises(LogError, match="/t at"):
        write_mcap_log(tmp_path / "a.mcap", [_message({"a": object()})])


def test_a_ping_becomes_five_frames(tmp_path):
    out = tmp_path / "a.tlog"
    counts = write_tlog(
        out, [_fix(False), _ping(), _message({}, "/dac", "replay_kit.DepthAveragedCurrent")]
    )
    assert counts["DEBUG_FLOAT_ARRAY"] == 5
    assert int.from_bytes(out.read_bytes()[:8], "big") == START // 1000
    messages = list(open_log(out).messages())
    assert {message.time_ns for message in messages} == {START}
    arrays = {
        message.payload["name"]: message.payload
        for message in messages
        if message.schema == "DEBUG_FLOAT_ARRAY"
    }
    assert {(payload["array_id"], payload["time_usec"]) for payload in arrays.values()} == {
        (1, START // 1000)
    }
    assert arrays["ADCP_CFG"]["data"][:8] == [2.0, 32.0, 16.0, 3.0, 0.0, 0.0, 1.0, 270.0]
    assert arrays["ADCP_CFG"]["data"][15] == 3.0
    assert arrays["ADCP_E"]["data"][:2] == [0.5, 0.5]
    assert arrays["ADCP_N"]["data"][:2] == [-0.25, -0.25]
    assert arrays["ADCP_STD"]["data"][:2] == [0.125, 0.125]
    assert all(map(math.isnan, arrays["ADCP_U"]["data"]))
    (attitude,) = [message.payload for message in messages if message.schema == "ATTITUDE"]
    assert attitude["yaw"] == pytest.approx(-math.pi / 2)


def test_only_measured_positions_are_gps_fixes(tmp_path):
    counts = write_tlog(tmp_path / "a.tlog", [_fix(False), _fix(True)])
    assert counts == {"GPS_RAW_INT": 1, "GLOBAL_POSITION_INT": 2}
    gps, *positions = (message.payload for message in open_log(tmp_path / "a.tlog").messages())
    assert gps["fix_type"] == dialect.GPS_FIX_TYPE_3D_FIX
    for payload in positions:
        assert (payload["lat"], payload["lon"], payload["relative_alt"]) == (
            -401_234_567,
            1_527_654_321,
            -12_345,
        )


@pytest.mark.parametrize(
    ("stated", "gps"),
    [("1", 0), ("TRUE ", 0), (True, 0), (1, 0), ("0", 1), ("false", 1), (None, 1)],
)
def test_dead_reckoned_is_read_as_by_the_replay(tmp_path, stated, gps):
    fix = {
        "latitude": 1.0,
        "longitude": 2.0,
        "metadata": [{"key": "dead_reckoned", "value": stated}],
    }
    assert row_of(_message(fix, schema="foxglove.LocationFix")).dead_reckoned == (gps == 0)
    counts = write_tlog(tmp_path / "a.tlog", [_message(fix, schema="foxglove.LocationFix")])
    assert counts.get("GPS_RAW_INT", 0) == gps


@pytest.mark.parametrize(
    ("velocity", "east", "north"),
    [
        ([None, [0.5, -0.25]], [math.nan, 0.5], [math.nan, -0.25]),
        ([[0.5, -0.25], [1.5]], [0.5, 1.5], [-0.25, math.nan]),
        ([None, None], [math.nan, math.nan], [math.nan, math.nan]),
        # as protobuf has them
        ([0.5, 1.5, -0.25, 2.5], [0.5, -0.25], [1.5, 2.5]),
    ],
)
def test_empty_cells_are_written_as_not_known(tmp_path, velocity, east, north):
    write_tlog(tmp_path / "a.tlog", [_ping(velocity=velocity)])
    arrays = {
        m.payload["name"]: m.payload["data"]
        for m in open_log(tmp_path / "a.tlog").messages()
        if m.schema == "DEBUG_FLOAT_ARRAY"
    }
    assert set(arrays) == {"ADCP_CFG", "ADCP_E", "ADCP_N", "ADCP_STD"}
    np.testing.assert_array_equal([arrays["ADCP_E"][:2], arrays["ADCP_N"][:2]], [east, north])


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (
            _message({"latitude": None, "longitude": 2.0}, schema="foxglove.LocationFix"),
            "expected latitude to be a number",
        ),
        (
            _message({"longitude": 2.0}, schema="foxglove.LocationFix"),
            "expected latitude to be a number",
        ),
        (
            _message({"latitude": 91.0, "longitude": 2.0}, schema="foxglove.LocationFix"),
            "from -90 to 90",
        ),
        (
            _message(
                {"latitude": 1.0, "longitude": 2.0, "metadata": [3]}, schema="foxglove.LocationFix"
            ),
            "not of the expected type",
        ),
        (_ping(cell_size=None, cell_distances=[1.0, 2.0]), "expected cell_size to be a number"),
        (_ping(coordinate_system="sideways"), "expected coordinate_system to be one of"),
        (_ping(velocity=[[1.0, 2.0]]), "as many cells"),
        (_ping(velocity=None), "not of the expected type"),
        (_ping(temperature="warm"), "not of the expected type"),
        (_ping(pressure=1e300), "out of a frame's range"),
    ],
)
def test_what_has_no_frame_is_skipped_and_counted(message, why):
    frames = TlogFrames()
    assert list(frames.entries(message)) == list(frames.entries(message)) == []
    (((topic, reason), count),) = frames.left_out.items()
    assert (topic, count) == (message.topic, 2)
    assert why in reason


def test_east_above_180_is_written_as_west(tmp_path):
    write_tlog(
        tmp_path / "a.tlog",
        [_message({"latitude": 1.0, "longitude": 359.5}, schema="foxglove.LocationFix")],
    )
    assert {message.payload["lon"] for message in open_log(tmp_path / "a.tlog").messages()} == {
        -5_000_000
    }


def test_more_cells_than_a_frame_holds_are_refused(tmp_path):
    write_tlog(tmp_path / "a.tlog", [_ping(MAX_CELLS)])
    with pytest.raises(LogError, match="at most 58 cells"):
        write_tlog(tmp_path / "b.tlog", [_ping(MAX_CELLS + 1)])
    assert not (tmp_path / "b.tlog").exists()
