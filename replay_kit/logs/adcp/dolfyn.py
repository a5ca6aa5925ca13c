"""Raw ADCP files through MHKiT's dolfyn reader, isolated: it prints, logs, warns and writes an index file next to its input."""

import contextlib
import io
import logging
import os
import struct
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.records import AD2CP_TEXT, Record

_AVERAGE, _BURST = 0x16, 0x15
#: Where a record's kind is in its head, and a profile's ensemble counter in its data [bytes].
_KIND, _ENSEMBLE = 2, 72
NO_ENSEMBLE = (
    "no sound ensemble of velocities is in it (checksums); copy it from the instrument again"
)


def read_pd0(path: Path, parts: Sequence[bytes], has_pressure: bool) -> Any:
    """Return the dataset (xarray) that MHKiT makes of ensembles of one configuration.

    Args:
        path: The file, for messages.
        parts: The ensembles.
        has_pressure: Whether their leaders hold the pressure; it is left out where they do not.

    Raises:
        LogError: MHKiT is not installed, or cannot read this.
    """
    read_rdi, _ = _readers(path)
    # MHKiT reads an ensemble only where another follows, and needs two to begin
    (dataset,) = _read(
        path,
        b"".join([*parts, parts[-1], parts[-1]]),
        lambda copy: [read_rdi(copy, userdata=False, nens=len(parts), debug=0)],
    )
    return dataset if has_pressure else dataset.drop_vars("pressure", errors="ignore")


def read_ad2cp(path: Path, data: bytes, records: Sequence[Record]) -> list[Any]:
    """Return the datasets (xarray) that MHKiT makes of the sound records of an AD2CP file.

    Args:
        path: The file, for messages.
        data: Its bytes.
        records: Its sound records.

    Raises:
        LogError: MHKiT is not installed, there is nothing to read, or it cannot read this.
    """
    _, read_signature = _readers(path)
    kinds = {record.kind for record in records}
    if not kinds & {_AVERAGE, _BURST}:
        raise LogError(f"{path}: {NO_ENSEMBLE}")
    if AD2CP_TEXT not in kinds:
        raise LogError(
            f"{path}: the record with the instrument's configuration is missing or damaged; copy the file again"
        )

    def read(copy: str) -> list[Any]:
        found = read_signature(copy, userdata=False, dual_profile=kinds >= {_AVERAGE, _BURST})
        datasets = list(found) if isinstance(found, tuple) else [found]
        # of two modes MHKiT leaves the file's configuration with the first
        return [
            dataset.assign_attrs({**datasets[0].attrs, **dataset.attrs}) for dataset in datasets
        ]

    first, *pings = [data[record.start : record.end] for record in _of_use(records)]
    # MHKiT needs a second ping to know how long one is
    alone = len(pings) == 1
    datasets = _read(path, b"".join([first, *_numbered(2 * pings if alone else pings)]), read)
    return [
        dataset.isel({name: slice(0, 1) for name in dataset.dims if str(name).startswith("time")})
        if alone
        else dataset
        for dataset in datasets
    ]


def _numbered(pings: Sequence[bytes]) -> Iterator[bytes]:
    """Yield records of profiles whose ensemble counters go up by one; MHKiT merges or leaves out pings where they do not.

    Checksums are not made anew: MHKiT does not ask for them.
    """
    numbers: Counter[int] = Counter()
    for ping in pings:
        numbers[ping[_KIND]] += 1
        at = ping[1] + _ENSEMBLE
        yield ping[:at] + struct.pack("<I", numbers[ping[_KIND]]) + ping[at + 4 :]


def _read(path: Path, content: bytes, read: Callable[[str], list[Any]]) -> list[Any]:
    """Return what MHKiT reads of a file with this content."""
    with tempfile.TemporaryDirectory() as folder, _quiet():
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
        with _quiet():
            from mhkit.dolfyn.io.nortek2 import read_signature
            from mhkit.dolfyn.io.rdi import read_rdi
    except ImportError as error:
        raise LogError(
            f"{path}: raw ADCP files are read through MHKiT, which is not installed; pip install 'replay-kit[adcp]'"
        ) from error
    return read_rdi, read_signature


def _of_use(records: Sequence[Record]) -> list[Record]:
    """Return the configuration, then the profiles: MHKiT pairs all kinds of records by ensemble, and stumbles where some are lost."""
    text = next(record for record in records if record.kind == AD2CP_TEXT)
    return [text, *(record for record in records if record.kind in (_BURST, _AVERAGE))]


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress output, log records and warnings: the reader counts what they are about."""
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
