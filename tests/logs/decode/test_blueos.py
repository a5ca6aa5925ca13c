"""BlueOS recordings: MAVLink as JSON in an MCAP says what the same messages say in a telemetry log."""

import numpy as np
import orjson
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.observation import Observation, VehicleState
from replay_kit.logs.decode.decoders import mavlink_channel
from tests.logs.log_samples import read_log as read
from tests.logs.log_samples import tlog_entry
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import Skipped, Used, only, run

HEADER = {"system_id": 1, "component_id": 1, "sequence": 7}


def row(topic, payload, second=0):
    return second, topic, topic.replace("/", "."), payload


def recorded(kind, /, **fields):
    return {"header": HEADER, "message": {"type": kind, **fields}}


def test_enums_flags_and_texts_become_what_a_telemetry_log_holds(tmp_path):
    frame = dialect.MAVLink_heartbeat_message(12, 3, 209, 19, 4, 3)
    (theirs, *_), _ = read(tmp_path, b"".join(tlog_entry(10**15 + k, frame) for k in range(9)))
    enums = {"mavtype": "MAV_TYPE_SUBMARINE", "autopilot": "MAV_AUTOPILOT_ARDUPILOTMEGA"}
    enums["system_status"] = "MAV_STATE_ACTIVE"
    written = {name: {"type": of} for name, of in enums.items()} | {"base_mode": {"bits": 209}}
    ours = recorded("HEARTBEAT", custom_mode=19, mavlink_version=3, **written)
    (ours,), _ = read(tmp_path, json_mcap([row("mavlink/1/1/HEARTBEAT", ours)]))
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


POSITION = recorded(
    "GLOBAL_POSITION_INT",
    **{"time_boot_ms": 5, "lat": -400_000_000, "lon": 1_520_000_000, "alt": 0, "relative_alt": 0},
)
SETTINGS = [2.0, 32.0, 16.0, 3.0, *[0.0] * 2, 1.0, *[0.0] * 4, 1500.0, "NaN", 0.0, 1.0, 3.0, 0.0]


def ping():
    parts = {
        "ADCP_CFG": SETTINGS,
        "ADCP_E": [0.125, "NaN"],
        "ADCP_N": ["-inf", 0.25],
        "ADCP_U": [0.0, 0.0],
        "ADCP_STD": [0.0625, 0.0625],
    }
    for name, data in parts.items():
        held = {"name": name, "array_id": 3, "data": [*data, *[0.0] * (58 - len(data))]}
        message = recorded("DEBUG_FLOAT_ARRAY", time_usec=5, **held)
        # the recorder writes these bare, which is no JSON
        yield orjson.dumps(message).replace(b'"NaN"', b"NaN").replace(b'"-inf"', b"-inf")


PLACE = "mavlink/1/1/GLOBAL_POSITION_INT"
#: Topics that repeat what others say.
COPIES = {
    "mavlink/out": POSITION,
    "mavlink/1/1/HEARTBEAT/base_mode": {"bits": 209},
    f"{PLACE}/lat": b"-400000000",
}


def test_a_recording(tmp_path):
    rows = [row(PLACE, POSITION, second) for second in range(4)]
    rows += [row(topic, payload) for topic, payload in COPIES.items()]
    rows += [row("services/ping/log", {"level": "info"})]
    rows += [row("mavlink/1/1/DEBUG_FLOAT_ARRAY", frame, 3.5) for frame in ping()]
    # disarmed for an hour
    rows += [row(PLACE, POSITION, 3600)]
    messages, report = read(tmp_path, json_mcap(rows))
    assert (report.undecodable, report.losses) == ({}, ())
    assert {topic: report.read[topic] for topic in COPIES} == dict.fromkeys(COPIES, 1)
    events = run(messages)
    (profile,) = only(Observation, events)
    np.testing.assert_array_equal(profile.velocity, [[0.125, np.nan], [np.nan, 0.25]])
    assert profile.error_std.tolist() == [0.0625] * 2
    assert len(only(VehicleState, events)) == 5
    assert len(only(Used, events)) == 10
    assert [event.topic for event in only(Skipped, events)] == ["services/ping/log"]
