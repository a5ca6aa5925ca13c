"""Inputs copied beside the results, and what an interrupted run leaves."""

from collections import Counter
from pathlib import Path

import pytest

from replay_kit.config.run import LogConfig
from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.results import ResultWriter
from replay_kit.workflows.replay.inputs.job import ReplayJob, copy_inputs
from tests.fuzz.damage import sound_messages
from tests.logs.log_samples import json_mcap, tlog
from tests.places import SAMPLES


def copied(out, *logs, asked=True, fix=None):
    """Write a result of a fix and copied logs, and return its bytes."""
    with ResultWriter(out) as writer:
        if fix is not None:
            writer.fix(fix)
        copy_inputs(writer, ReplayJob(logs, Path("e.nc"), include_inputs=asked), LogConfig())
    return out.read_bytes()


@pytest.mark.parametrize("name", ["glider.mcap", "survey.mcap"])
def test_the_inputs_messages_are_copied_untouched(state, tmp_path, name):
    data = copied(tmp_path / "out.mcap", SAMPLES / name, fix=state)
    found = Counter(
        message.said for message in sound_messages(data) if message.said[1] != state.time_ns
    )
    given = Counter(message.said for message in sound_messages((SAMPLES / name).read_bytes()))
    # a fix of the log goes beside the result's own fixes
    assert found == Counter(
        {
            (topic.replace("/vehicle/fix", "/input/vehicle/fix"), *rest): n
            for (topic, *rest), n in given.items()
        }
    )
    assert found.total() > 400


def test_publish_times_and_sequences_stay_and_logs_stay_apart(tmp_path):
    (tmp_path / "a.mcap").write_bytes(json_mcap([5, 3, 8]))
    (tmp_path / "b.tlog").write_bytes(b"".join(tlog(3)))
    logs = (tmp_path / "a.mcap", tmp_path / "b.tlog", tmp_path / "a.mcap")
    data = copied(tmp_path / "out.mcap", *logs)
    said = [message.said for message in sound_messages(data)]
    assert [
        (topic, time, publish, sequence)
        for topic, time, publish, sequence, _ in said
        if topic in ("/a", "/b")
    ] == [("/a", 5, 12, 0), ("/b", 3, 10, 1), ("/a", 8, 15, 2)] * 2
    frames = [payload for topic, *_, payload in said if topic == "mavlink/frames/1"]
    assert frames == [entry[8:] for entry in tlog(3)]


def test_only_topics_of_the_results_own_are_moved(tmp_path):
    topics = [
        "/tf",
        "/tf_static",
        "/log",
        "/logger/a",
        "/vehicle/fix",
        "/vehicle/fix2",
        "/flow/a",
        "/flowmeter",
        "/plan/b",
    ]
    write_mcap_log(
        tmp_path / "in.mcap",
        [Message(k, topic, "", {"k": k}, 0, k) for k, topic in enumerate(topics)],
    )
    data = copied(tmp_path / "out.mcap", tmp_path / "in.mcap")
    kept = {"/tf_static", "/logger/a", "/vehicle/fix2", "/flowmeter"}
    written = {message.said[0] for message in sound_messages(data)}
    assert written == {topic if topic in kept else f"/input{topic}" for topic in topics}
