"""The dialects of glider files, a file each."""

from collections.abc import Collection, Mapping
from importlib import import_module
from typing import Any

from replay_kit.logs.glider.dialect import Dialect

# In the order in which they are tried: the narrower signature first.
_FILES = (
    "seaglider",
    "midas",
    "slocum",
    "spray",
    "og1",
    "slocum_glide",
    "gliderdac",
    "erddap",
    "pyglider",
    "socib",
    "seaexplorer",
)
#: All dialects, in that order.
DIALECTS: tuple[Dialect, ...] = tuple(
    import_module(f"{__name__}.{name}").DIALECT for name in _FILES
)


def dialect_of(names: Collection[str], attributes: Mapping[str, Any]) -> Dialect | None:
    """Return the dialect of a file with these variables and attributes; None for a file of no known dialect."""
    return next((dialect for dialect in DIALECTS if dialect.recognises(names, attributes)), None)
