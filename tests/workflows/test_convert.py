import json
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader

from replay_kit.config.run import LogConfig, MeasurementConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.core.observation import Observation
from replay_kit.logs import merge, open_log
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.convert import convert
from tests.command import invoke
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.measurements.samples import events_of
from tests.places import DATA
from tests.studies.twins.truths import make_truth

SEAGLIDER = sorted((DATA / "seaglider").glob("p17101*.nc"))


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / "glider.mcap", tmp_path / "vessel.tlog"]
    make_twin(make_truth(), Twin("glider", 30, 0.09, 0), paths[0])
    make_twin(make_truth(), Twin("vessel", 20, 0.09, 1), tmp_path / "vessel.mcap")
    write_tlog(paths[1], open_log(tmp_path / "vessel.mcap").messages())
    return paths


def test_logs_are_merged_in_order_and_read_by_the_stock_reader(tmp_path, logs):
    out = tmp_path / "out.mcap"
    summary = convert(logs, out, False, LogConfig())
    with out.open("rb") as file:
        read = [
            (message.log_time, channel.topic, channel.message_encoding)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert {encoding for _, topic, encoding in read if topic != "mavlink/frames/1"} == {"json"}
    frames = [time for time, topic, _ in read if topic == "mavlink/frames/1"]
    read = read[: -len(frames)]
    assert [time for time, _, _ in read] == sorted(time for time, _, _ in read)
    assert (
        Counter(topic for _, topic, _ in read) | {"mavlink/frames/1": len(frames)}
        == summary.messages
    )
    assert summary.messages["/adcp"] == 30
    assert summary.messages["mavlink/1/1/DEBUG_FLOAT_ARRAY"] == 100
    assert (summary.losses, summary.undecodable) == ((), {})


def _profiles(path: Path, component: int | None = None) -> list[Observation]:
    found = events_of(merge([open_log(path)], 1.0), MeasurementConfig(), component=component)
    return [each for events in found for each in events if isinstance(each, Observation)]


@pytest.mark.parametrize("which", [0, 1])
def test_a_converted_log_gives_the_same_observations(tmp_path, logs, which):
    out = tmp_path / "out.mcap"
    convert([logs[which]], out, False, LogConfig())
    pairs = [_profiles(path) for path in (logs[which], out)]
    assert len(pairs[0]) > 0
    for before, after in zip(*pairs, strict=True):
        assert (before.time_ns, before.longitude, before.latitude) == (
            after.time_ns,
            after.longitude,
            after.latitude,
        )
        assert before.velocity.tobytes() == after.velocity.tobytes()


def test_the_same_input_gives_the_same_bytes(tmp_path, logs):
    for name in ("a.mcap", "b.mcap"):
        convert(logs, tmp_path / name, False, LogConfig())
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_start_and_end_limit_what_is_written(tmp_path, logs):
    config = LogConfig(start="2018-11-16T01:00:00Z", end="2018-11-16T02:00:00Z")
    summary = convert(logs[:1], tmp_path / "out.mcap", False, config)
    assert summary.messages["/adcp"] == 7


def test_the_command_ends_with_4_where_bytes_were_lost_and_with_0_where_none_were(tmp_path, logs):
    data = logs[1].read_bytes()
    (tmp_path / "sound.tlog").write_bytes(data)
    (tmp_path / "cut.tlog").write_bytes(data[:5000] + b"\x00" * 50 + data[5000:])
    for name, code in (("sound", 0), ("cut", 4)):
        out, answer = tmp_path / f"{name}.mcap", tmp_path / f"{name}.json"
        done = invoke(f"convert {tmp_path}/{name}.tlog -o {out} --json {answer}")
        assert done.exit_code == code, done.exception
        # what could be read is written all the same
        assert out.exists()
        assert (
            ("LOST" in done.stdout) == bool(json.loads(answer.read_text())["losses"]) == (code == 4)
        )


def test_bad_inputs_are_refused_before_anything_is_written(tmp_path, logs):
    with pytest.raises(LogError, match="file not found"):
        convert([*logs, tmp_path / "missing.mcap"], tmp_path / "out.mcap", False, LogConfig())
    with pytest.raises(ConfigError, match="at least one log"):
        convert([], tmp_path / "out.mcap", False, LogConfig())
    assert not list(tmp_path.glob("out.mcap*"))


def test_the_help_names_every_format():
    for command in ("replay", "convert"):
        said = " ".join(invoke(f"{command} --help", columns=400).output.split())
        assert (
            "MCAP, MAVLink .tlog, DataFlash .BIN, Seaglider NetCDF, raw ADCP (PD0, AD2CP)" in said
        )
