"""Choice of the reader by a file's first bytes, never by its name."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import LogReader, LogReport, Message

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_NETCDF_MAGICS = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")
_DATAFLASH_MAGIC = b"\xa3\x95"
_HEAD = 1 << 16

#: Logs that are recognised only to say what to do with them.
_FOREIGN = (
    (b"#ROSBAG", "a ROS 1 bag; convert it with the MCAP command line: mcap convert IN.bag OUT.mcap"),
    (b"SQLite format 3", "an SQLite file, perhaps a ROS 2 bag; convert it with: ros2 bag convert, storage mcap"),
)


class _Renamed:
    """A log whose topics are called by other names."""

    def __init__(self, reader: LogReader, names: Mapping[str, str]) -> None:
        self.path = reader.path
        self.format = reader.format
        self._reader = reader
        self._names = names

    def messages(self) -> Iterator[Message]:
        for message in self._reader.messages():
            name = self._names.get(message.topic)
            yield message if name is None else message._replace(topic=name)

    def report(self) -> LogReport:
        report = self._reader.report()
        read: Counter[str] = Counter()
        for topic, count in report.read.items():
            read[self._names.get(topic, topic)] += count
        undecodable = {self._names.get(topic, topic): why for topic, why in report.undecodable.items()}
        return replace(report, read=dict(read), undecodable=undecodable)


def open_log(path: Path, input: int = 0, config: LogConfig | None = None, wanted: frozenset[str] | None = None) -> LogReader:
    """Return the reader of a log, as ``open_kept``, its topics called by the names that ``logs.remap`` gives them.

    Args:
        path: The log.
        input: Position of the log among the run's inputs.
        config: How logs are read; the defaults when None.
        wanted: MAVLink message names to decode; others are counted only. None decodes all. Of no effect on other formats.

    Raises:
        LogError: The file is missing, no file, empty, unreadable, or none of the known logs.
    """
    reader = open_kept(path, input, config, wanted)
    return _Renamed(reader, config.remap) if config is not None and config.remap else reader


def open_kept(path: Path, input: int = 0, config: LogConfig | None = None, wanted: frozenset[str] | None = None) -> LogReader:
    """Return the reader of a log, chosen by its first bytes: MCAP, MAVLink, DataFlash, Seaglider NetCDF or raw ADCP.

    Args:
        path: The log.
        input: Position of the log among the run's inputs.
        config: How logs are read; the defaults when None.
        wanted: MAVLink message names, and schemas of DataFlash records, to decode; others are counted only. None decodes all. Of no
            effect on other formats.

    Raises:
        LogError: The file is missing, no file, empty, unreadable, or none of the known logs.
    """
    config = config or LogConfig()
    path = Path(path)
    head = _first_bytes(path)
    # The readers are imported when needed: the libraries of one format take longer to load than a small log of another to read.
    if head.startswith(_MCAP_MAGIC):
        from replay_kit.logs.mcap.reader import McapReader

        return McapReader(path, input, config)
    if head.startswith(_NETCDF_MAGICS):
        from replay_kit.logs.glider.seaglider import SeagliderReader

        reader: LogReader = SeagliderReader(path, input, config)
        return reader
    from replay_kit.logs.adcp.records import is_raw_adcp

    if is_raw_adcp(head):
        from replay_kit.logs.adcp.reader import RawAdcpReader

        return RawAdcpReader(path, input, config)
    # a telemetry log may carry pieces of the other, downloaded; it never begins like one
    if not head.startswith(_DATAFLASH_MAGIC):
        from replay_kit.logs.mavlink.reader import TlogReader, is_tlog

        if is_tlog(head):
            return TlogReader(path, input, config, wanted)
    from replay_kit.logs.dataflash.records import is_dataflash

    if is_dataflash(head):
        from replay_kit.logs.dataflash.reader import DataflashReader

        return DataflashReader(path, input, config, wanted)
    known = next((words for magic, words in _FOREIGN if head.startswith(magic)), None)
    raise LogError(
        f"{path}: expected an MCAP file, a MAVLink telemetry log (.tlog), a DataFlash log (.BIN), a Seaglider NetCDF file "
        "or a raw ADCP file (PD0, AD2CP); "
        + (f"this is {known}" if known else f"its first bytes are {head[:16].hex(' ')}; give a log of one of these formats")
    )


def _first_bytes(path: Path) -> bytes:
    if path.is_dir():
        raise LogError(f"{path}: expected a log, got a directory; give the files in it")
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
    except FileNotFoundError as error:
        raise LogError(f"{path}: expected a log, there is no such file; check the path") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}; check the file and its permissions") from error
    if not head:
        raise LogError(f"{path}: expected a log, the file is empty (0 bytes); was the recording stopped before anything was written?")
    return head
