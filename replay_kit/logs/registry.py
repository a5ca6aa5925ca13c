"""The registry of log formats, and ``open_log``, which chooses the reader by a file's first bytes, never by its name."""

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import NamedTuple

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.paths import as_path
from replay_kit.logs.adcp.records import AD2CP_MAGICS, PD0_MAGIC
from replay_kit.logs.folders import logs_in
from replay_kit.logs.reader import LogFile, unreadable

_NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")
_DATAFLASH_MAGIC = b"\xa3\x95"
_HEAD = 1 << 16


class LogFormat(NamedTuple):
    """A format of logs.

    Attributes:
        name: As in ``LogReport.format``.
        recognises: Whether a file that begins with these bytes is of the format.
        load: Imports and returns the reader, or what makes it.
    """

    name: str
    recognises: Callable[[bytes], bool]
    load: Callable[[], Callable[[Path, int, LogConfig | None, frozenset[str] | None], LogFile]]


def _begins(*magics: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magics)


def _is_tlog(head: bytes) -> bool:
    # a telemetry log may carry pieces of a DataFlash log that was downloaded; it never begins like one
    if head.startswith(_DATAFLASH_MAGIC):
        return False
    from replay_kit.logs.mavlink.frames import is_tlog

    return is_tlog(head)


def _is_dataflash(head: bytes) -> bool:
    from replay_kit.logs.dataflash.records import is_dataflash

    return is_dataflash(head)


# Readers are imported with the first log of their format: the libraries of one take longer to load than a small log of another to read.


def _mcap() -> type[LogFile]:
    from replay_kit.logs.mcap.reader import McapReader

    return McapReader


def _glider() -> Callable[[Path, int, LogConfig | None, frozenset[str] | None], LogFile]:
    from replay_kit.logs.glider.reader import open_glider

    return open_glider


def _is_glider(head: bytes) -> bool:
    if head.startswith(_NETCDF):
        return True
    from replay_kit.logs.glider.missions import is_seaexplorer

    return is_seaexplorer(head)


def _raw_adcp() -> type[LogFile]:
    from replay_kit.logs.adcp.reader import RawAdcpReader

    return RawAdcpReader


def _tlog() -> type[LogFile]:
    from replay_kit.logs.mavlink.reader import TlogReader

    return TlogReader


def _dataflash() -> type[LogFile]:
    from replay_kit.logs.dataflash.reader import DataflashReader

    return DataflashReader


#: In the order in which they are tried: those with magic bytes first.
FORMATS = (
    LogFormat("mcap", _begins(b"\x89MCAP0\r\n"), _mcap),
    LogFormat("glider", _is_glider, _glider),
    LogFormat("pd0", _begins(PD0_MAGIC), _raw_adcp),
    LogFormat("ad2cp", _begins(*AD2CP_MAGICS), _raw_adcp),
    LogFormat("tlog", _is_tlog, _tlog),
    LogFormat("dataflash", _is_dataflash, _dataflash),
)
#: Group of entry points of other packages' readers, such as one of a Slocum's binary files; each is the function
#: ``open(path, input, config, wanted)`` that returns a ``LogFile``, or None for a file that is not its own.
PLUGINS = "replay_kit.logs"
#: Logs that are recognised only to say what to do with them.
_FOREIGN = (
    (
        b"#ROSBAG",
        "a ROS 1 bag; convert it with the MCAP command line: mcap convert IN.bag OUT.mcap",
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
    """Return the reader of a log, chosen by its first bytes: MCAP, MAVLink, DataFlash, glider files or raw ADCP.

    Args:
        path: The log.
        input: Position of the log among the run's inputs.
        config: How logs are read; the defaults when None.
        wanted: MAVLink message names, and schemas of DataFlash records, to decode; others are counted only. None decodes all. Without
            effect on other formats.

    Raises:
        LogError: The file is missing, no file, empty, unreadable, or of none of the known formats.
    """
    path = as_path(path, "log")
    if path.is_dir():
        logs = open_logs([path], config, wanted)
        if len(logs) != 1:
            raise LogError(
                f"{path}: expected a folder with one log, it holds {len(logs)}; give the files in it"
            )
        logs[0].input = input
        return logs[0]
    head = _first_bytes(path)
    for form in FORMATS:
        if form.recognises(head):
            return form.load()(path, input, config, wanted)
    for plugin in entry_points(group=PLUGINS):
        log: LogFile | None = plugin.load()(path, input, config, wanted)
        if log is not None:
            return log
    foreign = next((words for magic, words in _FOREIGN if head.startswith(magic)), None)
    raise LogError(
        f"{path}: expected an MCAP file, a MAVLink telemetry log (.tlog), a DataFlash log (.BIN), a glider's NetCDF or "
        "SeaExplorer file, or a raw ADCP file (PD0, AD2CP); "
        + (
            f"this is {foreign}"
            if foreign
            else f"its first bytes are {head[:16].hex(' ')}; give a log of one of these formats"
        )
    )


def open_logs(
    paths: Sequence[Path],
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
    several_missions: bool = False,
) -> list[LogFile]:
    """Return the readers of a mission's logs: a folder stands for the logs in it, and a glider's files of single profiles are one log.

    Args:
        paths: Files and folders: a ROS 2 bag, or a folder of a glider's files.
        config: How logs are read; the defaults when None.
        wanted: As of ``open_log``.
        several_missions: Whether a folder may hold the files of several missions.

    Raises:
        LogError: As of ``open_log``; or a folder holds no log, or gliders' files of several missions.
    """
    files = [file for path in paths for file in logs_in(Path(path))]
    places = [place for place, file in enumerate(files) if _is_glider(_first_bytes(file))]
    groups = {place: [file] for place, file in enumerate(files)}
    if len(places) > 1:
        from replay_kit.logs.glider.files import grouped

        for group in grouped([files[place] for place in places]):
            members = [places[k] for k in group]
            groups |= {place: [] for place in members} | {
                members[0]: [files[place] for place in members]
            }
    parts = [group for group in groups.values() if group]
    logs = [_opened(group, number, config, wanted) for number, group in enumerate(parts)]
    if len(places) > 1 and not several_missions:
        from replay_kit.logs.glider.missions import require_one_mission

        for folder in filter(Path.is_dir, map(Path, paths)):
            require_one_mission(folder, logs)
    return logs


def _opened(
    group: Sequence[Path], number: int, config: LogConfig | None, wanted: frozenset[str] | None
) -> LogFile:
    if len(group) == 1:
        return open_log(group[0], number, config, wanted)
    from replay_kit.logs.glider.reader import open_glider

    return open_glider(group[0], number, config, wanted, group[1:])


def _first_bytes(path: Path) -> bytes:
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise LogError(f"{path}: file not found") from error
    except OSError as error:
        raise unreadable(path, error) from error
    if not head:
        raise LogError(
            f"{path}: expected a log, the file is empty (0 bytes); was the recording stopped before anything was written?"
        )
    return head
