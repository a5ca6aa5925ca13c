"""One forecast file, opened: velocities stay on disk, times become dates where they have any."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import h5py
import numpy as np
import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import exceeds_claim
from replay_kit.forecast.sources import STORE_MARKS

_HINT = "give the path of a NetCDF file or a Zarr store"
# What nanoseconds in 64 bits can hold.
_FIRST, _LAST = np.datetime64("1678-01-01", "us"), np.datetime64("2262-01-01", "us")
# What is read without a word [bytes].
_LARGE = 2e9
_CIVIL = ("standard", "gregorian", "proleptic_gregorian", "")


def open_file(path: Path) -> xr.Dataset:
    """Return a forecast's file, opened; nothing but small coordinates is read.

    Times of every calendar become dates of the same name (31 January stays 31 January); times without an epoch, or with dates that no
    calendar of ours has, stay numbers.

    Raises:
        ForecastError: It is missing, or neither NetCDF nor Zarr.
    """
    if not path.exists():
        raise ForecastError(f"{path}: no such file; {_HINT}")
    if path.is_dir():
        engine = "zarr"
    else:
        with path.open("rb") as stream:
            head = stream.read(8)
        engine = (
            "scipy"
            if head[:3] == b"CDF"
            else "h5netcdf"
            if head[1:4] == b"HDF"
            else "zarr"
            if head[:4] == b"PK\x03\x04"
            else ""
        )
    if not engine:
        raise ForecastError(
            f"{path}: neither NetCDF nor Zarr; it begins with {head.hex(' ') or 'nothing'}; {_HINT}"
        )
    try:
        ds = _opened_store(path) if engine == "zarr" else _opened_netcdf(path, engine)
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        OverflowError,
        RuntimeError,
        BadZipFile,
    ) as error:
        raise ForecastError(f"{path}: cannot be read as {engine}: {error}; {_HINT}") from error
    dates = {
        name: dated for name in ds.variables if (dated := _dated(ds.variables[name])) is not None
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
    """Return a Zarr store, a folder or zipped, opened.

    Raises:
        ValueError: An archive is no store.
    """
    # its import takes longer than those of a command that reads NetCDF alone
    import zarr

    if path.is_file():
        with ZipFile(path) as archive:
            folders = {
                name.rpartition("/")[0]
                for name in archive.namelist()
                if name.rpartition("/")[2] in STORE_MARKS
            }
        if "" not in folders:
            inside = (
                f"a Zarr store in its folder {min(folders, key=len)}, not at its top"
                if folders
                else "no Zarr store"
            )
            raise ValueError(f"this zip archive holds {inside}; unpack it")
    store = zarr.storage.ZipStore(path, mode="r") if path.is_file() else path
    _check_coordinates(
        path, [array.shape for _, array in zarr.open_group(store, mode="r").arrays()]
    )
    return _opened(store, "zarr", consolidated=None)


def _opened(source: Any, engine: str, **options: Any) -> xr.Dataset:
    with warnings.catch_warnings():
        # packed values whose fill value the packing cannot hold; land is then found by its constant value
        warnings.simplefilter("ignore", xr.SerializationWarning)
        # a store without consolidated metadata is read none the less
        warnings.filterwarnings(
            "ignore", "Failed to open Zarr store with consolidated metadata", RuntimeWarning
        )
        return xr.open_dataset(
            source, engine=engine, decode_times=False, decode_timedelta=False, **options
        )


def _check_coordinates(path: Path, shapes: Sequence[tuple[int, ...]]) -> None:
    """Raise ForecastError where coordinates, which are read whole, are larger than a file can be meant to hold."""
    # arrays of one or two dimensions
    small = [shape for shape in shapes if sum(size > 1 for size in shape) <= 2]
    if why := exceeds_claim(path, _memory(small)):
        said = (
            f"its coordinates cannot be read: {why}; were its values written? give the whole file"
        )
        raise ForecastError(f"{path}: {said}{size_text(_memory(shapes))}")


def _memory(shapes: Sequence[tuple[int, ...]]) -> int:
    """Return what arrays take in memory [bytes]."""
    return sum(8 * math.prod(shape) for shape in shapes)


def size_text(size: float) -> str:
    """Return what is said of arrays that take more than 2 GB in memory [bytes], after a semicolon; nothing of smaller ones."""
    return (
        f"; its arrays take {size / 1e9:.1f} GB in memory, of which --region reads a part"
        if size > _LARGE
        else ""
    )


def undated(variable: xr.Variable | xr.DataArray) -> str:
    """Return why times have no date: the unit and calendar that the file states."""
    unit, calendar = variable.attrs.get("units", "none"), variable.attrs.get("calendar", "")
    return f"unit '{unit}'" + (f", calendar {calendar}" if calendar else "")


def _dated(variable: xr.Variable) -> xr.Variable | None:
    """Return times as dates; None for what is no time with an epoch."""
    if (
        " since " not in str(variable.attrs.get("units", ""))
        or variable.ndim > 1
        or variable.dtype.kind not in "iuf"
    ):
        return None
    civil = str(variable.attrs.get("calendar", "")).lower() in _CIVIL
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            coder = xr.coders.CFDatetimeCoder(use_cftime=not civil)
            decoded = coder.decode(variable, name="time").values
        dates = (
            decoded
            if civil
            else np.array([moment.isoformat() for moment in decoded.ravel()], "M8[us]").reshape(
                decoded.shape
            )
        )
        if np.any((dates < _FIRST) | (dates > _LAST)):
            return None
        left_out = ("units", "calendar") if civil else ("units",)
        attributes = {key: value for key, value in variable.attrs.items() if key not in left_out}
        return xr.Variable(variable.dims, dates.astype("M8[ns]"), attributes)
    except (ValueError, OverflowError, TypeError, AttributeError, Warning):
        return None
