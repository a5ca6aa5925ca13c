"""Copies lose nothing: MCAP to MCAP, damaged logs to sound ones."""

from collections import Counter
from io import BytesIO
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ReplayKitError
from replay_kit.logs import open_log
from replay_kit.workflows.convert import convert
from tests.fuzz.damage import sound_messages
from tests.logs.log_samples import SHARED, json_mcap, tlog
from tests.places import needs

# each example writes the files of the one folder anew
trips = settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
times = st.integers(0, 2**64 - 1)
words = st.text(max_size=8)


def content(data: bytes) -> tuple[Counter[Any], Counter[Any], Counter[Any], str]:
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


@pytest.mark.full
@trips
@given(
    channels=st.lists(
        st.tuples(
            words,
            words,
            st.none() | st.tuples(words.filter(bool), words, st.binary(max_size=9)),
            st.dictionaries(words, words),
        ),
        min_size=1,
        max_size=3,
    ),
    messages=st.lists(
        st.tuples(
            st.integers(0, 2), times, times, st.integers(0, 2**32 - 1), st.binary(max_size=20)
        ),
        max_size=12,
    ),
    attachments=st.lists(st.tuples(times, times, words, words, st.binary(max_size=20)), max_size=2),
    notes=st.lists(st.tuples(words, st.dictionaries(words, words, max_size=2)), max_size=2),
    compression=st.sampled_from(CompressionType),
    chunked=st.booleans(),
)
def test_mcap_to_mcap(tmp_path, channels, messages, attachments, notes, compression, chunked):  # type: ignore[no-untyped-def]
    out = BytesIO()
    writer = Writer(out, chunk_size=60, compression=compression, use_chunking=chunked)
    writer.start(profile="ros2")
    numbers = [
        writer.register_channel(
            topic, encoding, writer.register_schema(*schema) if schema else 0, metadata
        )
        for topic, encoding, schema, metadata in channels
    ]
    for which, log_time, publish_time, sequence, data in messages:
        writer.add_message(numbers[which % len(numbers)], log_time, data, publish_time, sequence)
    for attachment in attachments:
        writer.add_attachment(*attachment)
    for note in notes:
        writer.add_metadata(*note)
    writer.finish()
    (tmp_path / "in.mcap").write_bytes(out.getvalue())
    summary = convert([tmp_path / "in.mcap"], tmp_path / "out.mcap", True, LogConfig())
    assert summary.losses == ()
    assert content((tmp_path / "out.mcap").read_bytes()) == content(out.getvalue())


@needs(SHARED)
def test_real_and_conformance_files(tmp_path):
    files = (
        sorted((SHARED / "mcap-conformance").rglob("*.mcap"))[::13]
        + sorted((SHARED / "rosbag2").glob("*.mcap"))[::4]
    )
    for file in files:
        convert([file], tmp_path / "out.mcap", True, LogConfig())
        # the stock reader relies on a summary that not every file has
        before, after = (
            Counter(m.said for m in sound_messages(path.read_bytes()))
            for path in (file, tmp_path / "out.mcap")
        )
        assert before == after, file


def test_the_frames_of_telemetry_are_kept_and_no_trouble_to_a_reader(tmp_path):
    (tmp_path / "in.tlog").write_bytes(b"".join(tlog(5)))
    convert([tmp_path / "in.tlog"], tmp_path / "out.mcap", False, LogConfig())
    reader = open_log(tmp_path / "out.mcap")
    assert [message.topic for message in reader.messages()] == ["mavlink/1/1/ATTITUDE"] * 5
    report = reader.report()
    assert report.undecodable == {}
    assert report.read == {"mavlink/1/1/ATTITUDE": 5, "mavlink/frames": 5}
    kept = [each.said for each in sound_messages((tmp_path / "out.mcap").read_bytes())]
    stamped = [
        (time // 1000).to_bytes(8, "big") + frame
        for topic, time, _, _, frame in kept
        if topic == "mavlink/frames"
    ]
    assert stamped == tlog(5)


@pytest.mark.parametrize("part", [0.3, 0.6, 0.97])
def test_a_damaged_log_becomes_a_sound_one(tmp_path, part):
    whole = json_mcap(range(200), CompressionType.ZSTD)
    (tmp_path / "cut.mcap").write_bytes(whole[: int(part * len(whole))])
    summary = convert([tmp_path / "cut.mcap"], tmp_path / "out.mcap", False, LogConfig())
    assert summary.losses
    reader = open_log(tmp_path / "out.mcap")
    assert [message.payload["n"] for message in reader.messages()] == list(
        range(sum(summary.messages.values()))
    )
    assert reader.report().losses == ()


def test_a_damaged_attachment_is_left_out_and_said(tmp_path):
    out = BytesIO()
    writer = Writer(out, index_types=IndexType.ALL)
    writer.start()
    writer.add_attachment(1, 2, "kept", "text/plain", b"sound")
    writer.add_attachment(1, 2, "spoiled", "text/plain", b"brittle")
    writer.add_metadata("note", {"a": "b"})
    writer.finish()
    (tmp_path / "in.mcap").write_bytes(out.getvalue().replace(b"brittle", b"brittla"))
    summary = convert([tmp_path / "in.mcap"], tmp_path / "out.mcap", False, LogConfig())
    assert [loss.what.split(":")[0] for _, loss in summary.losses] == [
        "an attachment or metadata record is damaged and excluded"
    ]
    _, attached, noted, _ = content((tmp_path / "out.mcap").read_bytes())
    assert [name for name, *_ in attached] == ["kept"]
    assert [name for name, _ in noted] == ["note"]


def test_late_messages_are_copied_too(tmp_path):
    stamps = [k * 10**9 for k in (1, 50, 60, 2, 70)]
    (tmp_path / "in.mcap").write_bytes(json_mcap(stamps))
    convert([tmp_path / "in.mcap"], tmp_path / "out.mcap", False, LogConfig())
    read = open_log(tmp_path / "out.mcap").messages()
    assert sorted(message.payload["n"] for message in read) == list(range(5))


def test_what_does_not_read_back_gets_no_name(tmp_path, monkeypatch):
    (tmp_path / "in.mcap").write_bytes(json_mcap(range(5)))
    monkeypatch.setattr("replay_kit.logs.mcap.writer.McapLogWriter.written", {"/a": 9})
    with pytest.raises(ReplayKitError, match="read back"):
        convert([tmp_path / "in.mcap"], tmp_path / "out.mcap", False, LogConfig())
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["in.mcap", "out.mcap.part"]
