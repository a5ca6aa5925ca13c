import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from pymavlink import mavutil

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.observation import Observation
from replay_kit.logs import merge, open_log
from replay_kit.measurements import observations
from replay_kit.studies.twins import Twin, make_twin
from tests.studies.twins.truths import LEVELS, make_truth

_PING_KEYS = [
    "stamp",
    "frame_id",
    "ping",
    "coordinate_system",
    "reference",
    "orientation",
    "bin_mapped",
    "n_cells",
    "cell_size",
    "bin0_distance",
    "transducer_depth",
    "beam_unit_vectors",
    "velocity",
    "velocity_std",
    "amplitude",
    "correlation",
    "percent_good",
    "sound_speed",
    "temperature",
    "pressure",
    "heading",
    "pitch",
    "roll",
    "magnetic_declination",
    "declination_applied",
    "bottom_track",
]


def _observed(path: Path) -> list[Observation]:
    found = observations(merge([open_log(path)], 1.0), MeasurementConfig())
    return [each for each in found if isinstance(each, Observation)]


@pytest.mark.parametrize("name", ["a.mcap", "a.tlog"])
@pytest.mark.parametrize("vehicle", ["vessel", "glider"])
def test_the_same_arguments_give_the_same_bytes(tmp_path: Path, vehicle: str, name: str) -> None:
    out = tmp_path / name
    summary = make_twin(make_truth(), Twin(vehicle, 40, 0.09, 7), out)  # type: ignore[arg-type]
    first = out.read_bytes()
    make_twin(make_truth(), Twin(vehicle, 40, 0.09, 7), out, overwrite=True)  # type: ignore[arg-type]
    assert out.read_bytes() == first
    assert summary.pings == 40
    make_twin(make_truth(), Twin(vehicle, 40, 0.09, 8), out, overwrite=True)  # type: ignore[arg-type]
    assert out.read_bytes() != first
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_ping_is_the_documented_json(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    make_twin(make_truth(levels=LEVELS[:4]), Twin("glider", 30, 0.09, 0), out)
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        header = reader.get_header()
        read = [
            (schema.name, channel.topic, json.loads(message.data))
            for schema, channel, message in reader.iter_messages()
        ]
    assert header.library == "replay-kit"
    pings = [
        payload
        for schema, topic, payload in read
        if (schema, topic) == ("replay_kit.AdcpPing", "/adcp")
    ]
    assert len(pings) == 30
    for number, ping in enumerate(pings):
        assert list(ping) == _PING_KEYS
        assert ping["ping"] == number
        assert len(ping["velocity"]) == ping["n_cells"] == 22
        assert {len(cell) for cell in ping["velocity"]} == {3}
    assert pings[0]["velocity"][-1] == [None, None, None]
    assert {schema for schema, topic, _ in read if topic.startswith("/vehicle")} == {
        "foxglove.LocationFix"
    }
    assert {topic for _, topic, _ in read} == {"/adcp", "/vehicle/fix", "/vehicle/position", "/dac"}


def test_a_tlog_is_read_by_pymavlink(tmp_path: Path) -> None:
    out = tmp_path / "a.tlog"
    make_twin(make_truth(), Twin("glider", 30, 0.09, 0), out)
    log = mavutil.mavlink_connection(str(out), dialect="ardupilotmega")
    names: dict[str, int] = {}
    frames = []
    while (message := log.recv_msg()) is not None:
        names[message.get_type()] = names.get(message.get_type(), 0) + 1
        if message.get_type() == "DEBUG_FLOAT_ARRAY":
            frames.append((message.time_usec, message.array_id, message.name))
            assert message._timestamp == pytest.approx(message.time_usec * 1e-6, abs=1e-5)
    log.close()
    assert names["DEBUG_FLOAT_ARRAY"] == 150
    assert names["HEARTBEAT"] == names["SYSTEM_TIME"] == names["ATTITUDE"] == 30
    assert 0 < names["GPS_RAW_INT"] < names["GLOBAL_POSITION_INT"]
    assert "BAD_DATA" not in names
    assert [name for _, _, name in frames[:5]] == [
        "ADCP_CFG",
        "ADCP_E",
        "ADCP_N",
        "ADCP_U",
        "ADCP_STD",
    ]
    assert [array_id for _, array_id, _ in frames[::5]] == list(range(30))


@pytest.mark.parametrize("vehicle", ["vessel", "glider"])
def test_both_carriers_give_the_same_observations(tmp_path: Path, vehicle: str) -> None:
    truth = make_truth()
    for name in ("a.mcap", "a.tlog"):
        make_twin(truth, Twin(vehicle, 60, 0.09, 3), tmp_path / name)  # type: ignore[arg-type]
    pairs = list(zip(_observed(tmp_path / "a.mcap"), _observed(tmp_path / "a.tlog"), strict=True))
    assert len(pairs) == 60
    for ours, theirs in pairs:
        assert ours.time_ns == theirs.time_ns
        # degE7 and float32 are what the wire carries
        assert (ours.longitude, ours.latitude) == pytest.approx(
            (theirs.longitude, theirs.latitude), abs=1.1e-7
        )
        np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=1e-7)
        np.testing.assert_allclose(ours.depth, theirs.depth, atol=1e-3)
        np.testing.assert_allclose(ours.error_std, theirs.error_std, rtol=1e-6)
        assert ours.dive == theirs.dive


def test_a_noise_free_log_states_no_error(tmp_path: Path) -> None:
    make_twin(make_truth(), Twin("vessel", 3, 0.0, 0), tmp_path / "a.mcap")
    pings = [
        message for message in open_log(tmp_path / "a.mcap").messages() if message.topic == "/adcp"
    ]
    assert [ping.payload["velocity_std"] for ping in pings] == [None] * 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"out": "a.csv"}, "mcap or .tlog"),
        ({"vehicle": "kite"}, "vessel or glider"),
        ({"pings": 0}, "pings >= 1"),
        ({"noise": float("nan")}, "noise >= 0"),
        ({"seed": -1}, "seed >= 0"),
        ({"out": "there.mcap"}, "exists"),
        ({"out": "no/such/folder/a.mcap"}, "there is no folder"),
    ],
)
def test_bad_arguments_are_refused(tmp_path: Path, change: dict[str, object], said: str) -> None:
    (tmp_path / "there.mcap").write_bytes(b"mine")
    out = tmp_path / str(change.pop("out", "a.mcap"))
    with pytest.raises(ConfigError, match=said):
        make_twin(make_truth(), replace(Twin("vessel", 3, 0.1, 0), **change), out)  # type: ignore[arg-type]
    assert (tmp_path / "there.mcap").read_bytes() == b"mine"
