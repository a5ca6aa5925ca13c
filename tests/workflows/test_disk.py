"""Disks that fill, folders that cannot be written, and inputs that change while they are read: told, and nothing is lost."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from replay_kit.config.run import LogConfig, OutputConfig, RunConfig
from replay_kit.core.errors import ConfigError, LogError, ReplayKitError
from replay_kit.core.files.inputs import check_unchanged, stamps_of
from replay_kit.core.flow.dataset import write_grid
from replay_kit.logs import reader
from replay_kit.workflows.convert import convert
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from tests.command import invoke
from tests.planners.flow_samples import eddying_flow
from tests.workflows.replay.interrupted import QUICK, make_ocean

if sys.platform == "win32":
    pytest.skip("file size limits are POSIX", allow_module_level=True)

from tests.workflows.disk import full_disk

CONFIG = RunConfig(estimator=QUICK, output=OutputConfig(checkpoint_interval=600.0, interval=7200.0))
PRECIOUS = b"an earlier result"
SETTINGS = "[output]\ncheckpoint_interval = 600.0\ninterval = 7200.0\n[estimator]\nmodes = 6\nsample_share = 0.5\nshift_distance = 0.0\n"


@pytest.fixture(scope="module")
def ocean(tmp_path_factory) -> Path:
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), CONFIG, 30)
    (folder / "run.toml").write_text(SETTINGS)
    assert invoke(replaying(folder, folder / "whole.mcap")).exit_code in (0, 6)
    eddying_flow(12).save(folder / "flow.nc")
    return folder


def replaying(ocean, out):
    return f"replay {ocean}/glider.mcap --ensemble {ocean}/ensemble.nc --config {ocean}/run.toml -o {out}"


def commands(ocean, out):
    """A line, the file that is written, and how much of it fits on the disk [bytes]."""
    shown = {"report": ".html"} | {name: name.split()[1] for name in EXPORTS}
    result, table, picture = (
        ocean / "whole.mcap",
        *(out.with_suffix(ending) for ending in (".json", ".png")),
    )
    places = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0 --depth=390"
    return {
        **{
            name: (f"{name.split()[0]} {result} -o {to}", to, 100)
            for name, ending in shown.items()
            for to in (out.with_suffix(ending),)
        },
        "plot": (f"plot {result} map -o {picture}", picture, 100),
        "plan": (f"plan {ocean}/flow.nc {places} -o {out}", out, 3_000),
        "convert": (f"convert {ocean}/glider.mcap -o {out}", out, 20_000),
        "replay": (replaying(ocean, out), out, 20_000),
        "checkpoint": (
            f"{replaying(ocean, out)} --checkpoint {out.with_suffix('.ck')}",
            out,
            3_000,
        ),
        "json": (f"info {ocean}/glider.mcap --json {table}", table, 10),
    }


NAMES = ["convert", "replay", "checkpoint", "json"]
EXPORTS = ["export .nc", "export .csv", "export .kml", "export .geojson"]


@pytest.mark.parametrize("name", [*NAMES, "report", "plot", *EXPORTS, "plan"])
def test_a_disk_that_fills_is_told_and_the_earlier_output_stays(ocean, tmp_path, name):
    line, out, size = commands(ocean, tmp_path / "out.mcap")[name]
    out.write_bytes(PRECIOUS)
    with full_disk(size):
        done = invoke(f"{line} --overwrite")
    assert done.exit_code == 1, done.output
    assert "is the disk full?" in done.stderr
    assert f"{out}.part" in done.stderr or ".ck" in done.stderr
    assert out.read_bytes() == PRECIOUS
    # of a result what was written is kept, and named
    assert out.with_name(f"{out.name}.part").exists() == (name in ("replay", "checkpoint", "plan"))


def test_a_grid_that_does_not_fit_leaves_the_earlier_one(tmp_path):
    flow, out = eddying_flow(12), tmp_path / "grid.nc"
    out.write_bytes(PRECIOUS)
    with (
        full_disk(3000),
        pytest.raises(
            ReplayKitError, match=r"grid\.nc\.part: cannot be written.*is the disk full\?"
        ) as raised,
    ):
        write_grid(flow, out)
    assert raised.value.exit_code == 1
    assert out.read_bytes() == PRECIOUS
    with pytest.raises(ConfigError, match="cannot be written"):
        write_grid(flow, tmp_path / "absent" / "grid.nc")


@pytest.mark.skipif(
    not Path("/proc").is_dir(), reason="the folder that nobody can write to is Linux's"
)
@pytest.mark.parametrize("name", NAMES)
def test_a_folder_that_cannot_be_written_is_told(ocean, name):
    arguments, out, _ = commands(ocean, Path("/proc/out.mcap"))[name]
    done = invoke(arguments)
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
changes = pytest.mark.parametrize(
    ("change", "words"), CHANGES.items(), ids=["grow", "shrink", "overwrite", "exchange", "unlink"]
)


class Changing:
    """Progress that changes a file once, when a stage is seen."""

    def __init__(self, stage, change, path):
        self.stage, self.change, self.path, self.done = stage, change, path, False

    def __call__(self, done, total, what):
        if not self.done and what.startswith(self.stage):
            self.done = True
            self.change(self.path)


@changes
def test_a_change_of_a_file_is_named(tmp_path, change, words):
    path = tmp_path / "log"
    path.write_bytes(bytes(100))
    before = stamps_of([path, tmp_path, tmp_path / "absent"])
    assert set(before) == {path}
    check_unchanged(before)
    change(path)
    with pytest.raises(LogError, match=words) as raised:
        check_unchanged(before)
    assert str(path) in str(raised.value)
    assert raised.value.exit_code == 3


@pytest.mark.parametrize("change", [grow, Path.unlink])
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
        with pytest.raises(LogError, match=CHANGES[change]):
            work(changing)
        assert changing.done
        assert out.read_bytes() == PRECIOUS


@pytest.mark.parametrize(
    ("change", "which"),
    [
        (grow, "glider.mcap"),
        (shrink, "glider.mcap"),
        (grow, "ensemble.nc"),
        (Path.unlink, "ensemble.nc"),
    ],
)
def test_a_replay_tells_of_an_input_that_changes_and_keeps_the_earlier_output(
    ocean, tmp_path, change, which, monkeypatch
):
    monkeypatch.setattr(reader, "_LOOK", 4)
    for name in ("glider.mcap", "ensemble.nc"):
        shutil.copy2(ocean / name, tmp_path / name)
    out = tmp_path / "out.mcap"
    out.write_bytes(PRECIOUS)
    changing = Changing("replaying", change, tmp_path / which)
    job = ReplayJob((tmp_path / "glider.mcap",), tmp_path / "ensemble.nc", out, overwrite=True)
    with pytest.raises(LogError, match=CHANGES[change]):
        replay(job, CONFIG, progress=changing)
    assert changing.done
    assert {path.name for path in tmp_path.glob("out*")} == {"out.mcap"}
    assert out.read_bytes() == PRECIOUS
    if (change, which) == (grow, "glider.mcap"):
        replay(replace(job, logs=(ocean / "glider.mcap",), ensemble=ocean / "ensemble.nc"), CONFIG)
        assert out.read_bytes() != PRECIOUS
