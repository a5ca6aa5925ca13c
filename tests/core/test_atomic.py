"""Outputs replace files alone: no device, socket or folder, and nothing that a link at OUT.part names."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import atomic_file, open_part, sync
from replay_kit.core.files.paths import check_paths
from replay_kit.results.mcap.file import ResultFile
from tests.command import invoke


def text(path):
    with atomic_file(path) as file:
        file.write(b"new")


def result(path):
    ResultFile(path, overwrite=True).close()


WRITERS = pytest.mark.parametrize("write", [text, result])


@pytest.fixture
def files(tmp_path):
    """An old file, and the names of an output and its part."""
    (tmp_path / "victim").write_text("old")
    return [tmp_path / name for name in ("victim", "out", "out.part")]


@WRITERS
def test_a_link_in_place_of_the_part_is_not_followed(files, write):
    victim, out, part = files
    part.symlink_to(victim)
    with pytest.raises(ConfigError, match=r"out\.part: is a link"):
        write(out)
    assert victim.read_text() == "old"
    assert not out.exists()


@WRITERS
def test_a_second_name_of_a_file_in_place_of_the_part_keeps_that_file(files, write):
    victim, out, part = files
    os.link(victim, part)
    write(out)
    assert victim.read_text() == "old"
    assert out.stat().st_size > 0


def test_a_link_at_the_outputs_own_name_is_replaced_and_not_followed(files):
    victim, out, _ = files
    out.symlink_to(victim)
    text(out)
    assert (victim.read_text(), out.read_text(), out.is_symlink()) == ("old", "new", False)


@WRITERS
def test_of_two_writers_of_one_output_the_later_says_so_and_changes_nothing(files, write):
    _, out, _ = files
    with atomic_file(out) as first:
        first.write(b"first")
        with pytest.raises(ConfigError, match="out: another process is writing it"):
            write(out)
    assert out.read_bytes() == b"first"
    write(out)
    assert out.read_bytes() != b"first"


def test_a_part_whose_writer_was_killed_is_replaced(files):
    _, out, part = files
    code = (
        "import os, pathlib; from replay_kit.core.files.atomic import open_part; "
        f"open_part(pathlib.Path({str(out)!r})); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    assert part.exists()
    text(out)
    assert out.read_bytes() == b"new"


@WRITERS
def test_devices_folders_pipes_and_sockets_are_not_replaced(tmp_path, monkeypatch, write):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "null").symlink_to("/dev/null")
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(tmp_path)
        server.bind("socket")
        for name in ("pipe", "folder", "null", "socket"):
            with pytest.raises(ConfigError, match=f"{name}: is a folder, device, pipe or socket"):
                write(tmp_path / name)
            assert not (tmp_path / f"{name}.part").exists()
        with pytest.raises(ConfigError, match="socket: is a socket or a disk"):
            check_paths([], [tmp_path / "socket"], overwrite=True)
    for name in ("pipe", "folder"):
        (tmp_path / name).rename(tmp_path / f"{name}.part")
        with pytest.raises(ConfigError, match=rf"{name}\.part: is a link, folder or device"):
            write(tmp_path / name)


@pytest.mark.parametrize("name", ["/dev/null", "/dev/full"])
def test_devices_are_not_replaced_even_by_who_may(tmp_path, name):
    (tmp_path / "log.mcap").write_bytes(b"")
    assert invoke(f"convert {tmp_path}/log.mcap -o {name} --overwrite").exit_code == 2
    with pytest.raises(ConfigError, match=f"{name}: is a folder, device"):
        open_part(Path(name))
    assert Path(name).is_char_device()
    assert not Path(f"{name}.part").exists()


def test_what_was_forced_to_the_disk_is_not_left_open(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    sync(tmp_path)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(*synced)
