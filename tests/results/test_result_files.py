import io
import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit.core.errors import ConfigError, ForecastError, LogError, ReplayKitError
from replay_kit.core.flow.compact import unpack
from replay_kit.core.grid import Projection
from replay_kit.results import CONTRACT_VERSION, ResultReader, ResultWriter, mcap_file
from replay_kit.results.result import result_path
from replay_kit.results.topics import check_written
from tests.results.result_samples import CONFIG, METADATA, decoded


def test_records_and_attachments(run, flow, tmp_path):
    path = run(tmp_path / "out.mcap")
    with path.open("rb") as file:
        reader = make_reader(file)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record for record in reader.iter_attachments()}
    assert metadata["inputs"] == METADATA["inputs"]
    assert metadata["contract"]["version"] == str(CONTRACT_VERSION)
    assert float(metadata["frame map"]["latitude"]) == 62.0
    assert attachments["config.toml"].data.decode() == CONFIG
    for estimate in (
        unpack(attachments["estimate.npz"].data, "attachment"),
        ResultReader(path).estimate(),
    ):
        np.testing.assert_allclose(estimate.unknowns.p, flow.unknowns.p, atol=1e-6)
        np.testing.assert_array_equal(estimate.latent, flow.latent)


def test_log_levels(tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        for level in ("debug", "info", "warning", "error"):
            writer.log(1, level, f"said {level}")
    assert [
        (value.level, value.message) for _, value in decoded(tmp_path / "out.mcap")["/log"]
    ] == [
        (1, "said debug"),
        (2, "said info"),
        (3, "said warning"),
        (4, "said error"),
    ]


def test_two_runs_give_the_same_bytes(run, tmp_path):
    assert run(tmp_path / "one.mcap").read_bytes() == run(tmp_path / "two.mcap").read_bytes()


def test_an_interrupt_leaves_a_readable_part(flow, state, tmp_path):
    path = tmp_path / "out.mcap"

    def interrupted() -> None:
        with ResultWriter(path) as writer:
            writer.start(flow.grid.projection, state.time_ns, METADATA, CONFIG)
            writer.fix(state)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [item.name for item in tmp_path.iterdir()] == ["out.mcap.part"]
    assert len(decoded(tmp_path / "out.mcap.part")["/vehicle/fix"]) == 1
    with ResultWriter(path) as writer:
        writer.fix(state)
    assert [item.name for item in tmp_path.iterdir()] == ["out.mcap"]


def test_discard_leaves_nothing(state, tmp_path):
    writer = ResultWriter(tmp_path / "out.mcap")
    writer.fix(state)
    writer.discard()
    assert not list(tmp_path.iterdir())


def test_a_published_result_stays(state, tmp_path):
    writer = ResultWriter(tmp_path / "out.mcap")
    writer.fix(state)
    writer.close()
    data = writer.path.read_bytes()
    for again in (writer.close, writer.abandon, writer.discard):
        again()
    assert [item.name for item in tmp_path.iterdir()] == ["out.mcap"]
    assert writer.path.read_bytes() == data


def test_existing_result_is_kept_unless_told(state, tmp_path):
    path = tmp_path / "out.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(ConfigError, match="exists already"):
        ResultWriter(path)
    assert path.read_bytes() == b"precious"
    assert len(list(tmp_path.iterdir())) == 1
    with ResultWriter(path, overwrite=True) as writer:
        writer.fix(state)
        assert path.read_bytes() == b"precious"
    assert len(decoded(path)["/vehicle/fix"]) == 1


def test_result_that_appears_meanwhile_is_kept(state, tmp_path):
    path = tmp_path / "out.mcap"
    writer = ResultWriter(path)
    writer.fix(state)
    path.write_bytes(b"precious")
    with pytest.raises(ConfigError, match="exists already"):
        writer.close()
    assert path.read_bytes() == b"precious"


def test_time_that_cannot_be_written_is_said(state, tmp_path):
    writer = ResultWriter(tmp_path / "out.mcap")
    with pytest.raises(ReplayKitError, match="1970 to 2106"):
        writer.fix(replace(state, time_ns=-1))
    writer.abandon()


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
    done = subprocess.run(
        [sys.executable, "-c", program, os.fspath(tmp_path / "out.mcap")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "is the disk full?" in done.stdout
    assert [item.name for item in tmp_path.iterdir()] == ["out.mcap.part"]


def test_estimate_of_other_files_is_refused(state, tmp_path):
    path = tmp_path / "out.mcap"
    with pytest.raises(LogError, match="cannot read"):
        ResultReader(path).estimate()
    with ResultWriter(path) as writer:
        writer.fix(state)
    with pytest.raises(ForecastError, match=r"carries no estimate\.npz"):
        ResultReader(path).estimate()
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(LogError, match="expected a complete result"):
        ResultReader(path).estimate()


def test_read_back_finds_a_flip_of_any_byte_and_any_missing_end(run, tmp_path):
    path = run(tmp_path / "out.mcap")
    data = path.read_bytes()
    reader = make_reader(io.BytesIO(data))
    topics = Counter(channel.topic for _, channel, _ in reader.iter_messages())
    attached = len(list(reader.iter_attachments()))
    assert attached > 0
    check_written(path, topics, attached)
    for missing in (1, 8, 9, 60, len(data) // 2):
        path.write_bytes(data[:-missing])
        with pytest.raises(ReplayKitError, match=r"does not read back; is the disk full\?"):
            check_written(path, topics, attached)
    for place in np.random.default_rng(0).integers(8, len(data), 40).tolist():
        spoilt = bytearray(data)
        spoilt[place] ^= 0x10
        path.write_bytes(spoilt)
        with pytest.raises(ReplayKitError, match="read back"):
            check_written(path, topics, attached)
    path.write_bytes(data)
    for messages, attachments in ((topics | {"/a": 1}, attached), (topics, attached + 1)):
        with pytest.raises(
            ReplayKitError,
            match=f"but read back {topics.total()} and {attached}",
        ):
            check_written(path, messages, attachments)


def test_all_is_on_the_disk_before_a_result_gets_its_name(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(
        mcap_file.os, "fsync", lambda descriptor: synced.append(os.fstat(descriptor).st_size)
    )
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.log(1, "info", "said")
    assert (tmp_path / "out.mcap").stat().st_size in synced


def test_a_result_of_the_first_version_is_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr("replay_kit.results.mcap_writer.CONTRACT_VERSION", 3)
    with ResultWriter(tmp_path / "old.mcap") as writer:
        writer.start(Projection(5.0, 62.0), 10**18, {}, "")
    with pytest.raises(LogError, match=r"old\.mcap: expected .* got one of contract version 3"):
        result_path(tmp_path / "old.mcap")
