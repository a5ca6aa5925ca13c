"""Files of the arguments of ``--ensemble``, opened with velocities left on disk and times as dates."""

import glob
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.files.inputs import exceeds_claim, open_input, packed_fill
from replay_kit.core.files.paths import Address, Paths, as_groups
from replay_kit.core.words.quantities import seconds
from replay_kit.core.words.text import count_text
from replay_kit.forecast.names import find_mesh

_ENDINGS = (".nc", ".nc4", ".nc3", ".cdf", ".netcdf", ".zarr")
#: Names of files of which a Zarr store has one.
STORE_MARKS = (".zgroup", ".zmetadata", ".zattrs", "zarr.json")
# EnKF-C writes these beside the members that it read
_RESULTS = (".analysis", ".increment")


@dataclass(frozen=True, slots=True)
class Sources:
    """Files of an ensemble, by argument.

    Attributes:
        arguments: Files of each argument, in natural order of the numbers in their names.
        notes: Excluded files with the reason.
    """

    arguments: tuple[tuple[Path, ...], ...]
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[Path, ...]:
        """All files, argument by argument."""
        return tuple(path for argument in self.arguments for path in argument)


def find_sources(given: Paths) -> Sources:
    """Return the files that match the arguments.

    A folder stands for the NetCDF files and Zarr stores below it. Results of an assimilation (``.analysis``, ``.increment``) in folders
    and patterns are excluded with a note.

    Args:
        given: Files, Zarr stores, folders, and patterns with ``*``, ``?`` or ``[...]``; a sequence of several is one argument.

    Raises:
        ForecastError: A file is missing or given twice, or a pattern or folder holds nothing to read.
    """
    arguments, notes = [], []
    for argument in as_groups(given, "ensemble"):
        files: tuple[Path, ...] = ()
        for path in argument:
            found, left_out = _files_of(path)
            files += found
            if left_out:
                some = f"{count_text(len(left_out), 'analysis file')} excluded ({left_out[0].name} ...)"
                notes.append(f"{path}: {some}; list them by name if they are the members")
        arguments.append(files)
    seen: set[Path] = set()
    for file in (file for argument in arguments for file in argument):
        if (whole := file.resolve()) in seen:
            raise ForecastError(f"{file}: given twice; remove one")
        seen.add(whole)
    return Sources(tuple(arguments), tuple(notes))


def ensemble_files(given: Paths) -> tuple[Path, ...]:
    """Return the files of the arguments of ``--ensemble``, in reading order; see ``find_sources``.

    Raises:
        ForecastError: See ``find_sources``.
    """
    return find_sources(given).files


def source_of(files: Sequence[Path]) -> str:
    """Return the names of files, for messages."""
    one, more = files[0], len(files) > 1
    return f"{len(files)} files, {one} to {files[-1].name}" if more else str(one)


def natural_order(path: Path) -> list[tuple[int, int | str]]:
    """Return a sort key that orders the numbers in a name by value."""
    return [
        (0, int(part)) if part.isdigit() else (1, part)
        for part in re.split(r"(\d+)", str(path))
        if part
    ]


def _files_of(path: Path) -> tuple[tuple[Path, ...], list[Path]]:
    """Return the files of one argument, and the excluded results."""
    if isinstance(path, Address):
        return (path,), []
    if not path.exists() and glob.has_magic(str(path)):
        found = [Path(name) for name in glob.glob(str(path), recursive=True)]
        what = "no file matches this pattern; check the folder and the pattern, and quote it if the shell changes it"
    elif path.is_dir() and not is_store(path):
        found = _inside(path)
        what = f"the folder holds no NetCDF file and no Zarr store (names ending in {', '.join(_ENDINGS)})"
    else:
        return (path,), []
    results = [file for file in found if any(mark in file.name for mark in _RESULTS)]
    kept = sorted((file for file in found if file not in results), key=natural_order)
    if not kept and results:
        raise ForecastError(
            f"{path}: holds only analysis results, such as {results[0].name}; give the members, or list the results one by one"
        )
    if not kept:
        raise ForecastError(f"{path}: {what}")
    return tuple(kept), results


def is_store(path: Path) -> bool:
    """Return whether a folder is a Zarr store."""
    return path.suffix == ".zarr" or any((path / mark).exists() for mark in STORE_MARKS)


def _inside(folder: Path) -> list[Path]:
    found: list[Path] = []
    for path in folder.iterdir():
        if path.is_dir() and not is_store(path):
            found += _inside(path)
        elif path.name.startswith("."):
            continue
        elif path.is_dir() or any(ending in path.name.lower() for ending in _ENDINGS):
            found.append(path)
    return found


_HINT = "give the path of a NetCDF file or a Zarr store"
# What nanoseconds in 64 bits can hold.
_FIRST, _LAST = np.datetime64("1678-01-01", "us"), np.datetime64("2262-01-01", "us")
_CIVIL = ("standard", "gregorian", "proleptic_gregorian", "")


def _open_file(path: Path) -> xr.Dataset:
    """Return the dataset of a forecast file; only small coordinates are read.

    Times of every calendar become dates of the same name (31 January stays 31 January). Times without an epoch, or with dates
    outside the Gregorian calendar, stay numbers.

    Raises:
        ForecastError: The file is missing, or neither NetCDF nor Zarr.
    """
    if isinstance(path, Address):
        # loads a client of servers
        from replay_kit.forecast.remote.servers import open_address

        return with_dates(open_address(path))
    if not path.exists():
        raise ForecastError(f"{path}: no such file; {_HINT}")
    if path.is_dir():
        engine = "zarr"
    else:
        try:
            with open_input(path) as stream:
                head = stream.read(8)
        except OSError as error:
            raise ForecastError(f"{path}: cannot be read: {error.strerror}; {_HINT}") from error
        engine = "scipy" if head[:3] == b"CDF" else "h5netcdf" if head[1:4] == b"HDF" else ""
    if not engine:
        found = f"it begins with {head.hex(' ') or 'nothing'}"
        if head[:4] == b"PK\x03\x04":
            found = "it is a zip archive, to be unpacked"
        raise ForecastError(f"{path}: neither NetCDF nor Zarr; {found}; {_HINT}")
    try:
        ds = _opened_store(path) if engine == "zarr" else _opened_netcdf(path, engine)
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RuntimeError) as error:
        raise ForecastError(f"{path}: cannot be read as {engine}: {error}; {_HINT}") from error
    if (mesh := find_mesh(ds)) is not None:
        # takes a while to load
        from replay_kit.forecast.grids.meshes import on_grid

        ds = on_grid(ds, mesh, str(path))
    return with_dates(ds)


@contextmanager
def opened_file(path: Path) -> Iterator[xr.Dataset]:
    """Give the dataset of a file and close it at the end; raises the errors of ``_open_file``.

    NetCDF-3 values that are still referenced stay mapped until released, which is harmless.
    """
    ds = _open_file(path)
    try:
        yield ds
    finally:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Cannot close a netcdf_file", RuntimeWarning)
            ds.close()


def with_dates(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with its times as dates, if they have any."""
    dates = {
        name: found
        for name in ds.variables
        if (found := times_as_dates(ds.variables[name])) is not None
    }
    return ds.assign(dates) if dates else ds


def _opened_netcdf(path: Path, engine: str) -> xr.Dataset:
    if engine == "scipy":
        return _opened(path, engine)
    shapes: list[tuple[int, ...]] = []

    def add(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            shapes.append(item.shape)

    with h5py.File(path, "r") as file:
        file.visititems(add)
    _check_coordinates(path, shapes)
    return _opened(path, engine, phony_dims="access")


def _opened_store(path: Path) -> xr.Dataset:
    """Return the dataset of a Zarr store."""
    # its import takes longer than those of a command that reads NetCDF alone
    import zarr

    with warnings.catch_warnings():
        # of what else lies in the store
        warnings.filterwarnings("ignore", "Object at .* is not recognized")
        arrays = zarr.open_group(path, mode="r").arrays()
        _check_coordinates(path, [array.shape for _, array in arrays])
        return _opened(path, "zarr", consolidated=None)


def _opened(source: Any, engine: str, **options: Any) -> xr.Dataset:
    with warnings.catch_warnings():
        # packed values whose fill value the packing cannot hold; land is then found by its constant value
        warnings.simplefilter("ignore", xr.SerializationWarning)
        # a store without consolidated metadata is read none the less
        warnings.filterwarnings(
            "ignore", "Failed to open Zarr store with consolidated metadata", RuntimeWarning
        )
        stored = xr.open_dataset(source, engine=engine, decode_cf=False, **options)
        for variable in stored.variables.values():
            about = variable.attrs
            if "scale_factor" in about:
                packing = [
                    float(np.ravel(about.get(key, 0.0))[0])
                    for key in ("scale_factor", "add_offset")
                ]
                for key in ("_FillValue", "missing_value"):
                    if key in about:
                        about[key] = packed_fill(about[key], variable.dtype, *packing)
        return xr.decode_cf(stored, decode_times=False, decode_timedelta=False)


def _check_coordinates(path: Path, shapes: Sequence[tuple[int, ...]]) -> None:
    """Raise ForecastError if coordinates, which are read whole, are implausibly large for their file."""
    # arrays of one or two dimensions
    small = [shape for shape in shapes if sum(size > 1 for size in shape) <= 2]
    if why := exceeds_claim(path, sum(8 * math.prod(shape) for shape in small)):
        raise ForecastError(
            f"{path}: its coordinates cannot be read: {why}; were its values written? give the whole file"
        )


def why_undated(variable: xr.Variable | xr.DataArray) -> str:
    """Return the reason why times have no date: the unit and calendar stated by the file."""
    unit, calendar = variable.attrs.get("units", "none"), variable.attrs.get("calendar", "")
    return f"unit '{unit}'" + (f", calendar {calendar}" if calendar else "")


def times_as_dates(variable: xr.Variable) -> xr.Variable | None:
    """Return times as dates; None for a variable that is not a time with an epoch."""
    units, calendar = (str(variable.attrs.get(key, "")) for key in ("units", "calendar"))
    if " since " not in units or variable.ndim > 1 or variable.dtype.kind not in "iuf":
        return None
    civil = calendar.lower() in _CIVIL
    dates = _whole(variable.values, units) if civil and calendar else None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if dates is None:
                coder = xr.coders.CFDatetimeCoder(use_cftime=not civil)
                dates = coder.decode(variable, name="time").values
            if not civil:
                names = [moment.isoformat() for moment in dates.ravel()]
                dates = np.array(names, "M8[us]").reshape(dates.shape)
        if np.any((dates < _FIRST) | (dates > _LAST)):
            return None
        left_out = ("units", "calendar") if civil else ("units",)
        attributes = {key: value for key, value in variable.attrs.items() if key not in left_out}
        return xr.Variable(variable.dims, dates.astype("M8[ns]"), attributes)
    except (ValueError, OverflowError, TypeError, AttributeError, Warning):
        return None


def _whole(values: np.ndarray, units: str) -> np.ndarray | None:
    """Return the dates of whole numbers of a civil unit, for which one epoch is decoded; None for others."""
    epoch, length = _epoch(units), seconds(units.partition(" since ")[0].strip()) or 0.0
    most = np.abs(values).max(initial=0.0) * length
    # a second at least, within what microseconds in 64 bits can hold
    if epoch is None or length < 1.0 or most > 1e12 or not np.all(values == np.round(values)):
        return None
    whole = values.astype(np.int64) * np.timedelta64(int(length), "s")
    return np.asarray(epoch + whole)


@cache
def _epoch(units: str) -> np.ndarray | None:
    """Return the epoch of a civil unit to the microsecond."""
    with suppress(ValueError):
        # files of a year may each have their own; most are plain dates, which xarray takes long to read
        moment = datetime.fromisoformat(units.partition(" since ")[2].strip())
        # earlier ones may be Julian
        if moment.tzinfo is None and moment.year > 1582:
            return np.array(moment, "M8[us]")
    found = times_as_dates(xr.Variable((), 0, {"units": units}))
    return None if found is None else found.values.astype("M8[us]")
