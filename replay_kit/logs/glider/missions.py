"""Which mission a glider file is of, and whether a folder holds one mission: known before the libraries that read such files are loaded."""

import zlib
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from replay_kit.core.errors import LogError
from replay_kit.logs.reader import LogFile

if TYPE_CHECKING:
    from replay_kit.logs.glider.netcdf import NetcdfFile

GZIP_MAGIC = b"\x1f\x8b"
#: Names that the first column of a SeaExplorer's file has.
FIRST_COLUMNS = ("timestamp", "pld_realtimeclock")
#: Variables that name the mission, and attributes that do, with the dialects of which they do; of others ``id`` names the file
MISSION_NAMES = ("trajectory", "mission_name")
_ATTRIBUTES = (("deployment_name", None), ("id", "og1"), ("glider_name", None))


def mission_of(file: "NetcdfFile", dialect: str) -> tuple[str, ...]:
    """Return the names of the missions in a file; none when it does not state them.

    Args:
        file: With the variables ``trajectory`` and ``mission_name``, if it has them.
        dialect: Name of its dialect.
    """
    if dialect == "seaexplorer":
        return (".".join(file.path.name.lower().split(".")[:2]),)
    named = [stored for name, stored in file.variables.items() if name.lower() in MISSION_NAMES]
    stated = tuple(dict.fromkeys(text for stored in named for text in stored.texts() if text))
    if stated:
        return stated
    held = {key.lower(): str(value).strip() for key, value in file.attributes.items()}
    if dialect == "seaglider" and held.get("mission"):
        return (
            f"{held.get('platform_id') or held.get('glider', '')} mission {held['mission']}".strip(),
        )
    found = (held.get(key, "") for key, only in _ATTRIBUTES if only in (None, dialect))
    return tuple(name for name in found if name)[:1]


def require_one_mission(folder: Path, logs: Sequence[LogFile]) -> None:
    """Raise LogError when the logs in a folder are of several missions; logs that do not state theirs belong to any."""
    files: dict[str, list[Path]] = {}
    for log in logs:
        if log.mission:
            files.setdefault(log.mission, []).extend(
                path for path in log.files if path.parent == folder
            )
    held = {mission: paths for mission, paths in files.items() if paths}
    if len(held) < 2:
        return
    each = ", ".join(f"{mission} ({pattern(paths)})" for mission, paths in held.items())
    raise LogError(
        f"{folder}: expected the logs of one mission, the folder holds {len(held)}: {each}; give the files of one of them, such as "
        f"{folder / pattern(next(iter(held.values())))}"
    )


def pattern(paths: Sequence[Path]) -> str:
    """Return the name of one file, or the pattern that the names of several match by their common beginning."""
    letters = takewhile(
        lambda column: len(set(column)) == 1, zip(*(path.name for path in paths), strict=False)
    )
    return paths[0].name if len(paths) == 1 else f"{''.join(column[0] for column in letters)}*"


def is_seaexplorer(head: bytes) -> bool:
    """Return whether a file that begins with these bytes is a SeaExplorer's, compressed or not."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, 256)
        except zlib.error:
            return False
    return head.lstrip(b"\xef\xbb\xbf").split(b";", 1)[0].strip().lower() in {
        name.encode() for name in FIRST_COLUMNS
    }
