"""One forecast file, opened: velocities stay on disk, times become dates where they have any."""

import warnings
from pathlib import Path

import h5py
import numpy as np
import xarray as xr

from replay_kit.core.claims import exceeds_claim
from replay_kit.core.errors import ForecastError

_HINT = "give the path of a NetCDF file or a Zarr store"
# What nanoseconds in 64 bits can hold.
_FIRST, _LAST = np.datetime64("1678-01-01", "us"), np.datetime64("2262-01-01", "us")
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
        engine = "scipy" if head[:3] == b"CDF" else "h5netcdf" if head[1:4] == b"HDF" else ""
    if not engine:
        raise ForecastError(
            f"{path}: neither NetCDF nor Zarr; it begins with {head.hex(' ') or 'nothing'}; {_HINT}"
        )
    options = {"zarr": {"consolidated": None}, "h5netcdf": {"phony_dims": "access"}}.get(engine, {})
    try:
        if engine == "h5netcdf" and (why := exceeds_claim(path, _small_arrays(path))):
            raise ValueError(why)
        with warnings.catch_warnings():
            # packed values whose fill value the packing cannot hold; land is then found by its constant value
            warnings.simplefilter("ignore", xr.SerializationWarning)
            ds = xr.open_dataset(
                path, engine=engine, decode_times=False, decode_timedelta=False, **options
            )  # type: ignore[arg-type]
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RuntimeError) as error:
        raise ForecastError(f"{path}: cannot be read as {engine}: {error}; {_HINT}") from error
    dates = {
        name: dated for name in ds.variables if (dated := _dated(ds.variables[name])) is not None
    }
    return ds.assign(dates) if dates else ds


def _small_arrays(path: Path) -> int:
    """Return what the arrays of one and two dimensions take in memory [bytes]: coordinates, which are read when a file is opened."""
    sizes: list[int] = []

    def add(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None and item.ndim <= 2:
            sizes.append(8 * item.size)

    with h5py.File(path, "r") as file:
        file.visititems(add)
    return sum(sizes)


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
