"""Checkpoints whose checksum is right and whose contents no run has left."""

import pickle
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from replay_kit.core.sealed import read_store, write_store
from replay_kit.workflows.replay.store.checkpoint import Checkpoint, StateStore, resuming

from replay_kit.config.run import EstimatorConfig, OutputConfig, RunConfig
from replay_kit.core.errors import ConfigError, LogError
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.inputs.region import CHECKPOINT
from replay_kit.workflows.replay.replay import replay
from tests.workflows.replay.interrupted import Killed, make_ocean, run_until

IDENTITY = "0" * 64
CONFIG = RunConfig(
    output=OutputConfig(checkpoint_interval=600.0), estimator=EstimatorConfig(modes=2)
)


def write(path: Path, body: bytes, identity: str = IDENTITY) -> None:
    write_store(path, CHECKPOINT, {"run": identity, "region": None}, [body])


def read(path: Path, identity: str = IDENTITY) -> Checkpoint:
    return StateStore(path, identity).read_state(path)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"", "pickle exhausted before seeing STOP"),
        (b"\x80\x05\x95" + b"\xff" * 8, "pickle exhausted before seeing STOP"),
        # a place in the memo that would take 32 GB
        (
            b"\x80\x05Nr" + struct.pack("<I", 2**31 - 1) + b".",
            "it holds LONG_BINPUT, which no checkpoint does",
        ),
        (b"\x80\x05\x96" + struct.pack("<Q", 2**40) + b".", "expected 1099511627776 bytes"),
        (b"cos\nsystem\n(S'true'\ntR.", "it holds GLOBAL, which no checkpoint does"),
        (pickle.dumps([1, 2], 5), "expected a checkpoint, got list"),
        (pickle.dumps(Checkpoint(None, None, 0, (0, 0), (0, None)), 5), "AttributeError"),
        (pickle.dumps(Checkpoint("state", 3, None, (0, 0), (0, None)), 5), "AttributeError"),
    ],
)
def test_contents_that_are_no_checkpoint_are_refused(tmp_path, body, words):
    write(tmp_path / "run.ck", body)
    with pytest.raises(
        LogError, match=f"the checkpoint cannot be used: .*{words}.*; delete it to begin anew"
    ):
        read(tmp_path / "run.ck")


def test_a_checkpoint_with_parts_of_other_kinds_ends_the_run_with_its_name(tmp_path):
    make_ocean(tmp_path, CONFIG, 30)
    job = ReplayJob(
        (tmp_path / "glider.mcap",),
        tmp_path / "ensemble.nc",
        tmp_path / "out.mcap",
        checkpoint=tmp_path / "run.ck",
        overwrite=True,
    )
    with pytest.raises(Killed):
        run_until(job, CONFIG, 40)
    identity = read_store(tmp_path / "run.ck", CHECKPOINT)[0]["run"]
    checkpoint = read(tmp_path / "run.ck", identity)
    estimation = replace(checkpoint.state.estimation, current=None)
    for wrong in (
        replace(checkpoint, messages="many"),
        replace(checkpoint, measurement=None),
        replace(checkpoint, state=replace(checkpoint.state, estimation=estimation)),
        replace(checkpoint, state=replace(checkpoint.state, statistics=None)),
    ):
        write(tmp_path / "run.ck", pickle.dumps(wrong, 5), identity)
        with pytest.raises(
            LogError,
            match=r"run\.ck: the checkpoint cannot be used: \w+Error: .*; delete it to begin anew",
        ):
            replay(job, CONFIG)


def test_errors_of_a_run_that_began_anew_stay_what_they_are(tmp_path):
    for path in (None, tmp_path / "absent.ck"):
        with pytest.raises(ZeroDivisionError), resuming(path):
            raise ZeroDivisionError
    (tmp_path / "run.ck").touch()
    with pytest.raises(ConfigError), resuming(tmp_path / "run.ck"):
        raise ConfigError("of an option")
    with (
        pytest.raises(LogError, match="ZeroDivisionError: of nought"),
        resuming(tmp_path / "run.ck"),
    ):
        raise ZeroDivisionError("of nought")
