"""Table of log formats with their readers and properties; errors, documentation and damage tests use it."""

import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from replay_kit.logs.reader import LogFile

GZIP_MAGIC = b"\x1f\x8b"
# names that the first column of a SeaExplorer's file has.
_FIRST_COLUMNS = b"timestamp", b"pld_realtimeclock"


@dataclass(frozen=True, slots=True)
class LogFormat:
    """Log format. Functions are given as ``module:name``, imported on demand.

    Attributes:
        name: Name in ``info``; a reader may be more specific.
        title: Description of such a file.
        reader: Creates the reader of a file, from a list of it, input, configuration and wanted messages, as ``open_log``; of a grouped
            format the readers of all its files, from these and the configuration.
        magic: Pattern of the first bytes of a file; empty if not specific.
        recognises: Returns whether the first 64 kB of a file are of the format; None if the magic bytes suffice.
        endings: Pattern of file names in a folder; empty if a folder's files are ignored.
        unchecked: Part of each message without a checksum; empty if all is covered or the reader counts it.
        grows: Whether it is written message by message, and may grow while it is read.
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
        "mcap.reader:McapReader",
        magic=rb"\x89MCAP0\r\n",
        endings=r".*\.mcap",
        grows=True,
    ),
    LogFormat(
        "netcdf",
        "a NetCDF file of a glider, an HF radar, drifters or pings",
        "netcdf.reader:logs_of_columns",
        magic=rb"CDF[\x01\x02\x05]|\x89HDF",
        endings=r".*\.(nc|nc4|cdf)",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "seaexplorer",
        "a SeaExplorer's file",
        "netcdf.reader:logs_of_seaexplorers",
        recognises=is_seaexplorer,
        endings=r".*\.(gli|pld1)(\.(sub|raw|all))?(\.\d+)?(\.gz)?",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "slocum",
        "a Slocum's binary file (.dbd, .sbd)",
        "slocum.reader:logs_of_slocums",
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
        "adcp.reader:open_raw_adcp",
        magic=rb"\xa5[\x0a\x0c]",
        endings=r".*\.ad2cp",
        grows=True,
    ),
    LogFormat(
        "radials",
        "radials of an HF radar (LLUV)",
        "netcdf.radials:logs_of_radials",
        magic=rb"%CTF:",
        endings=r".*\.ruv",
        unchecked=_VALUES,
        grouped=True,
    ),
    LogFormat(
        "dataflash",
        "a DataFlash log (.BIN)",
        "mavlink.dataflash:DataflashReader",
        recognises="mavlink.dataflash:is_dataflash",
        endings=r".*\.bin",
        unchecked="records of a DataFlash log",
        grows=True,
    ),
    LogFormat(
        "table",
        "a table of pings or drifters (CSV)",
        "netcdf.reader:logs_of_tables",
        recognises=_is_csv,
        unchecked=_VALUES,
        grouped=True,
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
        "adcp.reader:open_raw_adcp",
        # a packet of waves may come before the first ensemble
        magic=rb"\x7f[\x7f\x79]",
        recognises="adcp.frames:holds_ensemble",
        endings=r".*\.(pd0|enx|ens|000)",
        grows=True,
    ),
)
