"""``replay-kit info`` on large logs: the index and first messages, or with --full everything, decoding what can be used."""

import json

import pytest

from replay_kit.config.run import load_config
from replay_kit.logs.mcap import index
from replay_kit.workflows.info.inspect import inspect_logs
from tests.command import invoke, succeed
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping

TOO_MANY = {"profiles", "bins", "mean_currents", "positions", "dives", "box", "depths"}


@pytest.fixture
def log(tmp_path, monkeypatch):
    """A log of 400 fixes, 2 pings and 400 messages of an unknown type, which counts as large; the last of which is late."""
    monkeypatch.setattr(index, "FEW_MESSAGES", 10)
    known = [
        (k, message.topic, message.schema, message.payload)
        for k, message in enumerate((fix(0), ping(1), fix(2), ping(3)))
    ]
    (_, topic, schema, payload) = known[0]
    fixes = [(1000 + k, topic, schema, payload) for k in range(398)]
    other = [(k, "/vendor/text", "vendor.Text", {"n": k}) for k in (*range(399), 50)]
    path = tmp_path / "vendor.mcap"
    path.write_bytes(json_mcap([*known, *fixes, *other]))
    return path


def test_a_large_log_is_described_by_its_index(log):
    found = inspect_logs([log], load_config(None))[0]
    # a hundred of each topic that has so many
    assert found.sampled == 202
    assert {name: topic.messages for name, topic in found.topics.items()} == {
        "/adcp": 2,
        "/vehicle/fix": 400,
        "/vendor/text": 400,
    }
    text = found.topics["/vendor/text"]
    assert (text.schema, text.first_ns, text.last_ns, text.late, text.gap_ns) == (
        "vendor.Text",
        0,
        398 * 10**9,
        None,
        None,
    )
    assert found.report.read["/vendor/text"] == 400
    assert found.use == "ready for replay: positions and current profiles found"


def test_what_the_index_does_not_know_is_said_to_need_full(log):
    done = succeed(f"info {log} --json {log.with_suffix('.json')}")
    assert "Read: the index, and 202 messages" in done.stdout
    assert "--full counts profiles and positions" in done.stdout
    assert "Use, by the messages read: ready for replay" in done.stdout
    assert "usable bins," not in done.stdout
    (answer,) = json.loads(log.with_suffix(".json").read_text())["logs"]
    assert answer["read"] == {"whole": False, "messages": 202}
    assert {key for key in TOO_MANY if answer[key] is None} == TOO_MANY
    assert {topic["late"] for topic in answer["topics"]} == {None}


def test_full_counts_everything_and_decodes_what_can_be_used(log):
    done = invoke(f"info {log} --full --json -")
    (answer,) = json.loads(done.stdout)["logs"]
    assert answer["read"] == {"whole": True, "messages": 802}
    assert (answer["profiles"], answer["positions"]) == (2, 400)
    assert {topic["topic"]: topic["late"] for topic in answer["topics"]} == {
        "/adcp": 0,
        "/vehicle/fix": 0,
        "/vendor/text": 0,
    }
    fixes = next(topic for topic in answer["topics"] if topic["topic"] == "/vehicle/fix")
    assert fixes["longest_gap_s"] == 998.0
    assert "Gap: /vehicle/fix has no message for 998 s from 1970-01-01T00:00:02Z" in done.stderr
    # in the order of its index nothing is late
    assert "Late" not in done.stderr
    # one of them was decoded
    (reason,) = answer["not_used"]["/vendor/text"]
    assert reason["count"] == 400
    assert "--full" not in done.stderr


def test_a_log_that_was_cut_is_read_whole_and_that_is_said(log):
    log.write_bytes(log.read_bytes()[:-40])
    done = invoke(f"info {log}")
    assert done.exit_code == 4
    assert "Note: all of it was read: it has no index, or its end is missing" in done.stdout
    assert "400 positions" in done.stdout
    assert (
        "Late, by more than the reorder window, so excluded from a replay: 400 x /vendor/text"
        in done.stdout
    )
    assert "--full" not in done.stdout
    # asked for, it needs no explanation
    assert "all of it was read" not in invoke(f"info {log} --full").stdout


def test_progress_grows_with_what_is_read(log):
    shares = []
    inspect_logs([log, log], load_config(None), lambda *seen: shares.append(seen), full=True)
    assert {(total, what) for _, total, what in shares} == {(2, f"reading: {log}")}
    done = [done for done, _, _ in shares]
    assert done == sorted(done)
    assert done[0] < 1.0 < done[-1] <= 2.0
