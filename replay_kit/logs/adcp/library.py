"""Profiles of raw ADCP files decoded by MHKiT's dolfyn reader: PD0 ensembles by configuration, AD2CP records by mode.

MHKiT does not verify checksums, and applies one configuration to all ensembles of a file: it receives valid records of one configuration.
It is isolated because it prints, logs, warns and writes an index file next to its input.

Source: Teledyne RD Instruments, "WorkHorse Commands and Output Data Format", PD0: header, fixed and variable leader.
"""

import contextlib
import io
import logging
import os
import re
import struct
import tempfile
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.frames import AD2CP_TEXT, Record
from replay_kit.logs.reader import Told

#: Topic of the pings.
PINGS = "/adcp"
_FIXED, _VARIABLE = 0x0000, 0x0080
#: Blocks with a number for each cell and beam: the bytes of one.
_BLOCKS = {0x0100: 2, 0x0200: 1, 0x0300: 1, 0x0400: 1}
_BEAMS = 4
#: Changes of the configuration that are told.
_MOST_NOTED = 9
#: Least length of the leaders: up to the beams' first cell, and up to the clock with the century, which instruments before 2000 lack.
_LEAST_FIXED, _LEAST_VARIABLE = 42, 65
#: Where the fixed leader has what ensembles that are read together share [bytes]: firmware and system configuration, number of beams and
#: cells, cell size, coordinates (EX), alignment (EA), declination (EB), sensors and first cell, bandwidth.
_SETTINGS = ((2, 6), (8, 10), (12, 14), (25, 34), (58, 59))


#: Ordinal in the file, and bytes, of each ensemble of a configuration.
Group = list[tuple[int, bytes]]


def by_configuration(data: bytes, records: Sequence[Record], told: Told) -> list[Group]:
    """Return the ensembles of a file that can be read, by configuration.

    Args:
        data: The file.
        records: Its valid ensembles.
        told: Receives changes of the configuration, and counts of unreadable ensembles.
    """
    groups = defaultdict[bytes, Group](list)
    latest, changes = b"", list[str]()
    for ordinal, record in enumerate(records):
        types = _types(data, record)
        if reason := _missing_types(types):
            told.skipped[PINGS, reason] += 1
            continue
        settings = b"".join(types[_FIXED][begin:end] for begin, end in _SETTINGS)
        groups[settings].append((ordinal, data[record.start : record.end]))
        changes += [str(ordinal)] * (latest not in (b"", settings))
        latest = settings
    if changes:
        what = "the instrument's configuration changes, each ping uses its own: from ping"
        told.notes.append(f"{what} {', '.join(changes[:_MOST_NOTED])} on")
    return [*groups.values()]


def _types(data: bytes, record: Record) -> dict[int, bytes]:
    """Return the data types of an ensemble by identifier, each up to the start of the next."""
    count = data[record.start + 5]
    offsets = sorted(
        {*struct.unpack_from(f"<{count}H", data, record.start + 6), record.end - 2 - record.start}
    )
    pieces = [
        data[record.start + begin : record.start + end]
        for begin, end in pairwise(offsets)
        if end <= record.end - 2 - record.start
    ]
    # of two blocks of one kind, as WinRiver's positions, none is of use here
    return {
        struct.unpack_from("<H", piece)[0]: piece for piece in reversed(pieces) if len(piece) >= 2
    }


def _missing_types(types: Mapping[int, bytes]) -> str:
    """Return the missing data types of an ensemble as text; empty if complete."""
    # a narrow-band instrument's first profile has other identifiers; MHKiT knows them
    if _FIXED not in types:
        return "ensemble without the fixed leader of a first profile"
    for name, kind, least in (
        ("fixed leader", _FIXED, _LEAST_FIXED),
        ("variable leader", _VARIABLE, _LEAST_VARIABLE),
    ):
        if (size := len(types.get(kind, b""))) < least:
            return f"ensemble whose {name} has {size} bytes, {least} are needed (clock, attitude, cells)"
    cells = types[_FIXED][9]
    for kind, width in _BLOCKS.items():
        if kind in types and len(types[kind]) < 2 + _BEAMS * cells * width:
            return (
                f"ensemble whose block {kind:#06x} has {len(types[kind])} bytes, "
                f"{2 + _BEAMS * cells * width} are needed for {cells} cells"
            )
    return ""


_AVERAGE, BURST = 0x16, 0x15
_CLOCK_LINE = re.compile(rb"GETCLOCKSTR[^\r\n]*")
#: Where a record's kind is in its head, and a profile's ensemble counter in its data [bytes].
_KIND, _ENSEMBLE = 2, 72
NO_ENSEMBLE = "no valid ensemble of velocities (checksums); copy it again"


def read_pd0(path: Path, parts: Sequence[bytes]) -> Any:
    """Return the MHKiT dataset (xarray) of ensembles of one configuration.

    Args:
        path: File named in errors.
        parts: The ensembles.

    Raises:
        LogError: MHKiT is not installed or fails.
    """
    read_rdi, _ = _readers(path)
    # MHKiT reads an ensemble only where another follows, and needs two to begin
    (dataset,) = _read(
        path,
        b"".join([*parts, parts[-1], parts[-1]]),
        lambda copy: [read_rdi(copy, userdata=False, nens=len(parts), debug=0)],
    )
    return dataset


class Mode(NamedTuple):
    """Profiles of one kind and configuration of an AD2CP file.

    Attributes:
        kind: Record identifier, bursts or averages.
        text: Record with the instrument's configuration.
        pings: Records of the profiles.
        ordinals: Ordinal of each among the records of its kind.
    """

    kind: int
    text: bytes
    pings: list[bytes]
    ordinals: list[int]


def modes_of(path: Path, data: bytes, records: Sequence[Record]) -> list[Mode]:
    """Return the profiles of an AD2CP file by kind and configuration, in order of first occurrence.

    MHKiT fails on several configurations and on modes with unequal numbers of pings.

    Args:
        path: File named in errors.
        data: Its bytes.
        records: Its valid records.

    Raises:
        LogError: There is no profile, or no record with the instrument's configuration.
    """
    texts = [data[record.start : record.end] for record in records if record.kind == AD2CP_TEXT]
    if not {record.kind for record in records} & {_AVERAGE, BURST}:
        raise LogError(f"{path}: {NO_ENSEMBLE}")
    if not texts:
        raise LogError(
            f"{path}: the record with the instrument's configuration is missing or damaged; copy the file again"
        )
    found: dict[tuple[Any, ...], Mode] = {}
    text, counts = texts[0], Counter[int]()
    for record in records:
        body = data[record.start : record.end]
        if record.kind == AD2CP_TEXT:
            text = body
        if record.kind in (BURST, _AVERAGE):
            at = body[1]
            # version, offset and contents of the data; beams, coordinates, cells; cell size, blanking
            settings = body[at : at + 4] + body[at + 30 : at + 36]
            lines = _CLOCK_LINE.sub(b"", text[text[1] :])
            mode = found.setdefault(
                (record.kind, settings, len(body), lines), Mode(record.kind, text, [], [])
            )
            mode.pings.append(body)
            mode.ordinals.append(counts[record.kind])
            counts[record.kind] += 1
    return list(found.values())


def read_mode(path: Path, mode: Mode) -> Any:
    """Return the MHKiT dataset (xarray) of one mode.

    Raises:
        LogError: MHKiT is not installed or fails.
    """
    _, read_signature = _readers(path)
    # MHKiT needs a second ping to know how long one is
    alone = len(mode.pings) == 1
    pings = _numbered(2 * mode.pings if alone else mode.pings)
    (dataset,) = _read(
        path, b"".join([mode.text, *pings]), lambda copy: [read_signature(copy, userdata=False)]
    )
    if not alone:
        return dataset
    return dataset.isel(
        {name: slice(0, 1) for name in dataset.dims if str(name).startswith("time")}
    )


def _numbered(pings: Sequence[bytes]) -> Iterator[bytes]:
    """Yield profile records with consecutive ensemble counters, as MHKiT merges or drops others.

    Checksums are not updated: MHKiT does not verify them.
    """
    numbers: Counter[int] = Counter()
    for ping in pings:
        numbers[ping[_KIND]] += 1
        at = ping[1] + _ENSEMBLE
        yield ping[:at] + struct.pack("<I", numbers[ping[_KIND]]) + ping[at + 4 :]


def _read(path: Path, content: bytes, read: Callable[[str], list[Any]]) -> list[Any]:
    """Return the result of MHKiT for a file of this content."""
    with tempfile.TemporaryDirectory() as folder, _without_output():
        copy = Path(folder) / "records"
        copy.write_bytes(content)
        # MHKiT raises whatever its arithmetic raises on settings it does not know, bare Exception too
        try:
            return read(os.fspath(copy))
        except Exception as error:
            words = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    # not raised from the error, which would keep the file that MHKiT left open
    raise LogError(f"{path}: MHKiT cannot read this raw ADCP file: {words}")


def _readers(path: Path) -> tuple[Any, Any]:
    try:
        with _without_output():
            from mhkit.dolfyn.io.nortek2 import read_signature
            from mhkit.dolfyn.io.rdi import read_rdi
    except ImportError as error:
        raise LogError(
            f"{path}: raw ADCP files need MHKiT; pip install 'replay-kit[adcp]'"
        ) from error
    return read_rdi, read_signature


@contextlib.contextmanager
def _without_output() -> Iterator[None]:
    """Suppress output, log records and warnings of MHKiT."""
    # without a handler of its own the root logger would be configured for the whole program by the first warning
    handler, disabled = logging.NullHandler(), logging.root.manager.disable
    logging.root.addHandler(handler)
    logging.disable()
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
        logging.root.removeHandler(handler)
