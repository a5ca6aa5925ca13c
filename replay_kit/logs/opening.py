"""Table of log formats with their readers and properties, and opening of logs in files and folders by it.

A file has the first format whose magic bytes match, else the first that recognises its beginning. Errors, documentation and damage tests
use the table too.
"""

import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import takewhile
from operator import itemgetter
from pathlib import Path
from typing import Any

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.extensions import additions
from replay_kit.core.files.inputs import open_input
from replay_kit.core.files.paths import as_path
from replay_kit.logs.reader import LogFile, read_bytes, unreadable

GZIP_MAGIC = b"\x1f\x8b"
# names that the first column of a SeaExplorer's file has.
_FIRST_COLUMNS = b"timestamp", b"pld_realtimeclock"


@dataclass(frozen=True, slots=True)
class LogFormat:
    """Log format. Functions are given as ``module:name``, imported on demand; a module of this room begins with a point.

    Attributes:
        name: Name in ``info``.
        title: Description of such a file.
        reader: Creates the reader of a file, from a list of it, input, configuration and wanted messages, as ``open_log``; of a grouped
            format the readers of all its files, from these and the configuration.
        magic: Pattern of the first bytes of a file; empty if not specific.
        recognises: Returns whether the first 64 kB of a file are of the format; None if the magic bytes suffice.
        endings: Pattern of file names in a folder; empty if a folder's files are ignored.
        unchecked: Part of each message without a checksum; empty if the reader counts it.
        grows: Whether it may grow while it is read.
        grouped: Whether several files may be one log.
        damaged_by_name: Whether a file with a damaged beginning is recognised by its name.
    """

    name: str
    title: str
    reader: str | Callable[..., LogFile | list[LogFile]]
    magic: bytes = b""
    recognises: str | Callable[[bytes], bool] | None = None
    endings: str = ""
    unchecked: str = ""
    grows: bool = False
    grouped: bool = False
    damaged_by_name: bool = False

    def named(self, path: Path) -> bool:
        """Return whether a file name matches the format."""
        return re.fullmatch(self.endings, path.name, re.IGNORECASE) is not None


def _is_csv(head: bytes) -> bool:
    """Return whether a file is a text table: names separated by commas, semicolons or tabs."""
    lines = head.split(b"\n")
    first = next((line for line in lines[:-1] if not line.startswith(b"#")), b"")
    try:
        text = first.decode("utf-8-sig").strip().replace("\t", ",")
    except UnicodeDecodeError:
        return False
    return text.isprintable() and max(map(text.count, ",;")) >= 3


def is_seaexplorer(head: bytes) -> bool:
    """Return whether a file that begins with these bytes is from a SeaExplorer, compressed or not."""
    if head.startswith(GZIP_MAGIC):
        try:
            head = zlib.decompressobj(wbits=31).decompress(head, 256)
        except zlib.error:
            return False
    return head.lstrip(b"\xef\xbb\xbf").split(b";", 1)[0].strip().lower() in _FIRST_COLUMNS


_VALUES = "values of NetCDF, text or Slocum files"
#: The formats, in the order in which they are tried.
FORMATS = (
    LogFormat(
        "mcap",
        "an MCAP file",
        ".mcap.reader:McapReader",
        magic=rb"\x89MCAP0\r\n",
        endings=r".*\.mcap",
        grows=True,
    ),
    LogFormat(
        "netcdf",
        "a NetCDF file of a glider, an HF radar, drifters or pings",
        ".netcdf.dialects:logs_of_columns",
        magic=rb"CDF[\x01\x02\x05]|\x89HDF",
        endings=r".*\.(nc|nc4|cdf)",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "seaexplorer",
        "a SeaExplorer's file",
        ".netcdf.dialects:logs_of_seaexplorers",
        recognises=is_seaexplorer,
        endings=r".*\.(gli|pld1)(\.(sub|raw|all))?(\.\d+)?(\.gz)?",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "slocum",
        "a Slocum's binary file (.dbd, .sbd)",
        ".slocum.reader:logs_of_slocums",
        # as it is, or in the first block of a compressed file
        magic=rb"(?s:.{3,5})?dbd_label:",
        endings=r".*\.[demnst][bc]d",
        unchecked=_VALUES,
        grouped=True,
        damaged_by_name=True,
    ),
    LogFormat(
        "ad2cp",
        "a raw file of Nortek's ADCPs (AD2CP)",
        ".adcp.reader:open_raw_adcp",
        magic=rb"\xa5[\x0a\x0c]",
        endings=r".*\.ad2cp",
        grows=True,
    ),
    LogFormat(
        "radials",
        "radials of an HF radar (LLUV)",
        ".netcdf.radials:logs_of_radials",
        magic=rb"%CTF:",
        endings=r".*\.ruv",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "dataflash",
        "a DataFlash log (.BIN)",
        ".mavlink.dataflash:DataflashReader",
        recognises=".mavlink.dataflash:is_dataflash",
        endings=r".*\.bin",
        unchecked="records of a DataFlash log",
        grows=True,
    ),
    LogFormat(
        "table",
        "a table of pings or drifters (CSV)",
        ".netcdf.dialects:logs_of_tables",
        recognises=_is_csv,
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "tlog",
        "a MAVLink telemetry log (.tlog)",
        ".mavlink.reader:TlogReader",
        recognises=".mavlink.frames:is_tlog",
        endings=r".*\.tlog",
        unchecked="stamps of frames",
        grows=True,
    ),
    LogFormat(
        "pd0",
        "a raw file of Teledyne's ADCPs (PD0)",
        ".adcp.reader:open_raw_adcp",
        # a packet of waves may come before the first ensemble
        magic=rb"\x7f[\x7f\x79]",
        recognises=".adcp.frames:holds_ensemble",
        endings=r".*\.(pd0|enx|ens|000)",
        grows=True,
    ),
)


_HEAD = 1 << 16
_BAG = "metadata.yaml"
_PART = re.compile(r"^\s*-\s+[\"']?([^\s\"':]+\.(?:mcap|db3)(?:\.zstd)?)[\"']?\s*$", re.MULTILINE)
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
    """Return the reader of a log, selected by its contents.

    Args:
        path: Log, or folder with one log.
        input: Position of the log among the run's inputs.
        config: Settings of log reading; None for the defaults.
        wanted: MAVLink message names and DataFlash schemas to decode; others are only counted. None decodes all. Ignored for other formats.

    Raises:
        LogError: The file is missing, empty, unreadable or of unknown format; the folder holds several logs.
    """
    path = as_path(path, "log")
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
    """Return the readers of a mission's logs; a folder stands for its logs, and single-profile glider files form one log.

    Args:
        paths: Files and folders: a ROS 2 bag, or a folder of glider files.
        config: Settings of log reading.
        wanted: See ``open_log``.
        several_missions: Whether a folder may hold several missions.

    Raises:
        LogError: See ``open_log``; or a folder holds no log, or glider files of several missions.
    """
    files = [file for path in paths for file in logs_in(Path(path))]
    groups: dict[LogFormat, list[int]] = {}
    for place, file in enumerate(files):
        groups.setdefault(_format_of(file), []).append(place)
    found: list[tuple[int, LogFile]] = []
    for form, places in groups.items():
        of_form, read = [files[place] for place in places], _function(form.reader)
        logs = (
            read(of_form, config)
            if form.grouped
            else [read([one], 0, config, wanted) for one in of_form]
        )
        # a file may be given twice; of several files the first tells the place
        if len(logs) < len(of_form):
            places = [places[of_form.index(log.files[0])] for log in logs]
        for log in logs:
            log.unchecked = form.unchecked
        found += zip(places, logs, strict=True)
    logs = [log for _, log in sorted(found, key=itemgetter(0))]
    for number, log in enumerate(logs):
        log.input = number
    if len(logs) > 1 and not several_missions:
        for folder in filter(Path.is_dir, map(Path, paths)):
            require_one_mission(folder, logs)
    return logs


def logs_in(path: Path) -> list[Path]:
    """Return the logs at a path: the file itself, the parts of a ROS 2 bag, or the logs in a folder.

    Raises:
        LogError: The folder holds no log.
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
    """Return the sort key of a file in a folder: complete files by the numbers in their names, then growing ones by name."""
    # SeaExplorers and Slocums number their files without leading zeros
    grows = may_grow(path)
    return grows, [] if grows else [*map(int, re.findall(r"\d+", path.name))], path.name


def may_grow(path: Path) -> bool:
    """Return whether a file name matches a format that is written message by message."""
    return any(form.grows and form.named(path) for form in _all_formats())


def _bag(path: Path) -> list[Path]:
    """Return the files of a bag in the order of its metadata."""
    listed = _PART.findall(read_bytes(path / _BAG).decode("utf-8", "replace"))
    files = [path / Path(name).name for name in dict.fromkeys(listed)]
    packed = [file.name for file in files if file.suffix == ".zstd"]
    if packed:
        raise LogError(
            f"{path}: {', '.join(packed)}: a compressed file of a bag; unpack it with: zstd -d {packed[0]}"
        )
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise LogError(
            f"{path}: expected the files of {_BAG}, missing: {', '.join(missing) or 'all'}; give the existing ones one by one"
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
        raise LogError(f"{path}: expected a log, the file is empty (0 bytes); give another")
    unknown = f"it begins with {str(head[:24])[1:]}; give a log of one of these formats"
    foreign = (f"this is {words}" for magic, words in _FOREIGN if head.startswith(magic))
    raise LogError(f"{path}: expected {_titles()}; {next(foreign, unknown)}")


def _function(named: str | Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the table, imported if given by name."""
    if callable(named):
        return named
    module, name = named.split(":")
    found: Callable[..., Any] = getattr(import_module(module, "replay_kit.logs"), name)
    return found


def _titles() -> str:
    *others, last = (form.title for form in _all_formats())
    return f"{', '.join(others)} or {last}"


def require_one_mission(folder: Path, logs: Sequence[LogFile]) -> None:
    """Raise LogError if the logs in a folder belong to several missions; unnamed missions match any."""
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
    """Return the name of one file, or the common beginning of several followed by ``*``."""
    letters = takewhile(
        lambda column: len(set(column)) == 1, zip(*(path.name for path in paths), strict=False)
    )
    return paths[0].name if len(paths) == 1 else f"{''.join(column[0] for column in letters)}*"
