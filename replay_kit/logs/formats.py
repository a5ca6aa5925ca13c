"""The table of log formats, and the logs that files and folders hold: ``open_log`` and ``open_logs`` choose readers by it.

A file is of the first format whose magic bytes it begins with; else of the first that recognises more of its beginning.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.extensions import additions
from replay_kit.core.inputs import open_input
from replay_kit.core.paths import as_path
from replay_kit.logs.reader import LogFile, unreadable

_HEAD = 1 << 16
_TEXT = re.compile(rb"[ -~]{3,40}")
_BAG = "metadata.yaml"
_PART = re.compile(r"^\s*-\s+[\"']?([^\s\"':]+\.(?:mcap|db3)(?:\.zstd)?)[\"']?\s*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of logs. Functions of our own are named as ``module:name``: their libraries may take longer to load than a log to read.

    Attributes:
        name: As ``info`` says it; a reader may say more exactly which.
        title: What such a file is, in words.
        reader: Makes the reader of a log: its files, input, configuration and what is wanted, as of ``open_log``.
        magic: Pattern of the bytes with which a file begins; empty where they say nothing.
        recognises: Whether a file that begins with these bytes, at most 64 kB, is of the format; None where the magic bytes say all.
        endings: Pattern of the names that such files have in a folder; without one a folder's files are not taken.
        unchecked: What of each message no checksum of the format covers; empty where all is covered, or the reader counts it.
        grows: Whether it is written message by message, and may grow while it is read; others come whole.
        log_of: Names what the files of one log have in common: none goes with any others of its format, None is a log of its own.
            None for formats whose logs are single files.
        damaged_by_name: Whether a file whose beginning is damaged is told by its name.
    """

    name: str
    title: str
    reader: str | Callable[..., LogFile]
    magic: bytes = b""
    recognises: str | Callable[[bytes], bool] | None = None
    endings: str = ""
    unchecked: str = ""
    grows: bool = False
    log_of: str | Callable[[Path], tuple[str, ...] | None] | None = None
    damaged_by_name: bool = False

    def named(self, path: Path) -> bool:
        """Return whether a file has a name as those of this format."""
        return re.fullmatch(self.endings, path.name, re.IGNORECASE) is not None


def _is_csv(head: bytes) -> bool:
    """Return whether a file that begins so is a table in text: names with commas, semicolons or tabs between them."""
    lines = head.split(b"\n")
    first = next((line for line in lines[:-1] if not line.startswith(b"#")), b"")
    try:
        text = first.decode("utf-8-sig").strip().replace("\t", ",")
    except UnicodeDecodeError:
        return False
    return text.isprintable() and max(map(text.count, ",;")) >= 3


_VALUES = "values of NetCDF, text or Slocum files"
#: The formats, in the order in which they are tried.
FORMATS = (
    LogFormat(
        "mcap",
        "an MCAP file",
        "mcap.reader:McapReader",
        magic=rb"\x89MCAP0\r\n",
        endings=r".*\.mcap",
        grows=True,
    ),
    LogFormat(
        "netcdf",
        "a NetCDF file of a glider, an HF radar, drifters or pings",
        "glider.reader:open_glider",
        magic=rb"CDF[\x01\x02\x05]|\x89HDF",
        endings=r".*\.(nc|nc4|cdf)",
        unchecked=_VALUES,
        log_of="glider.files:mission_key",
    ),
    LogFormat(
        "seaexplorer",
        "a SeaExplorer's file",
        "glider.reader:open_glider",
        recognises="glider.missions:is_seaexplorer",
        endings=r".*\.(gli|pld1)(\.(sub|raw|all))?(\.\d+)?(\.gz)?",
        unchecked=_VALUES,
        log_of="glider.files:mission_key",
    ),
    LogFormat(
        "slocum",
        "a Slocum's binary file (.dbd, .sbd)",
        "slocum.reader:open_slocum",
        # as it is, or in the first block of a compressed file
        magic=rb"(?s:.{3,5})?dbd_label:",
        endings=r".*\.[demnst][bc]d",
        unchecked=_VALUES,
        log_of="slocum.reader:glider_of",
        damaged_by_name=True,
    ),
    LogFormat(
        "ad2cp",
        "a raw file of Nortek's ADCPs (AD2CP)",
        "adcp.reader:RawAdcpReader",
        magic=rb"\xa5[\x0a\x0c]",
        endings=r".*\.ad2cp",
        grows=True,
    ),
    LogFormat(
        "radials",
        "radials of an HF radar (LLUV)",
        "surface.lluv:RadialsReader",
        magic=rb"%CTF:",
        endings=r".*\.ruv",
        unchecked=_VALUES,
        log_of="surface.lluv:station_of",
    ),
    LogFormat(
        "dataflash",
        "a DataFlash log (.BIN)",
        "dataflash:DataflashReader",
        recognises="dataflash:is_dataflash",
        endings=r".*\.bin",
        unchecked="records of a DataFlash log",
        grows=True,
    ),
    LogFormat(
        "table",
        "a table of pings or drifters (CSV)",
        "surface.drifters:open_table",
        recognises=_is_csv,
        unchecked=_VALUES,
    ),
    LogFormat(
        "tlog",
        "a MAVLink telemetry log (.tlog)",
        "mavlink.reader:TlogReader",
        recognises="mavlink.frames:is_tlog",
        endings=r".*\.tlog",
        unchecked="stamps of frames",
        grows=True,
    ),
    LogFormat(
        "pd0",
        "a raw file of Teledyne's ADCPs (PD0)",
        "adcp.reader:RawAdcpReader",
        # a packet of waves may come before the first ensemble
        magic=rb"\x7f[\x7f\x79]",
        recognises="adcp.records:holds_ensemble",
        endings=r".*\.(pd0|enx|ens|000)",
        grows=True,
    ),
)
#: Files that are recognised only to say what to do with them.
_FOREIGN = (
    (
        b"#ROSBAG",
        "a ROS 1 bag; convert it with the MCAP command line: mcap convert IN.bag OUT.mcap",
    ),
    (
        b"s: ",
        "a list of sensors of a Slocum's files; give the files, which find it in their folder or in cac beside them",
    ),
    (
        b"SQLite format 3",
        "an SQLite file, perhaps a ROS 2 bag; convert it with: ros2 bag convert, storage mcap",
    ),
)


def open_log(
    path: str | Path,
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
) -> LogFile:
    """Return the reader of a log, chosen by what the file holds.

    Args:
        path: The log, or a folder that holds one.
        input: Position of the log among the run's inputs.
        config: How logs are read; the defaults when None.
        wanted: MAVLink message names, and schemas of DataFlash records, to decode; others are counted only. None decodes all. Without
            effect on other formats.

    Raises:
        LogError: The file is missing, no file, empty, unreadable, or of none of the known formats; the folder holds several logs.
    """
    path = as_path(path, "log")
    if not path.is_dir():
        return _opened([path], _format_of(path), input, config, wanted)
    logs = open_logs([path], config, wanted)
    if len(logs) != 1:
        raise LogError(
            f"{path}: expected a folder with one log, it holds {len(logs)}; give the files in it"
        )
    logs[0].input = input
    return logs[0]


def open_logs(
    paths: Sequence[Path],
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
    several_missions: bool = False,
) -> list[LogFile]:
    """Return the readers of a mission's logs: a folder stands for the logs in it, and glider files of single profiles are one log.

    Args:
        paths: Files and folders: a ROS 2 bag, or a folder of glider files.
        config: How logs are read.
        wanted: As of ``open_log``.
        several_missions: Whether a folder may hold the files of several missions.

    Raises:
        LogError: As of ``open_log``; or a folder holds no log, or glider files of several missions.
    """
    files = [file for path in paths for file in logs_in(Path(path))]
    groups: dict[tuple[str, ...], list[Path]] = {}
    formats: dict[tuple[str, ...], LogFormat] = {}
    for place, file in enumerate(files):
        form = _format_of(file)
        names = None
        if form.log_of is not None and len(files) > 1:
            names = _function(form.log_of)(file)
        key = (form.name, str(place)) if names is None else (form.name, "", *names)
        groups.setdefault(key, []).append(file)
        formats[key] = form
    for key in [key for key in groups if key[1:] == ("",)]:
        # a damaged file more of the log that there is
        whole = next((other for other in groups if other[:2] == key[:2] and other != key), key)
        if whole != key:
            groups[whole] += groups.pop(key)
    logs = [
        _opened(group, formats[key], number, config, wanted)
        for number, (key, group) in enumerate(groups.items())
    ]
    if len(logs) > 1 and not several_missions:
        from replay_kit.logs.glider.missions import require_one_mission

        for folder in filter(Path.is_dir, map(Path, paths)):
            require_one_mission(folder, logs)
    return logs


def logs_in(path: Path) -> list[Path]:
    """Return the logs that a name stands for: the file itself; of a folder the parts of its ROS 2 bag, or the logs in it.

    Raises:
        LogError: The folder holds none.
    """
    if not path.is_dir():
        return [path]
    if (path / _BAG).is_file():
        return _bag(path)
    held = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    logs = [file for file in held if any(form.named(file) for form in _all_formats())]
    if not logs:
        names = ", ".join(file.name for file in sorted(held)[:5]) or "no file"
        raise LogError(
            f"{path}: expected a ROS 2 bag (with {_BAG}) or logs, such as {_titles()}; the folder holds {names}; give the logs themselves"
        )
    return sorted(logs, key=in_folder)


def in_folder(path: Path) -> tuple[bool, list[int], str]:
    """Return what orders the files of a folder: files that come whole by the numbers in their names, then those that grow, by name."""
    # SeaExplorers and Slocums number their files without leading zeros
    grows = may_grow(path)
    return grows, [] if grows else [*map(int, re.findall(r"\d+", path.name))], path.name


def may_grow(path: Path) -> bool:
    """Return whether a file has the name of a format that is written message by message."""
    return any(form.grows and form.named(path) for form in _all_formats())


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


def _all_formats() -> Iterator[LogFormat]:
    yield from FORMATS
    added = additions("logs", lambda value: isinstance(value, LogFormat), "a LogFormat")
    yield from added.values()


def _format_of(path: Path) -> LogFormat:
    """Return the format of a file."""
    try:
        with open_input(path) as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise LogError(f"{path}: file not found") from error
    except OSError as error:
        raise unreadable(path, error) from error
    by_magic = (form for form in _all_formats() if form.magic and re.match(form.magic, head))
    by_more = (
        form
        for form in _all_formats()
        if form.recognises is not None and _function(form.recognises)(head)
    )
    by_name = (form for form in _all_formats() if form.damaged_by_name and form.named(path))
    for found in (by_magic, by_more, by_name):
        if (form := next(found, None)) is not None:
            return form
    if not head:
        raise LogError(
            f"{path}: expected a log, the file is empty (0 bytes); was the recording stopped before anything was written?"
        )
    foreign = next((words for magic, words in _FOREIGN if head.startswith(magic)), None)
    raise LogError(
        f"{path}: expected {_titles()}; "
        + (
            f"this is {foreign}"
            if foreign
            else f"{_beginning(head)}; give a log of one of these formats"
        )
    )


def _opened(
    files: Sequence[Path],
    form: LogFormat,
    input: int,
    config: LogConfig | None,
    wanted: frozenset[str] | None,
) -> LogFile:
    log: LogFile = _function(form.reader)(files, input, config, wanted)
    log.unchecked = form.unchecked
    return log


def _function(named: str | Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the table, imported where the table names it."""
    if callable(named):
        return named
    module, name = named.split(":")
    found: Callable[..., Any] = getattr(import_module(f"replay_kit.logs.{module}"), name)
    return found


def _titles() -> str:
    *others, last = (form.title for form in _all_formats())
    return f"{', '.join(others)} or {last}"


def _beginning(head: bytes) -> str:
    """Return the first bytes of a file in words: the first text in them, which often names the format, else the bytes."""
    text = _TEXT.search(head[:64])
    first = f"its first bytes are {head[:16].hex(' ')}"
    return f"it begins with {text[0].decode('ascii')!r}" if text else first
