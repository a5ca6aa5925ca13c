"""Ensemble and truth files (CF NetCDF-3, NetCDF-4, Zarr) to ``Ensemble`` values."""

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.config.run import ForecastConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.core.paths import as_path
from replay_kit.forecast.depths import in_metres
from replay_kit.forecast.grid import grid_to_local, local_grid, region_slices, true_to_local, wet_mask
from replay_kit.forecast.names import MEMBER_NAMES, find_coordinate, find_depth, find_member, find_velocity
from replay_kit.forecast.times import choose_time

_SPEED_UNITS = {"m s-1": 1.0, "m/s": 1.0, "meter second-1": 1.0, "m.s-1": 1.0, "meters/second": 1.0, "cm s-1": 0.01, "cm/s": 0.01}
_HINT = "give the path of a NetCDF file or a Zarr store"


def read_ensemble(
    path: str | Path, config: ForecastConfig, *, near_ns: int | None = None, place_at: tuple[float, float] | None = None
) -> Ensemble:
    """Return the chosen part of an ensemble forecast in its local frame.

    Args:
        path: NetCDF file or Zarr store.
        config: Region, levels, lead and time.
        near_ns: The log's middle time [ns, UTC]: among several times or dated leads the nearest is taken unless the
            configuration names one.
        place_at: (longitude, latitude) to move the ensemble's centre to.

    Raises:
        ForecastError: The file is missing or unreadable, or has no member dimension, current or coordinates, or nothing is
            inside the region.
    """
    with open_forecast(path) as ds:
        u, _, _ = find_velocity(ds, str(path))
        member = find_member(ds, u.dims)
        if member is None:
            raise ForecastError(f"{path}: no member dimension; expected one of {', '.join(MEMBER_NAMES)}, got dimensions {_sizes(u)}")
        if u.sizes[member] < 2:
            raise ForecastError(f"{path}: an ensemble needs at least 2 members, got {u.sizes[member]}")
        return _read(ds, member, config, near_ns, place_at, str(path))


def read_truth(spec: str, config: ForecastConfig, *, near_ns: int | None = None, place_at: tuple[float, float] | None = None) -> Ensemble:
    """Return a truth, an ensemble of one, from ``PATH`` or ``PATH#MEMBER``.

    Args:
        spec: Path; the part after ``#`` is a member's label, or its position from 0 where the file has no labels.
        config: As in ``read_ensemble``.
        near_ns: As in ``read_ensemble``.
        place_at: As in ``read_ensemble``.

    Raises:
        ForecastError: As in ``read_ensemble``, or the member is not there, or is needed and not named.
    """
    name, _, label = spec.partition("#")
    with open_forecast(Path(name)) as ds:
        u, v, _ = find_velocity(ds, name)
        member = find_member(ds, u.dims)
        if member is None:
            if label:
                raise ForecastError(f"{name}: member '{label}' asked for, but the file has no member dimension; leave out '#{label}'")
            member = "replay_kit_member"
            field = ds.assign({part.name: part.expand_dims(member) for part in (u, v)})
        elif label:
            field = ds.isel({member: [_member_position(ds, member, label, name)]})
        elif u.sizes[member] > 1:
            raise ForecastError(f"{name}: {u.sizes[member]} members; name the one that is the truth as '{name}#MEMBER'")
        else:
            field = ds
        return _read(field, member, config, near_ns, place_at, spec)


def open_forecast(path: str | Path) -> xr.Dataset:
    """Return a forecast's file, opened.

    Raises:
        ForecastError: It is missing, or neither NetCDF nor Zarr.
    """
    path = as_path(path, "ensemble")
    if not path.exists():
        raise ForecastError(f"{path}: no such file; {_HINT}")
    if path.is_dir():
        engine = "zarr"
    else:
        with path.open("rb") as stream:
            head = stream.read(8)
        engine = "scipy" if head[:3] == b"CDF" else "h5netcdf" if head[1:4] == b"HDF" else ""
    if not engine:
        raise ForecastError(f"{path}: neither NetCDF nor Zarr; it begins with {head.hex(' ') or 'nothing'}; {_HINT}")
    try:
        options = {"consolidated": None} if engine == "zarr" else {}
        return xr.open_dataset(path, engine=engine, decode_timedelta=False, **options)  # type: ignore[arg-type]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ForecastError(f"{path}: cannot be read as {engine}: {error}; {_HINT}") from error


def _sizes(variable: xr.DataArray) -> str:
    return ", ".join(f"{dim} = {size}" for dim, size in variable.sizes.items())


def _member_position(ds: xr.Dataset, member: str, label: str, where: str) -> int:
    labels = [str(value) for value in ds[member].values] if member in ds.coords else [str(i) for i in range(ds.sizes[member])]
    if label not in labels:
        raise ForecastError(f"{where}: no member '{label}'; the file has {labels[0]} to {labels[-1]} ({len(labels)} members)")
    return labels.index(label)


def _read(
    ds: xr.Dataset, member: str, config: ForecastConfig, near_ns: int | None, place_at: tuple[float, float] | None, source: str
) -> Ensemble:
    ds, time_ns, of_time = choose_time(ds, config, near_ns, source)
    longitude, latitude, horizontal = _horizontal(ds, source)
    if config.region is not None:
        block = region_slices(longitude, latitude, config.region)
        if block is None:
            raise ForecastError(
                f"{source}: no grid point inside the region {config.region} (west, south, east, north); the file covers "
                f"{longitude.min():.3f}..{longitude.max():.3f} E, {latitude.min():.3f}..{latitude.max():.3f} N"
            )
        ds = ds.isel(dict(zip(horizontal, block, strict=True)))
        longitude, latitude = longitude[block], latitude[block]
    if min(longitude.shape) < 2:
        raise ForecastError(f"{source}: the region holds a grid of {longitude.shape}; at least 2 x 2 points are needed: widen --region")
    u, v, axes = find_velocity(ds, source)
    middle = 0.5 * float(latitude.min() + latitude.max())
    levels, order, depth, of_depth = _levels(ds, u, config, middle, source)
    velocity = np.stack([_array(part, member, depth, horizontal, order, source) for part in (u, v)], axis=1)
    wet, zero_columns = wet_mask(velocity)
    if not wet[0].any():
        raise ForecastError(f"{source}: every point of the first level is land; check the region and the variables' missing values")
    _refuse_holes(velocity, wet, source)
    velocity = np.where(wet, velocity, np.nan)
    if axes == "grid":
        unplaced = local_grid(longitude, latitude, levels, wet, None)
        velocity = grid_to_local(unplaced.east, unplaced.north, velocity)
    else:
        projection = local_grid(longitude, latitude, levels, wet, None).projection
        velocity = true_to_local(projection, longitude, latitude, velocity)
    grid = local_grid(longitude, latitude, levels, wet, place_at)
    return Ensemble(grid, velocity, time_ns, source, (*of_time, *_notes(grid, zero_columns, place_at), *of_depth))


def _refuse_holes(velocity: Array, wet: NDArray[np.bool_], source: str) -> None:
    """Raise ForecastError when a member misses water that another has: its land would otherwise become everyone's."""
    missing = (~np.isfinite(velocity).all(axis=1) & wet).sum(axis=(1, 2, 3))
    if missing.any():
        worst = int(np.argmax(missing))
        raise ForecastError(
            f"{source}: {int(np.count_nonzero(missing))} members miss values where others have them, member at position {worst} most "
            f"({int(missing[worst])} of {int(wet.sum())} points); leave such members out of the file"
        )


def _notes(grid: Grid, zero_columns: int, place_at: tuple[float, float] | None) -> tuple[str, ...]:
    notes = []
    if zero_columns:
        notes.append(f"{zero_columns} columns whose current is exactly zero in every member were taken for land")
    if place_at is not None:
        notes.append(
            f"the ensemble was moved so that its centre lies at {place_at[1]:.4f} N, {place_at[0]:.4f} E: "
            "what it says of this place is no forecast"
        )
    return tuple(notes)


def _horizontal(ds: xr.Dataset, where: str) -> tuple[Array, Array, tuple[str, str]]:
    """Return longitude and latitude, both (J, I), and the names of the two dimensions."""
    longitude, latitude = find_coordinate(ds, "longitude", where), find_coordinate(ds, "latitude", where)
    if longitude.ndim != latitude.ndim:
        raise ForecastError(f"{where}: longitude has {longitude.ndim} dimensions and latitude {latitude.ndim}; both must have 1 or both 2")
    if longitude.ndim == 1:
        dims = (str(latitude.dims[0]), str(longitude.dims[0]))
        x, y = np.meshgrid(longitude.values.astype(np.float64), latitude.values.astype(np.float64))
    else:
        dims = (str(longitude.dims[0]), str(longitude.dims[1]))
        x, y = longitude.values.astype(np.float64), latitude.transpose(*dims).values.astype(np.float64)
    if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.abs(y) <= 90.0).all()):
        raise ForecastError(
            f"{where}: longitude or latitude holds missing values or latitudes beyond 90 degrees; swapped or damaged coordinates?"
        )
    return x, y, dims


def _levels(
    ds: xr.Dataset, u: xr.DataArray, config: ForecastConfig, latitude: float, where: str
) -> tuple[Array, NDArray[np.int64], str | None, tuple[str, ...]]:
    """Return the levels used [m, increasing], their positions in the file, the depth dimension (None: one level at 0 m), and notes."""
    depth = find_depth(ds, u.dims)
    if depth is None:
        return np.zeros(1), np.zeros(1, dtype=np.int64), None, ()
    if depth not in ds.coords:
        raise ForecastError(f"{where}: dimension {depth} has no coordinate values; add a depth coordinate in metres")
    values, notes = in_metres(ds[depth], latitude, where)
    if ds[depth].attrs.get("positive", "").lower() == "up" or np.all(values <= 0.0):
        values = -values
    order = np.argsort(values, kind="stable")
    if config.levels is not None:
        nearest = [int(np.argmin(np.abs(values[order] - wanted))) for wanted in config.levels]
        order = order[np.unique(nearest)]
    order = order[:: config.level_step]
    levels = values[order]
    if not np.isfinite(levels).all() or levels[0] < 0.0 or np.any(np.diff(levels) <= 0.0):
        raise ForecastError(f"{where}: depths must be finite, at or below the surface and distinct, got {levels.tolist()}")
    return levels, order, depth, notes


def _array(part: xr.DataArray, member: str, depth: str | None, horizontal: tuple[str, str], order: NDArray[np.int64], where: str) -> Array:
    """Return one component, shape (E, Z, J, I) [m/s]."""
    if depth is None:
        part, depth = part.expand_dims("replay_kit_depth"), "replay_kit_depth"
    wanted = (member, depth, *horizontal)
    if set(part.dims) != set(wanted):
        raise ForecastError(f"{where}: {part.name} has dimensions {_sizes(part)}; expected {', '.join(wanted)} after choosing a time")
    unit = str(part.attrs.get("units", "m s-1")).strip()
    if unit not in _SPEED_UNITS:
        raise ForecastError(f"{where}: {part.name} is in '{unit}'; expected m s-1 or cm s-1")
    return np.asarray(part.transpose(*wanted).isel({depth: order}).values, dtype=np.float64) * _SPEED_UNITS[unit]
