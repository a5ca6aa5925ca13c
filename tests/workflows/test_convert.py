"""Logs merged into one MCAP: copies lose nothing, and what was lost before is said."""

import json
from collections import Counter
from io import BytesIO
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

import replay_kit as rk
from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError, LogError, ReplayKitError
from replay_kit.logs import open_log
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.convert import convert
from tests.command import invoke
from tests.fuzz.damage import sound_messages
from tests.logs.log_samples import SHARED, json_mcap, tlog
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.places import needs
from tests.studies.twins.truths import make_truth


def converted(*logs, **config):
    """The summary of a conversion into a file beside the first log, and that file."""
    out = logs[0].with_name("out.mcap")
    return convert(logs, out, True, LogConfig(**config)), out


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A glider's log and the telemetry of a vessel."""
    folder = tmp_path_factory.mktemp("logs")
    paths = folder / "glider.mcap", folder / "vessel.tlog"
    make_twin(make_truth(), Twin("glider", 30, 0.09, 0), paths[0])
    make_twin(make_truth(), Twin("vessel", 20, 0.09, 1), folder / "vessel.mcap")
    write_tlog(paths[1], open_log(folder / "vessel.mcap").messages())
    return paths


def test_logs_are_merged_in_order_and_read_by_the_stock_reader(logs):
    summary, out = converted(*logs)
    with out.open("rb") as file:
        read = [
            (message.log_time, channel.topic, channel.message_encoding)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert Counter(topic for _, topic, _ in read) == summary.messages
    times = [time for time, topic, _ in read if topic != "mavlink/frames/1"]
    assert times == sorted(times)
    assert {encoding for _, topic, encoding in read if topic != "mavlink/frames/1"} == {"json"}
    assert summary.messages["/adcp"] == 30
    assert summary.messages["mavlink/1/1/DEBUG_FLOAT_ARRAY"] == 100
    assert (summary.losses, summary.undecodable) == ((), {})
    # the same input gives the same bytes
    before = out.read_bytes()
    assert converted(*logs)[1].read_bytes() == before
    span = {"start": "2018-11-16T01:00:00Z", "end": "2018-11-16T02:00:00Z"}
    assert converted(*logs, **span)[0].messages["/adcp"] == 7


@pytest.mark.parametrize("which", [0, 1])
def test_a_converted_log_gives_the_same_observations(logs, which):
    pairs = []
    for path in (logs[which], converted(logs[which])[1]):
        with rk.open_log(path) as log:
            pairs.append([one for one in rk.observations(log) if isinstance(one, rk.Observation)])
    assert pairs[0]
    for one, other in zip(*pairs, strict=True):
        place, moved = ((each.time_ns, each.longitude, each.latitude) for each in (one, other))
        assert place == moved
        assert one.velocity.tobytes() == other.velocity.tobytes()


def test_the_command_ends_with_4_where_bytes_were_lost_and_with_0_where_none_were(tmp_path, logs):
    data = logs[1].read_bytes()
    for held, code in ((data, 0), (data[:5000] + b"\x00" * 50 + data[5000:], 4)):
        (tmp_path / "a.tlog").write_bytes(held)
        done = invoke(f"convert {tmp_path}/a.tlog -o {tmp_path}/{code}.mcap --json -")
        assert done.exit_code == code, done.exception
        # what could be read is written all the same
        assert (tmp_path / f"{code}.mcap").exists()
        assert "LOST" in done.stderr or code == 0
        assert bool(json.loads(done.stdout)["losses"]) == (code == 4)


def test_bad_inputs_are_refused_before_anything_is_written(tmp_path, logs):
    out = tmp_path / "out.mcap"
    with pytest.raises(LogError, match="file not found"):
        convert([*logs, tmp_path / "missing.mcap"], out, False, LogConfig())
    with pytest.raises(ConfigError, match="at least one log"):
        convert([], out, False, LogConfig())
    assert not list(tmp_path.iterdir())


def content(data: bytes) -> tuple[Any, ...]:
    """Messages with channel and schema, attachments, metadata and the profile, as the stock reader gives them."""
    reader = make_reader(BytesIO(data), validate_crcs=True)
    said = Counter(
        (
            (schema.name, schema.encoding, schema.data) if schema else None,
            (channel.topic, channel.message_encoding, tuple(sorted(channel.metadata.items()))),
            (message.log_time, message.publish_time, message.sequence, message.data),
        )
        for schema, channel, message in reader.iter_messages(log_time_order=False)
    )
    attached = Counter(
        (a.name, a.media_type, a.log_time, a.create_time, a.data) for a in reader.iter_attachments()
    )
    noted = Counter((m.name, tuple(sorted(m.metadata.items()))) for m in reader.iter_metadata())
    return said, attached, noted, reader.get_header().profile


times, words, some = st.integers(0, 2**64 - 1), st.text(max_size=8), st.binary(max_size=20)
metadata = st.dictionaries(words, words, max_size=2)
schemas = st.none() | st.tuples(words.filter(bool), words, some)
channels = st.tuples(words, words, schemas, metadata)


@pytest.mark.full
# each example writes the files of the one folder anew
@settings(
    max_examples=30, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    channels=st.lists(channels, min_size=1, max_size=3),
    messages=st.lists(
        st.tuples(st.integers(0, 2), times, times, st.integers(0, 2**32 - 1), some), max_size=12
    ),
    attachments=st.lists(st.tuples(times, times, words, words, some), max_size=2),
    notes=st.lists(st.tuples(words, metadata), max_size=2),
    compression=st.sampled_from(CompressionType),
    chunked=st.booleans(),
)
def test_mcap_to_mcap(tmp_path, channels, messages, attachments, notes, compression, chunked):
    out, log = BytesIO(), tmp_path / "in.mcap"
    writer = Writer(out, chunk_size=60, compression=compression, use_chunking=chunked)
    writer.start(profile="ros2")
    numbers = [
        writer.register_channel(*name, writer.register_schema(*schema) if schema else 0, held)
        for *name, schema, held in channels
    ]
    for which, log_time, publish_time, sequence, data in messages:
        writer.add_message(numbers[which % len(numbers)], log_time, data, publish_time, sequence)
    for attachment in attachments:
        writer.add_attachment(*attachment)
    for note in notes:
        writer.add_metadata(*note)
    writer.finish()
    log.write_bytes(out.getvalue())
    summary, made = converted(log)
    assert summary.losses == ()
    assert content(made.read_bytes()) == content(out.getvalue())


@needs(SHARED)
def test_real_and_conformance_files(tmp_path):
    conformance = sorted((SHARED / "mcap-conformance").rglob("*.mcap"))[::13]
    for file in [*conformance, *sorted((SHARED / "rosbag2").glob("*.mcap"))[::4]]:
        convert([file], tmp_path / "out.mcap", True, LogConfig())
        # the stock reader relies on a summary that not every file has
        before, after = (
            Counter(m.said for m in sound_messages(path.read_bytes()))
            for path in (file, tmp_path / "out.mcap")
        )
        assert before == after, file


def test_the_frames_of_telemetry_are_kept_and_no_trouble_to_a_reader(tmp_path):
    (tmp_path / "in.tlog").write_bytes(b"".join(tlog(5)))
    out = converted(tmp_path / "in.tlog")[1]
    reader = open_log(out)
    assert [message.topic for message in reader.messages()] == ["mavlink/1/1/ATTITUDE"] * 5
    report = reader.report()
    assert report.undecodable == {}
    assert report.read == {"mavlink/1/1/ATTITUDE": 5, "mavlink/frames": 5}
    stamped = [
        (time // 1000).to_bytes(8, "big") + frame
        for topic, time, _, _, frame in (each.said for each in sound_messages(out.read_bytes()))
        if topic == "mavlink/frames"
    ]
    assert stamped == tlog(5)


@pytest.mark.parametrize("part", [0.3, 0.97])
def test_a_damaged_log_becomes_a_sound_one(tmp_path, part):
    # one of them comes late
    whole = json_mcap([*range(100, 150), 1, *range(150, 299)], CompressionType.ZSTD)
    (tmp_path / "cut.mcap").write_bytes(whole[: int(part * len(whole))])
    summary, out = converted(tmp_path / "cut.mcap")
    assert summary.losses
    reader = open_log(out)
    kept = range(sum(summary.messages.values()))
    assert sorted(message.payload["n"] for message in reader.messages()) == list(kept)
    assert (reader.report().losses, len(kept) > 50) == ((), True)


def test_a_damaged_attachment_is_left_out_and_said(tmp_path):
    out, log = BytesIO(), tmp_path / "in.mcap"
    writer = Writer(out, index_types=IndexType.ALL)
    writer.start()
    writer.add_attachment(1, 2, "kept", "text/plain", b"sound")
    writer.add_attachment(1, 2, "spoiled", "text/plain", b"brittle")
    writer.add_metadata("note", {"a": "b"})
    writer.finish()
    log.write_bytes(out.getvalue().replace(b"brittle", b"brittla"))
    summary, made = converted(log)
    ((_, loss),) = summary.losses
    assert loss.what.startswith("an attachment or metadata record is damaged and excluded")
    _, attached, noted, _ = content(made.read_bytes())
    assert [name for name, *_ in (*attached, *noted)] == ["kept", "note"]


def test_what_does_not_read_back_gets_no_name(tmp_path, monkeypatch):
    (tmp_path / "in.mcap").write_bytes(json_mcap(range(5)))
    monkeypatch.setattr("replay_kit.logs.mcap.writer.McapLogWriter.written", {"/a": 9})
    with pytest.raises(ReplayKitError, match="read back"):
        converted(tmp_path / "in.mcap")
    assert {path.name for path in tmp_path.iterdir()} == {"in.mcap", "out.mcap.part"}
