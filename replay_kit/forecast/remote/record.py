"""Where a forecast that was fetched came from: a record in its file, which every result that used it repeats."""

import json
from pathlib import Path
from typing import Any

import h5py

#: Attribute of a file that was cut from a forecast on a server: where it came from, as JSON.
RECORD = "replay_kit_fetched"
#: Folder of fetched forecasts, where the settings state none.
CACHE = Path.home() / ".cache" / "replay-kit"


def record_of(path: Path) -> dict[str, Any] | None:
    """Return where a file was fetched from, when, and what of it; None for a file that was not."""
    try:
        with path.open("rb") as stream:
            if stream.read(4)[1:] != b"HDF":
                return None
        with h5py.File(path, "r") as file:
            text = file.attrs.get(RECORD)
        found = None if text is None else json.loads(text)
        return found if isinstance(found, dict) else None
    except (OSError, ValueError, RuntimeError, TypeError):
        return None
