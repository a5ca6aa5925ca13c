"""How large an array may be that a small file claims: values that were never written, or that are all the same, take no bytes in it."""

import os
from pathlib import Path

#: What any file may claim [bytes], and for each byte that it has: the shared forecasts have five to twelve.
_FREE, _RATIO = 1 << 25, 100


def exceeds_claim(path: Path, size: int) -> str:
    """Return why arrays of that many bytes cannot be what a file is meant to hold; empty where they can.

    Args:
        path: The file, or the folder of a store.
        size: What its arrays take in memory [bytes].
    """
    needed = (size - _FREE) / _RATIO
    if needed <= 0.0 or (held := _bytes(path, needed)) >= needed:
        return ""
    return f"it claims {size / 1e6:.0f} MB of values in a file of {held / 1e6:.3f} MB, more than {_RATIO} times its bytes"


def _bytes(path: str | os.PathLike[str], enough: float) -> int:
    """Return the bytes of a file, or of the files below a folder, of which no more are counted than are enough."""
    if not os.path.isdir(path):
        return os.path.getsize(path)
    total = 0
    with os.scandir(path) as entries:
        for entry in entries:
            total += _bytes(entry.path, enough - total)
            if total >= enough:
                break
    return total
