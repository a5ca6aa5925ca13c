"""Profiles of raw ADCP files decoded by MHKiT's dolfyn reader.

MHKiT does not verify checksums: it receives valid records only. It is isolated because it prints, logs, warns and writes an index file
next to its input.
"""

import contextlib
import io
import logging
import os
import re
import struct
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.frames import AD2CP_TEXT, Record

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
