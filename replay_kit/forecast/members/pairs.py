"""Files of one component, both, or only the grid, joined to datasets with both components and the grid."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import xarray as xr

from replay_kit.core.errors import ForecastError
from replay_kit.core.words.text import count_text, some_text
from replay_kit.forecast.field import Field
from replay_kit.forecast.files import natural_order
from replay_kit.forecast.grids.layout import DIRECTION, STAGGERED, U, V
from replay_kit.forecast.names import MESH, Current, find_time

_TIMES_OF_GRIDS = ("time", "time_counter", "time_steps", "ocean_time")


_AXES = ("lon", "lat", "longitude", "latitude", "nav_lon", "nav_lat")


def _without_repeats(ds: xr.Dataset, where: str) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return a dataset without repeated longitudes and latitudes, and notes on these.

    Raises:
        ForecastError: Values at repeated places differ, or coordinates are not monotonic.
    """
    notes = [note for note in (ds.attrs.get(MESH),) if note]
    axes = [
        axis.astype(np.float64)
        for name, axis in ds.variables.items()
        if (str(name).lower() in _AXES or axis.attrs.get("standard_name") in _AXES)
        and axis.dtype.kind in "fiu"
    ]
    for dim in dict.fromkeys(dim for axis in axes for dim in axis.dims if axis.ndim in (1, 2)):
        if ds.sizes[dim] < 2:
            continue
        along = [
            np.moveaxis(axis.values, axis.dims.index(dim), 0) for axis in axes if dim in axis.dims
        ]
        steps = [(np.diff(values, axis=0) + 180.0) % 360.0 - 180.0 for values in along]
        for values, step in zip(along, steps, strict=True):
            back = np.flatnonzero(step.ravel() * np.sign(np.median(step)) < 0.0)
            if step.ndim == 1 and back.size:
                raise ForecastError(
                    f"{where}: {dim} is not monotonic: it turns at its value {back[0] + 2}, {values[back[0] + 1]:g}; put it in order"
                )
        still = [(step == 0.0).reshape(len(step), -1).all(axis=1) for step in steps]
        again = np.flatnonzero(np.all(still, axis=0)) + 1
        if again.size in (0, ds.sizes[dim] - 1):
            continue
        for held in (ds[U], ds[V]):
            if dim not in held.dims or not np.array_equal(
                held.isel({dim: again}), held.isel({dim: again - 1}), equal_nan=True
            ):
                raise ForecastError(
                    f"{where}: {dim} repeats the place of its position {again[0]} with other values of {held.attrs['replay_kit_name']}; "
                    "leave one out"
                )
        ds = ds.isel({dim: np.setdiff1d(np.arange(ds.sizes[dim]), again)})
        notes.append(f"{dim} repeats the places of {count_text(again.size, 'position')}: read once")
    return ds, tuple(notes)


def pair_files(files: Sequence[Field], grids: Sequence[Field]) -> tuple[Field, ...]:
    """Return the fields of files of both components, or of u and v, in order of time, joined with the grid when opened."""
    us, vs, both = (
        [file for file in files if file.holds == which]
        for which in ((True, False), (False, True), (True, True))
    )
    if len(us) != len(vs):
        (more, *_), name, missing = (us, "u", "v") if len(us) > len(vs) else (vs, "v", "u")
        assert more.current is not None
        as_member = f" as member {more.label}" if more.label else ""
        raise ForecastError(
            f"{more.where}: holds {more.current.u or more.current.v} and no {missing}; {count_text(len(us), 'file')} of u and "
            f"{len(vs)} of v belong together{as_member}: give a file of {missing} for each file of {name}"
        )
    in_order = [sorted(group, key=lambda file: natural_order(file.paths[0])) for group in (us, vs)]
    pairs = [(file, file) for file in both] + list(zip(*in_order, strict=True))
    fields = [_pair(u, v, grids) for u, v in pairs]
    if all(field.times.size for field in fields):
        fields.sort(key=lambda field: int(field.times.min()))
    return tuple(fields)


def _pair(u: Field, v: Field, grids: Sequence[Field]) -> Field:
    """Return the field of a file of u and a file of v, which may be the same."""
    assert u.current is not None
    assert v.current is not None
    current = replace(u.current, v=v.current.v, axes=u.current.axes or v.current.axes)
    paths = u.paths if u is v else (*u.paths, *v.paths)
    load = cache(partial(_joined, u, v, current, grids))
    return replace(u, paths=paths, current=current, load=load)


def _joined(
    u: Field, v: Field, current: Current, grids: Sequence[Field]
) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return one dataset of the files of two components and of the grid, and notes on assumptions and unused files."""
    first = ds = u.load()[0]
    second = v.load()[0][current.v].variable
    if v is not u:
        second, ds = _with_second(ds, v, second, u.where)
    ds = ds.assign(
        {U: _marked(first[current.u].variable, current.u), V: _marked(second, current.v)}
    )
    if current.direction is not None:
        ds = ds.assign({DIRECTION: first[current.direction].variable})
        for name, turn in ((U, current.turn - 90.0), (V, current.turn)):
            ds[name].attrs["replay_kit_turn"] = turn
    notes = list(_assumptions(first, current))
    for grid in grids:
        if {"nyp", "nxp"} <= set(grid.ds.sizes):
            raise ForecastError(
                f"{grid.names}: a supergrid of MOM, in which each point of the currents has another place; give ocean_static.nc"
            )
        ds, fits = _with_grid(ds, grid.ds)
        if not fits:
            sizes = some_text([f"{dim} = {size}" for dim, size in grid.ds.sizes.items()])
            notes.append(
                f"{grid.names} holds no current, and its sizes ({sizes}) are not those of the velocities: it was not used"
            )
    ds, repeated = _without_repeats(ds, u.where)
    return ds, (*notes, *repeated)


def _assumptions(ds: xr.Dataset, current: Current) -> tuple[str, ...]:
    """Return the assumptions on a file's calendar and on coordinates that it names but lacks."""
    variable = ds[current.u]
    time = find_time(ds, variable.dims)
    calendar = (
        ds[time].attrs.get("calendar", "")
        if time is not None and ds[time].dtype.kind == "M"
        else ""
    )
    notes = (
        [f"times of the calendar {calendar} read as civil dates of the same name"]
        if calendar
        else []
    )
    if current.direction is not None:
        notes.append(f"components computed of {current.why}")
    named = str(variable.encoding.get("coordinates", variable.attrs.get("coordinates", ""))).split()
    lacking = [
        name
        for name in named
        if name not in ds.variables and ("lon" in name.lower() or "lat" in name.lower())
    ]
    if lacking:
        names = ", ".join(lacking)
        notes.append(
            f"coordinates {names} are named but missing in the file: nominal ones were used, unless a grid file has them"
        )
    return tuple(notes)


def _marked(variable: xr.Variable, name: str | None) -> xr.Variable:
    """Return a component with its name and, if packed, the unpacked value of 0."""
    offset = variable.encoding.get("add_offset", 0.0)
    marked = variable.copy(deep=False)
    marked.attrs = {
        **variable.attrs,
        "replay_kit_name": name,
        "replay_kit_offset": float(np.float32(offset)),
    }
    return marked


def _with_second(
    ds: xr.Dataset, file: Field, second: xr.Variable, where: str
) -> tuple[xr.Variable, xr.Dataset]:
    """Return the variable of v on dimensions without conflicts with the file of u, and that file with v's coordinates."""
    other = file.ds
    renamed = {
        dim: f"{dim}_of_v"
        for dim in second.dims
        if dim in ds.sizes and ds.sizes[dim] != other.sizes[dim]
    }
    for dim in second.dims:
        name = str(dim)
        times = name in other.coords and other[name].dtype.kind == "M"
        if (
            times
            and name in ds.coords
            and (dim in renamed or not np.array_equal(ds[name].values, other[name].values))
        ):
            raise ForecastError(
                f"{file.where}: its times ({other.sizes[name]} from {other[name].values[0]}) are not those of {where} "
                f"({ds.sizes[name]} from {ds[name].values[0]}); give files of u and v with the same times"
            )
        if dim not in ds.variables and name in other.coords and dim not in renamed:
            ds = ds.assign_coords({name: other[name].variable})
    for name in ("nav_lon", "nav_lat"):
        if name in ds.variables and name in other.variables and ds[name].shape == other[name].shape:
            apart = not np.array_equal(ds[name].values, other[name].values, equal_nan=True)
            ds = ds.assign_attrs({STAGGERED: True}) if apart else ds
    renamed_ds = other.drop_vars([dim for dim in renamed if dim in other.variables]).rename_dims(
        renamed
    )
    return renamed_ds.variables[file.current.v if file.current else None], ds


def _with_grid(ds: xr.Dataset, grid: xr.Dataset) -> tuple[xr.Dataset, bool]:
    """Return a dataset with missing variables of a grid file that match its dimensions, and whether any does."""
    added, fitting = {}, False
    for name, variable in grid.variables.items():
        single = [dim for dim in variable.dims if variable.sizes[dim] == 1 and dim not in ds.sizes]
        small = variable.isel(dict.fromkeys(single, 0))
        fits = all(ds.sizes.get(dim, small.sizes[dim]) == small.sizes[dim] for dim in small.dims)
        fitting |= fits and bool(set(small.dims) & set(ds.sizes))
        if (
            name not in ds.variables
            and name not in _TIMES_OF_GRIDS
            and fits
            and small.dtype.kind in "fiub"
        ):
            added[name] = small
    return ds.assign(added), fitting
