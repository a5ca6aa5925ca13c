"""Disks that fill, folders that cannot be written, and inputs that change while they are read: told, and nothing is lost."""

import os
import shutil
import tomllib
from pathlib import Path

import pytest

from replay_kit.config.run import LogConfig, RunConfig
from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.flow.dataset import write_grid
from replay_kit.logs import reader
from replay_kit.workflows.convert import convert
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.replay.replay import replay
from tests.command import invoke
from tests.planners.flow_samples import eddying_flow
from tests.workflows.disk import full_disk
from tests.workflows.replay.interrupted import job_in

TOML = """
output = { checkpoint_interval = 600.0, interval = 7200.0 }
estimator = { modes = 6, sample_share = 0.5, shift_distance = 0.0 }
"""
CONFIG = RunConfig(**tomllib.loads(TOML))
PRECIOUS = b"an earlier result"


@pytest.fixture(scope="module")
def made(ocean, tmp_path_factory):
    """Settings, a result and an estimate."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "run.toml").write_text(TOML)
    replay(job_in(ocean, folder / "whole.mcap"), CONFIG)
    eddying_flow(12).save(folder / "flow.nc")
    return folder


ENDINGS = ("export .nc", "export .csv", "export .kml", "export .geojson", "report .html")
NAMES = ("convert", "replay", "checkpoint", "json")


def command(ocean, made, out, name):
    """A line, the file that is written, and how much of it fits on the disk [bytes]."""
    replayed = f"replay {ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --config {made}/run.toml"
    places = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0 --depth=390"
    words, _, ending = name.partition(" ")
    out = out.with_suffix(ending or {"plot": ".png", "json": ".json"}.get(name, ".mcap"))
    line, size = {
        "plot": (f"plot {made}/whole.mcap map -o", 100),
        "plan": (f"plan {made}/flow.nc {places} -o", 3_000),
        "convert": (f"convert {ocean}/glider.mcap -o", 20_000),
        "replay": (f"{replayed} -o", 20_000),
        "checkpoint": (f"{replayed} --checkpoint {out.with_suffix('.ck')} -o", 3_000),
        "json": (f"info {ocean}/glider.mcap --json", 10),
    }.get(name, (f"{words} {made}/whole.mcap -o", 100))
    return f"{line} {out}", out, size


@pytest.mark.parametrize("name", [*NAMES, *ENDINGS, "plot", "plan"])
def test_a_disk_that_fills_is_told_and_the_earlier_output_stays(ocean, made, tmp_path, name):
    line, out, size = command(ocean, made, tmp_path / "out", name)
    out.write_bytes(PRECIOUS)
    with full_disk(size):
        done = invoke(f"{line} --overwrite")
    assert done.exit_code == 1, done.output
    assert "is the disk full?" in done.stderr
    assert f"{out}.part" in done.stderr or ".ck" in done.stderr
    assert out.read_bytes() == PRECIOUS
    # of a result what was written is kept, and named
    assert out.with_name(f"{out.name}.part").exists() == (name in ("replay", "checkpoint", "plan"))


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_that_cannot_be_written_is_told(ocean, made, name):
    # of Linux, to which nobody can write
    line, out, _ = command(ocean, made, Path("/proc/out"), name)
    done = invoke(line)
    assert done.exit_code == 2
    assert "/proc/" in done.stderr
    assert "cannot" in done.stderr
    assert not out.exists()


def grow(path):
    with path.open("ab") as file:
        file.write(b"more")


def shrink(path):
    os.truncate(path, path.stat().st_size - 7)


def overwrite(path):
    status = path.stat()
    path.write_bytes(path.read_bytes())
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns + 1))


def exchange(path):
    other = path.with_name("other")
    shutil.copy2(path, other)
    os.replace(other, path)


CHANGES = {
    grow: r"grew from \d+ to \d+ bytes",
    shrink: r"shrank from \d+ to \d+ bytes",
    overwrite: "was written to",
    exchange: "was replaced by another file",
    Path.unlink: "is gone",
}


class Changing:
    """Progress that changes a file once, when a stage is seen."""

    def __init__(self, stage, change, path):
        self.stage, self.change, self.path, self.done = stage, change, path, False

    def __call__(self, done, total, what):
        if not self.done and what.startswith(self.stage):
            self.done = True
            self.change(self.path)


@pytest.mark.parametrize("change", CHANGES)
def test_info_and_convert_tell_of_an_input_that_changes_and_keep_the_earlier_output(
    ocean, tmp_path, change
):
    log, out = tmp_path / "glider.mcap", tmp_path / "out.mcap"
    for stage, work in (
        ("reading", lambda told: inspect_logs([log], CONFIG, told)),
        ("converting", lambda told: convert([log], out, True, LogConfig(), told)),
    ):
        shutil.copy2(ocean / log.name, log)
        out.write_bytes(PRECIOUS)
        changing = Changing(stage, change, log)
        with pytest.raises(LogError, match=f"{log}.*{CHANGES[change]}") as raised:
            work(changing)
        assert (changing.done, raised.value.exit_code) == (True, 3)
        assert out.read_bytes() == PRECIOUS


@pytest.mark.parametrize(("change", "which"), [(grow, "glider.mcap"), (Path.unlink, "ensemble.nc")])
def test_a_replay_tells_of_an_input_that_changes_and_keeps_the_earlier_output(
    ocean, tmp_path, change, which, monkeypatch
):
    monkeypatch.setattr(reader, "_LOOK", 4)
    for name in ("glider.mcap", "ensemble.nc"):
        shutil.copy2(ocean / name, tmp_path / name)
    out = tmp_path / "out.mcap"
    out.write_bytes(PRECIOUS)
    changing = Changing("replaying", change, tmp_path / which)
    with pytest.raises(LogError, match=CHANGES[change]):
        replay(job_in(tmp_path, out), CONFIG, progress=changing)
    assert changing.done
    assert [path.name for path in tmp_path.glob("out*")] == ["out.mcap"]
    assert out.read_bytes() == PRECIOUS


def test_a_grid_that_does_not_fit_leaves_the_earlier_one(tmp_path):
    flow, out = eddying_flow(12), tmp_path / "grid.nc"
    out.write_bytes(PRECIOUS)
    with full_disk(3000), pytest.raises(ReplayKitError, match=r"grid\.nc\.part.*disk full"):
        write_grid(flow, out)
    assert out.read_bytes() == PRECIOUS
