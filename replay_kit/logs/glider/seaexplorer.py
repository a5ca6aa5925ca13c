"""A SeaExplorer's raw text files as variables: columns between semicolons, perhaps compressed, of the vehicle or of its payload."""

import gzip
import re
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.logs.glider.netcdf import Choose, NetcdfFile, Stored, as_number
from replay_kit.logs.glider.recognise import FIRST_COLUMNS, GZIP_MAGIC

_DATE = re.compile(r"(\d{2})/(\d{2})/(\d{4}) (\d{2}:\d{2}:\d{2}(?:\.\d{1,6})?)")
_MOST = 1 << 30
_EPOCH = {"units": "seconds since 1970-01-01"}


def open_seaexplorer(path: Path, choose: Choose) -> NetcdfFile:
    """Return the columns of a file that are chosen, as variables.

    A line that has not as many columns as the heading is left out; a field that is no number is missing.

    Raises:
        LogError: The file cannot be read.
    """
    try:
        with open(path, "rb") as raw:
            compressed = raw.read(2) == GZIP_MAGIC
        with gzip.open(path, "rb") if compressed else open(path, "rb") as file:
            lines = file.read(_MOST).decode("utf-8-sig", "replace").splitlines()
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(
            f"{path}: cannot be read as a SeaExplorer's file: {error}; is the file whole?"
        ) from error
    names = [name.strip() for name in lines[0].split(";")]
    rows = [fields for line in lines[1:] if len(fields := line.split(";")) == len(names)]
    attributes = {"lines_left_out": sum(bool(line.strip()) for line in lines[1:]) - len(rows)}
    wanted = choose(names, attributes)
    columns = {
        name: [row[k] for row in rows] for k, name in enumerate(names) if name and name in wanted
    }
    variables = {
        name: Stored(_times(fields), _EPOCH, ("line",))
        if name.lower() in FIRST_COLUMNS
        else Stored(_numbers(fields), {}, ("line",))
        for name, fields in columns.items()
    }
    return NetcdfFile(path, attributes, variables, tuple(filter(None, names)))


def _times(fields: list[str]) -> NDArray[np.float64]:
    """Return seconds since 1970 of dd/mm/yyyy hh:mm:ss; NaN where a field is no time."""
    matches = [_DATE.fullmatch(field.strip()) for field in fields]
    iso = [f"{m[3]}-{m[2]}-{m[1]}T{m[4]}" if m else "NaT" for m in matches]
    try:
        found = np.array(iso, "datetime64[ms]")
    except ValueError:
        found = np.array([_or_nat(text) for text in iso], "datetime64[ms]")
    return np.where(np.isnat(found), np.nan, found.astype(np.int64) / 1000.0)


def _or_nat(text: str) -> np.datetime64:
    try:
        return np.datetime64(text, "ms")
    except ValueError:
        return np.datetime64("NaT", "ms")


def _numbers(fields: list[str]) -> NDArray[np.float64]:
    try:
        return np.array([field or "nan" for field in fields], np.float64)
    except ValueError:
        return np.array([as_number(field) for field in fields])
