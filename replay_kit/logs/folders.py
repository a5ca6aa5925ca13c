"""The logs in a folder: the parts of a ROS 2 bag, a glider's files, or other logs."""

import re
from pathlib import Path

from replay_kit.core.errors import LogError

#: Endings of logs that are written message by message, and may grow while they are read; in lower case.
STREAMS = (".mcap", ".tlog", ".bin", ".pd0", ".enx", ".ens", ".ad2cp", ".000")
_BAG = "metadata.yaml"
_PART = re.compile(r"^\s*-\s+[\"']?([^\s\"':]+\.(?:mcap|db3)(?:\.zstd)?)[\"']?\s*$", re.MULTILINE)
_GLIDER = re.compile(
    r".*\.(nc|nc4|cdf)|.*\.(gli|pld1)\.(sub|raw|all)(\.\d+)?(\.gz)?|.*\.(gli|pld1)(\.\d+)?(\.gz)?",
    re.IGNORECASE,
)


def logs_in(path: Path) -> list[Path]:
    """Return the logs that a name stands for: the file itself; of a folder the parts of its ROS 2 bag, or the logs in it.

    Raises:
        LogError: The folder holds none.
    """
    if not path.is_dir():
        return [path]
    if (path / _BAG).is_file():
        return _bag(path)
    held = sorted(
        file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")
    )
    # SeaExplorer numbers its files without leading zeros
    gliders = sorted(
        (file for file in held if _GLIDER.fullmatch(file.name)),
        key=lambda file: [*map(int, re.findall(r"\d+", file.name))],
    )
    streams = [file for file in held if file.suffix.lower() in STREAMS]
    if not gliders and not streams:
        names = ", ".join(file.name for file in held[:5]) or "no file"
        raise LogError(
            f"{path}: expected a ROS 2 bag (with {_BAG}), a glider's files (.nc, .gli, .pld1) or logs ({', '.join(STREAMS)}); "
            f"the folder holds {names}; give the logs themselves"
        )
    return [*gliders, *streams]


def _bag(path: Path) -> list[Path]:
    """Return the files of a bag in the order of its metadata, which lists them from its first message on."""
    try:
        listed = _PART.findall((path / _BAG).read_text(encoding="utf-8", errors="replace"))
    except OSError as error:
        raise LogError(
            f"{path / _BAG}: cannot be read: {error.strerror}; check its permissions"
        ) from error
    files = [path / Path(name).name for name in dict.fromkeys(listed)] or sorted(
        path.glob("*.mcap")
    )
    packed = [file.name for file in files if file.suffix == ".zstd"]
    if packed:
        raise LogError(
            f"{path}: {', '.join(packed)}: a compressed file of a bag; unpack it with: zstd -d {packed[0]}"
        )
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise LogError(
            f"{path}: expected the files of {_BAG}, missing: {', '.join(missing) or 'all'}; give those there are one by one"
        )
    return files
