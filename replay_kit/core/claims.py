"""How large an array may be that a small file claims: values that were never written, or that are all the same, take no bytes in it."""

from pathlib import Path

#: What any file may claim [bytes], and for each byte that it has: the shared forecasts have five to twelve.
_FREE, _RATIO = 1 << 25, 100


def exceeds_claim(path: Path, size: int) -> str:
    """Return why arrays of that many bytes cannot be what a file is meant to hold; empty where they can, and for a folder.

    Args:
        path: The file.
        size: What its arrays take in memory [bytes].
    """
    if not path.is_file() or size <= _FREE + _RATIO * path.stat().st_size:
        return ""
    return f"it claims {size / 1e6:.0f} MB of values in a file of {path.stat().st_size / 1e6:.3f} MB, more than {_RATIO} times its bytes"
