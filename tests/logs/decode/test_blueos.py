"""BlueOS recordings: MAVLink as JSON in an MCAP says what the same messages say in a telemetry log."""

import math

import orjson
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs import open_log
from replay_kit.logs.decode.blueos import mavlink_channel
from tests.logs.log_samples import read_log as read
from tests.logs.log_samples import tlog_entry
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import Skipped, Used, only, run

HEADER = {"system_id": 1, "component_id": 1, "sequence": 7}


def recorded(kind, /, **fields):
    return {"header": HEADER, "message": {"type": kind, **fields}}


HEARTBEAT = recorded(
    "HEARTBEAT",
    custom_mode=19,
    mavtype={"type": "MAV_TYPE_SUBMARINE"},
    autopilot={"type": "MAV_AUTOPILOT_ARDUPILOTMEGA"},
    base_mode={"bits": 209},
    system_status={"type": "MAV_STATE_ACTIVE"},
    mavlink_version=3,
)


def test_enums_flags_and_texts_become_what_a_telemetry_log_holds(tmp_path):
    frame = dialect.MAVLink_heartbeat_message(12, 3, 209, 19, 4, 3)
    (tmp_path / "same.tlog").write_bytes(b"".join(tlog_entry(10**15 + k, frame) for k in range(9)))
    (theirs, *_) = open_log(tmp_path / "same.tlog").messages()
    (ours,), _ = read(
        tmp_path, json_mcap([(0, "mavlink/1/1/HEARTBEAT", "mavlink.1.1.HEARTBEAT", HEARTBEAT)])
    )
    assert ours.payload == theirs.payload
    assert (ours.topic, ours.schema) == (theirs.topic, theirs.schema)


@pytest.mark.parametrize(
    ("kind", "stated", "read"),
    [
        *(
            ("GPS_RAW_INT", {"fix_type": written}, {"fix_type": 3})
            for written in ({"type": "GPS_FIX_TYPE_3D_FIX"}, "GPS_FIX_TYPE_3D_FIX", 3)
        ),
        *(
            ("GPS_INPUT", {"ignore_flags": written}, {"ignore_flags": 5})
            for written in (
                {"bits": 5},
                "GPS_INPUT_IGNORE_FLAG_ALT | GPS_INPUT_IGNORE_FLAG_VDOP",
                5,
            )
        ),
        *(
            ("DEBUG_FLOAT_ARRAY", {"name": written}, {"name": "ADCP_E"})
            for written in ("ADCP_E", "ADCP_E\0\0", [*"ADCP_E", "\0"], [*b"ADCP_E\0\0"])
        ),
        ("OF_NO_DIALECT", {"a": {"type": "NEW"}, "b": {"x": 1}}, {"a": "NEW", "b": {"x": 1}}),
    ],
)
def test_every_way_to_write_a_value(kind, stated, read):
    name, decode = mavlink_channel(f"mavlink/1/1/{kind}")
    assert (name, decode(orjson.dumps(recorded(kind, **stated)))) == (kind, read)
    # as convert writes it
    assert decode(orjson.dumps(read)) == read


def test_topics_of_other_kinds():
    assert mavlink_channel("mavlink/out") is None
    assert mavlink_channel("mavlink/1/1/") is None


def position(depth=0.0):
    return recorded(
        "GLOBAL_POSITION_INT",
        time_boot_ms=5,
        lat=-400_000_000,
        lon=1_520_000_000,
        alt=0,
        relative_alt=-int(depth * 1000),
    )


def ping(number=3):
    parts = {
        "ADCP_CFG": [
            2.0,
            32.0,
            16.0,
            3.0,
            0.0,
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
            0.0,
            1500.0,
            "NaN",
            0.0,
            1.0,
            3.0,
            0.0,
        ],
        "ADCP_E": [0.125, "NaN"],
        "ADCP_N": ["-inf", 0.25],
        "ADCP_U": [0.0, 0.0],
        "ADCP_STD": [0.0625, 0.0625],
    }
    for name, data in parts.items():
        padded = [*data, *[0.0] * (58 - len(data))]
        message = recorded(
            "DEBUG_FLOAT_ARRAY", time_usec=5, name=name, array_id=number, data=padded
        )
        # the recorder writes these bare, which is no JSON
        yield orjson.dumps(message).replace(b'"NaN"', b"NaN").replace(b'"-inf"', b"-inf")


def recording():
    yield 0, "services/ping/log", "services.ping.log", {"level": "info"}
    for second in range(4):
        yield (
            second,
            "mavlink/1/1/GLOBAL_POSITION_INT",
            "mavlink.1.1.GLOBAL_POSITION_INT",
            position(),
        )
        yield second, "mavlink/out", "mavlink.out", position()
        yield (
            second,
            "mavlink/1/1/HEARTBEAT/base_mode",
            "mavlink.1.1.HEARTBEAT.base_mode",
            {"bits": 209},
        )
        yield (
            second,
            "mavlink/1/1/GLOBAL_POSITION_INT/lat",
            "mavlink.1.1.GLOBAL_POSITION_INT.lat",
            b"-400000000",
        )
    for frame in ping():
        yield 3.5, "mavlink/1/1/DEBUG_FLOAT_ARRAY", "mavlink.1.1.DEBUG_FLOAT_ARRAY", frame
    # disarmed for an hour
    yield 3600, "mavlink/1/1/GLOBAL_POSITION_INT", "mavlink.1.1.GLOBAL_POSITION_INT", position()


def test_a_recording(tmp_path):
    messages, report = read(tmp_path, json_mcap(recording()))
    assert report.undecodable == {}
    assert report.losses == ()
    events = run(messages)
    (profile,) = only(Observation, events)
    assert profile.velocity[1, 1] == 0.25
    assert profile.velocity[0, 0] == 0.125
    assert [math.isnan(v) for v in profile.velocity.ravel()] == [False, True, True, False]
    assert profile.error_std.tolist() == [0.0625] * 2
    assert len(only(VehicleState, events)) == 5
    assert len(only(Used, events)) == 10
    reasons = {(event.topic, event.reason) for event in only(Skipped, events)}
    assert reasons == {
        ("services/ping/log", "message type not used by the estimator"),
        ("mavlink/out", "repeats messages of other topics"),
        ("mavlink/1/1/HEARTBEAT/base_mode", "one field of a message on another topic"),
        (
            "mavlink/1/1/GLOBAL_POSITION_INT/lat",
            "one field of a message on another topic",
        ),
    }
