"""The registry of log formats: ``open_log`` chooses the reader by a file's first bytes, ``logs_in`` lists the logs in a folder."""

import re
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.extensions import additions
from replay_kit.core.inputs import open_input
from replay_kit.core.paths import as_path
from replay_kit.logs.adcp.records import AD2CP_MAGICS, OTHER_PACKETS, PD0_MAGIC, scan
from replay_kit.logs.reader import LogFile, unreadable

#: Endings of logs that are written message by message, and may grow while they are read; in lower case.
STREAMS = (".mcap", ".tlog", ".bin", ".pd0", ".enx", ".ens", ".ad2cp", ".000")
_BAG = "metadata.yaml"
_PART = re.compile(r"^\s*-\s+[\"']?([^\s\"':]+\.(?:mcap|db3)(?:\.zstd)?)[\"']?\s*$", re.MULTILINE)
_SLOCUM_NAME = re.compile(r".*\.[demnst][bc]d", re.IGNORECASE)
#: Names of files of gliders and radars, which come whole.
GLIDER_NAMES = re.compile(
    r".*\.(nc|nc4|cdf|ruv)|.*\.[demnst][bc]d|.*\.(gli|pld1)\.(sub|raw|all)(\.\d+)?(\.gz)?|.*\.(gli|pld1)(\.\d+)?(\.gz)?",
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
    # SeaExplorers and Slocums number their files without leading zeros
    gliders = sorted(
        (file for file in held if GLIDER_NAMES.fullmatch(file.name)),
        key=lambda file: [*map(int, re.findall(r"\d+", file.name))],
    )
    streams = [file for file in held if file.suffix.lower() in STREAMS]
    if not gliders and not streams:
        names = ", ".join(file.name for file in held[:5]) or "no file"
        raise LogError(
            f"{path}: expected a ROS 2 bag (with {_BAG}), glider files (.nc, .gli, .pld1, .dbd, .sbd) or logs ({', '.join(STREAMS)}); "
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


_NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")
_RADIALS, _OF_STATION = b"%CTF:", ("radials",)
_DATAFLASH_MAGIC = b"\xa3\x95"
# as they are, or in the first block of a compressed file
_SLOCUM = re.compile(rb"(.{3,5})?dbd_label:", re.DOTALL)
_HEAD = 1 << 16
_TEXT = re.compile(rb"[ -~]{3,40}")


#: Makes the reader of a log: path, input, configuration and what is wanted, as of ``open_log``.
Open = Callable[[Path, int, LogConfig | None, frozenset[str] | None], LogFile]


class LogFormat(NamedTuple):
    """A format of logs.

    Attributes:
        name: As in ``LogReport.format``.
        recognises: Whether a file that begins with these bytes is of the format.
        load: Imports and returns the reader, or what makes it.
    """

    name: str
    recognises: Callable[[bytes], bool]
    load: Callable[[], Open]


def _begins(*magics: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(magics)


def _is_tlog(head: bytes) -> bool:
    # a telemetry log may carry pieces of a DataFlash log that was downloaded; it never begins like one
    if head.startswith(_DATAFLASH_MAGIC):
        return False
    from replay_kit.logs.mavlink.frames import is_tlog

    return is_tlog(head)


def _is_dataflash(head: bytes) -> bool:
    from replay_kit.logs.dataflash import is_dataflash

    return is_dataflash(head)


def _holds_pd0(head: bytes) -> bool:
    """Return whether a file of no other format has a sound ensemble near its beginning, after packets or bytes of another kind."""
    return PD0_MAGIC in head and any(record.kind == 0 for record in scan(head))


def _is_glider(head: bytes) -> bool:
    if head.startswith(_NETCDF):
        return True
    from replay_kit.logs.glider.missions import is_seaexplorer

    return is_seaexplorer(head)


def _is_slocum(head: bytes) -> bool:
    return _SLOCUM.match(head) is not None


def _is_drifters(head: bytes) -> bool:
    from replay_kit.logs.surface.drifters import is_table

    return b"drogue" in head and is_table(head)


def _is_csv(head: bytes) -> bool:
    from replay_kit.logs.table import is_csv

    return is_csv(head)


def _reader(module: str, name: str) -> Callable[[], Open]:
    """Return what imports a reader, with the first log of its format: its libraries may take longer to load than a log to read."""

    def load() -> Open:
        found: Open = getattr(import_module(f"replay_kit.logs.{module}"), name)
        return found

    return load


#: In the order in which they are tried: those with magic bytes first.
FORMATS = (
    LogFormat("mcap", _begins(b"\x89MCAP0\r\n"), _reader("mcap.reader", "McapReader")),
    LogFormat("glider", _is_glider, _reader("glider.reader", "open_glider")),
    LogFormat("slocum", _is_slocum, _reader("slocum.reader", "open_slocum")),
    LogFormat("pd0", _begins(PD0_MAGIC, *OTHER_PACKETS), _reader("adcp.reader", "RawAdcpReader")),
    LogFormat("ad2cp", _begins(*AD2CP_MAGICS), _reader("adcp.reader", "RawAdcpReader")),
    LogFormat("radials", _begins(_RADIALS), _reader("surface.lluv", "RadialsReader")),
    LogFormat("drifters", _is_drifters, _reader("surface.drifters", "DrifterReader")),
    LogFormat("table", _is_csv, _reader("table", "TableReader")),
    LogFormat("tlog", _is_tlog, _reader("mavlink.reader", "TlogReader")),
    LogFormat("dataflash", _is_dataflash, _reader("dataflash", "DataflashReader")),
    LogFormat("pd0", _holds_pd0, _reader("adcp.reader", "RawAdcpReader")),
)
#: Logs that are recognised only to say what to do with them.
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
    for open_other in additions("logs", callable, "a function").values():
        log: LogFile | None = open_other(path, input, config, wanted)
        if log is not None:
            return log
    foreign = next((words for magic, words in _FOREIGN if head.startswith(magic)), None)
    raise LogError(
        f"{path}: expected an MCAP file, a MAVLink telemetry log (.tlog), a DataFlash log (.BIN), a glider file "
        "(NetCDF, SeaExplorer, Slocum), currents by HF radar (NetCDF, LLUV), drifters or a table of pings "
        "(NetCDF, CSV), or a raw ADCP file (PD0, AD2CP); "
        + (
            f"this is {foreign}"
            if foreign
            else f"{_beginning(head)}; give a log of one of these formats"
        )
    )


def _beginning(head: bytes) -> str:
    """Return the first bytes of a file in words: the first text in them, which often names the format, else the bytes."""
    text = _TEXT.search(head[:64])
    first = f"its first bytes are {head[:16].hex(' ')}"
    return f"it begins with {text[0].decode('ascii')!r}" if text else first


def open_logs(
    paths: Sequence[Path],
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
    several_missions: bool = False,
) -> list[LogFile]:
    """Return the readers of a mission's logs: a folder stands for the logs in it, and glider files of single profiles are one log.

    Args:
        paths: Files and folders: a ROS 2 bag, or a folder of glider files.
        config: How logs are read; the defaults when None.
        wanted: As of ``open_log``.
        several_missions: Whether a folder may hold the files of several missions.

    Raises:
        LogError: As of ``open_log``; or a folder holds no log, or glider files of several missions.
    """
    files = [file for path in paths for file in logs_in(Path(path))]
    groups: dict[tuple[str, ...], list[Path]] = {}
    for place, file in enumerate(files):
        mission = _mission(file) if len(files) > 1 else ()
        groups.setdefault(mission or (str(place),), []).append(file)
    whole = next((key for key in groups if key[:-1] == _NO_HEADER), _NO_HEADER)
    if whole != _NO_HEADER:
        # one more damaged file of the mission that the folder holds
        groups[whole] += groups.pop(_NO_HEADER, [])
    logs = [_opened(group, number, config, wanted) for number, group in enumerate(groups.values())]
    if len(logs) > 1 and not several_missions:
        from replay_kit.logs.glider.missions import require_one_mission

        for folder in filter(Path.is_dir, map(Path, paths)):
            require_one_mission(folder, logs)
    return logs


# of a Slocum's file whose header cannot be read
_NO_HEADER = ("slocum",)


def _mission(path: Path) -> tuple[str, ...]:
    """Return what the files of one log have in common; nothing where the log is one file."""
    if _is_slocum_file(path):
        from replay_kit.logs.slocum.reader import glider_of

        return *_NO_HEADER, *glider_of(path)
    head = _first_bytes(path)
    if head.startswith(_RADIALS):
        from replay_kit.logs.surface.lluv import header, station

        return *_OF_STATION, station(header(path))
    if not _is_glider(head):
        return ()
    from replay_kit.logs.glider.files import mission_key
    from replay_kit.logs.glider.rows import refuse_forecast

    refuse_forecast(path)
    return mission_key(path)


def _is_slocum_file(path: Path) -> bool:
    # one that is empty or damaged is told by its name
    named = _SLOCUM_NAME.fullmatch(path.name) is not None
    return named or _is_slocum(_first_bytes(path))


def _opened(
    group: Sequence[Path], number: int, config: LogConfig | None, wanted: frozenset[str] | None
) -> LogFile:
    if len(group) == 1:
        return open_log(group[0], number, config, wanted)
    if _is_slocum_file(group[0]):
        from replay_kit.logs.slocum.reader import open_slocum

        return open_slocum(group[0], number, config, wanted, group[1:])
    if _first_bytes(group[0]).startswith(_RADIALS):
        from replay_kit.logs.surface.lluv import RadialsReader

        return RadialsReader(group, number, config)
    from replay_kit.logs.glider.reader import open_glider

    return open_glider(group[0], number, config, wanted, group[1:])


def _first_bytes(path: Path) -> bytes:
    try:
        with open_input(path) as file:
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
