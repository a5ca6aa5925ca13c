"""Whether files stay as they are while a run reads them, some of them more than once."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from replay_kit.core.errors import LogError

#: Device, number on it, size [bytes], time of the last change [ns].
Stamp = tuple[int, int, int, int]


def stamps_of(paths: Iterable[Path]) -> dict[Path, Stamp]:
    """Return what tells each file from a changed one; folders, and names that are no file, are left out."""
    return {path: _stamp(path.stat()) for path in paths if path.is_file()}


def check_unchanged(before: Mapping[Path, Stamp], may_grow: bool = False) -> None:
    """Raise LogError when a file is no longer what it was.

    Args:
        before: What ``stamps_of`` returned before the files were read.
        may_grow: Whether a file may have become longer, as a log that is being recorded.
    """
    for path, stamp in before.items():
        if not path.is_file():
            raise LogError(
                f"{path}: expected to stay as it was while it is read, but it is gone; keep it until the run ends, and run again"
            )
        now = _stamp(path.stat())
        if now == stamp or (may_grow and now[:2] == stamp[:2] and now[2] > stamp[2]):
            continue
        if now[:2] != stamp[:2]:
            what = "was replaced by another file"
        elif now[2] != stamp[2]:
            what = f"{'grew' if now[2] > stamp[2] else 'shrank'} from {stamp[2]} to {now[2]} bytes"
        else:
            what = "was written to"
        raise LogError(
            f"{path}: expected to stay as it was while it is read, but it {what}; "
            "if it is still being recorded, give a copy of it, and run again"
        )


def _stamp(status: os.stat_result) -> Stamp:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
