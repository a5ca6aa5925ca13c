"""The file of a result: whole and under its name, or a readable part."""

import io
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit import open_result
from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError, ForecastError, LogError, ReplayKitError
from replay_kit.core.grid import Projection
from replay_kit.logs import open_log
from replay_kit.results import CONTRACT_VERSION, ResultReader, ResultWriter
from replay_kit.results.mcap import file as mcap_file
from replay_kit.results.mcap.topics import check_written, message_counts
from replay_kit.show.notebook import read_result
from replay_kit.workflows.convert import convert
from tests.places import SAMPLES
from tests.results.result_samples import CONFIG, DEPTHS, METADATA, decoded


def test_records_and_attachments(run, flow, tmp_path):
    path = run(tmp_path / "out.mcap")
    assert run(tmp_path / "two.mcap").read_bytes() == path.read_bytes()
    reader = ResultReader(path)
    assert reader.metadata["inputs"] == METADATA["inputs"]
    assert reader.metadata["contract"]["version"] == str(CONTRACT_VERSION)
    assert float(reader.metadata["frame map"]["latitude"]) == 62.0
    assert reader.text("config.toml") == CONFIG
    estimate = reader.estimate()
    np.testing.assert_allclose(estimate.unknowns.p, flow.unknowns.p, atol=1e-6)
    np.testing.assert_array_equal(estimate.latent, flow.latent)


def names(folder):
    return [item.name for item in folder.iterdir()]


def test_an_interrupt_leaves_a_readable_part(flow, state, tmp_path):
    path = tmp_path / "out.mcap"

    def interrupted() -> None:
        with ResultWriter(path) as writer:
            writer.start(flow.grid.projection, state.time_ns, METADATA, CONFIG)
            writer.fix(state)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(tmp_path) == ["out.mcap.part"]
    assert len(decoded(tmp_path / "out.mcap.part")["/vehicle/fix"]) == 1
    writer = ResultWriter(path)
    with pytest.raises(ReplayKitError, match="1970 to 2106"):
        writer.fix(replace(state, time_ns=-1))
    writer.discard()
    assert names(tmp_path) == []


def test_a_result_that_is_there_stays(state, tmp_path):
    path = tmp_path / "out.mcap"
    writer = ResultWriter(path)
    writer.fix(state)
    path.write_bytes(b"precious")
    for refused in (writer.close, lambda: ResultWriter(path)):
        with pytest.raises(ConfigError, match="exists already"):
            refused()
        assert path.read_bytes() == b"precious"
    with ResultWriter(path, overwrite=True) as writer:
        writer.fix(state)
        assert path.read_bytes() == b"precious"
    data = path.read_bytes()
    for again in (writer.close, writer.abandon, writer.discard):
        again()
    assert names(tmp_path) == ["out.mcap"]
    assert path.read_bytes() == data


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
def test_full_disk_never_publishes(tmp_path):
    """A process that may write 100 kB a file stands for a full disk."""
    program = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from replay_kit.core.errors import ReplayKitError
from replay_kit.results import ResultWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    with ResultWriter(Path(sys.argv[1])) as writer:
        noise = np.random.default_rng(0).bytes(800_000)
        for step in range(5):
            writer.attach(step, "noise", "", noise)
except ReplayKitError as error:
    print(error)
"""
    command = [sys.executable, "-c", program, os.fspath(tmp_path / "out.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "is the disk full?" in done.stdout
    assert names(tmp_path) == ["out.mcap.part"]


def test_all_is_on_the_disk_before_a_result_gets_its_name(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(
        mcap_file.os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_size)
    )
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.log(1, "info", "said")
    assert (tmp_path / "out.mcap").stat().st_size in synced


def test_a_written_file_is_known_by_any_byte_and_by_what_it_states(run, tmp_path):
    path = run(tmp_path / "out.mcap")
    data = path.read_bytes()
    summary = make_reader(io.BytesIO(data)).get_summary()
    topics, attached = message_counts(summary), summary.statistics.attachment_count
    assert topics["/vehicle/fix"] == 300
    check_written(path, topics, attached)
    for stated in ((topics | {"/a": 1}, attached), (topics, attached + 1)):
        with pytest.raises(ReplayKitError, match=f"read back {topics.total()} and {attached}"):
            check_written(path, *stated)
    flipped = np.random.default_rng(0).integers(0, len(data), 40).tolist()
    for place in flipped:
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :])
        with pytest.raises(ReplayKitError, match=r"does not read back; is the disk full\?"):
            check_written(path, topics, attached)
    for size in (0, 7, len(data) // 2, len(data) - 60, len(data) - 9, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(ReplayKitError, match="does not read back"):
            check_written(path, topics, attached)


def of_the_first_version(path, run):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("replay_kit.results.mcap.writer.CONTRACT_VERSION", 3)
        with ResultWriter(path) as writer:
            writer.start(Projection(5.0, 62.0), 10**18, {}, "")


def of_a_log(path, run):
    with ResultWriter(path) as writer:
        writer.log(1, "info", "a log of somebody")


def cut_at(end):
    return lambda path, run: path.write_bytes(run(path).read_bytes()[:end])


BROKEN = {
    "none": (lambda path, run: None, "cannot read the result: No such file"),
    "a forecast": (
        lambda path, run: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(90)),
        r"out\.mcap: expected a result .*, got a file that is no MCAP; give the file of --out",
    ),
    "no bytes": (cut_at(0), r"expected a complete result of replay-kit replay"),
    "cut early": (
        cut_at(200),
        r"expected a complete result of replay-kit replay.*convert recovers",
    ),
    "cut late": (
        cut_at(-300),
        r"expected a complete result of replay-kit replay.*convert recovers",
    ),
    "a log": (of_a_log, r"no metadata record 'contract'.*open a log with open_log"),
    "version 3": (of_the_first_version, r"out\.mcap: expected .* got one of contract version 3"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_whole_result_is_refused_by_name(name, run, tmp_path):
    (make, said), path = BROKEN[name], tmp_path / "out.mcap"
    make(path, run)
    with pytest.raises(LogError, match=said):
        read_result(path)
    if name == "cut late":
        with pytest.warns(UserWarning, match=r"LOST: out\.mcap: cut inside a record"):
            assert len(open_result(path).fixes) == 300
    elif name == "a log":
        with pytest.raises(ForecastError, match=r"carries no estimate\.npz"):
            ResultReader(path).estimate()


def test_a_result_that_a_log_was_merged_into_is_refused_in_words(state, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.fix(state)
    logs = [SAMPLES / "survey.mcap", tmp_path / "out.mcap"]
    convert(logs, tmp_path / "both.mcap", False, LogConfig())
    with pytest.raises(LogError, match="expected protobuf on /vehicle/fix, got jsonschema"):
        ResultReader(tmp_path / "both.mcap").decoded("/vehicle/fix")


def test_convert_has_back_what_was_written_before_a_power_cut(flow, state, innovation, tmp_path):
    writer = ResultWriter(tmp_path / "out.mcap")
    writer.start(flow.grid.projection, state.time_ns, METADATA, CONFIG)
    for _ in range(20):
        writer.fix(state)
        writer.innovations([innovation])
    writer.grids(state.time_ns, flow, DEPTHS)
    # after the last checkpoint: in the writer's memory only, and lost
    writer.fix(state)
    (tmp_path / "left.mcap.part").write_bytes(writer.part.read_bytes())
    writer.discard()
    summary = convert([tmp_path / "left.mcap.part"], tmp_path / "mended.mcap", False, LogConfig())
    assert summary.messages["/vehicle/fix"] == summary.messages["/flow/innovation"] == 20
    assert [loss.messages for _, loss in summary.losses] == [None]
    reader = open_log(tmp_path / "mended.mcap")
    list(reader.messages())
    assert reader.report().losses == ()
