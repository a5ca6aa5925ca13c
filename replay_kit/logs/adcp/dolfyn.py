"""Raw ADCP files through MHKiT's dolfyn reader, isolated: it prints, logs, warns and writes an index file next to its input."""

import contextlib
import io
import logging
import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.records import AD2CP_TEXT, PD0_MAGIC, Record

_AVERAGE, _BURST = 0x16, 0x15


def read_datasets(path: Path, data: bytes, records: Sequence[Record]) -> list[Any]:
    """Return the datasets (xarray) that MHKiT makes of the sound records of a file.

    Args:
        path: The file, for messages.
        data: Its bytes.
        records: The records to decode.

    Raises:
        LogError: MHKiT is not installed, there is nothing to read, or it cannot read this.
    """
    read_rdi, read_signature = _readers(path)
    kinds = {record.kind for record in records}
    teledyne = data[:2] == PD0_MAGIC
    if not records or (not teledyne and not kinds & {_AVERAGE, _BURST}):
        raise LogError(f"{path}: no sound ensemble of velocities is in it (checksums); copy it from the instrument again")
    if not teledyne and AD2CP_TEXT not in kinds:
        raise LogError(f"{path}: the record with the instrument's configuration is missing or damaged; copy the file again")
    with tempfile.TemporaryDirectory() as folder, _quiet():
        copy = Path(folder) / "records"
        parts = [data[record.start : record.end] for record in (records if teledyne else _of_use(records))]
        # of PD0 MHKiT reads an ensemble only where another follows, and needs two to begin
        copy.write_bytes(b"".join([*parts, parts[-1], parts[-1]] if teledyne else parts))
        # MHKiT raises whatever its arithmetic raises on settings it does not know, bare Exception too
        try:
            if teledyne:
                return [read_rdi(os.fspath(copy), userdata=False, nens=len(records), debug=0)]
            read = read_signature(os.fspath(copy), userdata=False, dual_profile=kinds >= {_AVERAGE, _BURST})
            datasets = list(read) if isinstance(read, tuple) else [read]
            # of two modes MHKiT leaves the file's configuration with the first
            return [dataset.assign_attrs({**datasets[0].attrs, **dataset.attrs}) for dataset in datasets]
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
        raise LogError(f"{path}: raw ADCP files are read through MHKiT, which is not installed; pip install 'replay-kit[adcp]'") from error
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
