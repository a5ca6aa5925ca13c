"""The beginning of a checkpoint: what must be known before the estimator is built that its states belong to."""

import json
from pathlib import Path

from replay_kit.workflows.replay.region import FoundRegion, from_record

#: Begins the file; then a line with the part of the forecast that was found, the run's identity, the SHA-256 of the rest, and the rest.
MAGIC = b"replay-kit checkpoint 7\n"
# A line is no longer.
_LONGEST = 1 << 16


def checkpoint_files(path: Path | None) -> tuple[Path, ...]:
    """Return the files of a checkpoint: the checkpoint itself, and the journal beside it."""
    return () if path is None else (path, path.with_name(path.name + ".journal"))


def head(region: FoundRegion | None) -> bytes:
    """Return the first bytes of a checkpoint, before the run's identity."""
    return MAGIC + json.dumps(None if region is None else region.to_record()).encode() + b"\n"


def recorded_region(path: Path | None) -> FoundRegion | None:
    """Return the part of the forecast that a checkpoint's run found; None without a checkpoint, or where it found none.

    What cannot be read is None too: the checkpoint's own reading says what is wrong with it.
    """
    try:
        if path is None:
            return None
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return None
            record = json.loads(file.readline(_LONGEST))
        return None if record is None else from_record(record)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
