"""Part of a remote data set to receive: variables and size, written piece by piece to a NetCDF file and checked."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError, ReplayKitError
from replay_kit.core.paths import Address
from replay_kit.core.progress import announce
from replay_kit.forecast.members.collection import Collection
from replay_kit.forecast.members.rules import kind_of
from replay_kit.forecast.names import SEA_LEVEL, find_depth
from replay_kit.forecast.remote.kept import RECORD
from replay_kit.forecast.remote.parts import Parts, Wanted, parts_of
from replay_kit.forecast.remote.servers import Served, in_words, served

# Values received at once [bytes].
_PIECE = 1 << 25
# Values of an axis, whatever it is of.
_SMALL = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Part of one data set to receive.

    Attributes:
        served: Data set.
        parts: Parts of its dimensions.
        names: Names of the variables.
        current: Names of the velocities among them.
    """

    served: Served
    parts: Parts
    names: tuple[str, ...]
    current: tuple[str, ...]

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the part of a variable."""
        variable = self.served.ds.variables[name]
        return tuple(_length(self._taken(dim, size)) for dim, size in variable.sizes.items())

    def _taken(self, dim: Any, size: int) -> tuple[slice, ...]:
        return self.parts.get(str(dim), (slice(0, size),))

    @property
    def values(self) -> int:
        """Size of the values [bytes]."""
        variables = self.served.ds.variables
        return sum(
            math.prod(self.shape(name)) * variables[name].dtype.itemsize for name in self.names
        )

    def _first_chunk(self, name: str) -> tuple[int, ...]:
        """Return the position of the first chunk of a variable to receive."""
        chunks, sizes = self.served.chunks(name) or (), self.served.ds.variables[name].sizes
        return tuple(
            self._taken(dim, size)[0].start // chunk
            for (dim, size), chunk in zip(sizes.items(), chunks, strict=False)
        )

    def fingerprint(self) -> str:
        """Return a hash that detects changes of a data set, from metadata, small coordinates and a chunk of each velocity."""
        ds, digest = self.served.ds, hashlib.sha256()
        for name in sorted(map(str, ds.variables)):
            variable = ds.variables[name]
            shown = {key: np.asarray(value).tolist() for key, value in variable.attrs.items()}
            about = [name, list(map(str, variable.dims)), list(variable.shape), str(variable.dtype)]
            digest.update(json.dumps([*about, shown], sort_keys=True, default=str).encode())
            if variable.ndim <= 1 and variable.size <= _SMALL and variable.dtype.kind in "iufM":
                digest.update(np.ascontiguousarray(variable.values).tobytes())
        for name in self.current:
            digest.update(repr(self.served.state(name, self._first_chunk(name))).encode())
        return digest.hexdigest()

    @property
    def received(self) -> float:
        """Expected download [bytes], from the size of one chunk of each large variable."""
        total, variables = 0.0, self.served.ds.variables
        for name in self.names:
            size = float(math.prod(self.shape(name)) * variables[name].dtype.itemsize)
            if (chunks := self.served.chunks(name)) is not None:
                taken = zip(variables[name].sizes.items(), chunks, strict=True)
                count = math.prod(
                    len({k // chunk for part in self._taken(dim, n) for k in _ends(part, chunk)})
                    for (dim, n), chunk in taken
                )
                each = math.prod(chunks) * variables[name].dtype.itemsize
                if count * each > 1e5 and not variables[name].encoding.get("shards"):
                    each = self.served.state(name, self._first_chunk(name))[0] or each
                size = float(count * each)
            total += size
        return total

    def pieces(self, name: str) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...]]]:
        """Yield the pieces of a variable to receive: position in the data set, and position in the file."""
        variable = self.served.ds.variables[name]
        chunks = self.served.chunks(name) or (1,) * variable.ndim
        axes = []
        left = _PIECE / variable.dtype.itemsize
        for (dim, size), chunk in reversed(list(zip(variable.sizes.items(), chunks, strict=True))):
            taken = self._taken(dim, size)
            # whole chunks along the slower dimensions, so that none is received twice
            most = max(1, int(left) // chunk) * chunk
            pairs, at = [], 0
            for part in taken:
                for start, stop in _steps(part, most, chunk):
                    pairs.append((slice(start, stop), slice(at, at + stop - start)))
                    at += stop - start
            axes.append(pairs)
            left = max(1.0, left / max(1, at))
        for combined in product(*reversed(axes)):
            yield tuple(pair[0] for pair in combined), tuple(pair[1] for pair in combined)


def plan_cuts(found: Collection, wanted: Wanted, config: ForecastConfig) -> tuple[Cut, ...]:
    """Return the required parts of the data sets of an opened forecast; only coordinates are received.

    Raises:
        ForecastError: The forecast covers another region or time.
    """
    fields = [field for member in (*found.members, found.background) for field in member]
    kind, alone = kind_of(found.rule), len({field.paths for field in fields}) == 1
    taken: dict[Address, dict[str, tuple[slice, ...]]] = {}
    currents: dict[Address, list[str]] = {}
    for field in fields:
        of_field, names = parts_of(field, wanted, config, kind, alone), field.current
        assert names is not None
        for path in field.paths:
            if isinstance(path, Address):
                taken.setdefault(path, {}).update(of_field)
                currents.setdefault(path, []).extend(filter(None, (names.u, names.v)))
    for grid in found.grids:
        if isinstance(grid, Address):
            taken[grid] = parts_of(fields[0], wanted, config, kind, alone)
    cuts = []
    for address, of_dims in taken.items():
        ds = served(address).ds
        known = {dim: part for dim, part in of_dims.items() if dim in ds.sizes}
        current = tuple(
            dict.fromkeys(name for name in currents.get(address, ()) if name in ds.variables)
        )
        cuts.append(Cut(served(address), known, _names(ds, known, current), current))
    return tuple(cuts)


def _names(ds: xr.Dataset, parts: Parts, current: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the velocities, their grid variables, and the sea surface height."""
    dims = {dim for name in current for dim in ds.variables[name].dims}
    grid = {dim for name in current for dim in ds.variables[name].dims[-2:]}
    changing = dims - grid - {find_depth(ds, dims)}
    names = list(current)
    for name, variable in ds.variables.items():
        fits = all(dim in dims or dim in parts for dim in variable.dims)
        fixed = name in SEA_LEVEL or not changing & set(variable.dims)
        small = variable.ndim <= 1 and variable.size <= _SMALL
        numbers = variable.dtype.kind in "iuf"
        if name not in current and (small or (numbers and fits and fixed)):
            names.append(str(name))
    return tuple(names)


def write_cut(
    cut: Cut, out: Path, record: Mapping[str, object], done: float, total: float
) -> float:
    """Receive a cut into a NetCDF-4 file, piece by piece.

    Args:
        cut: Part to receive.
        out: Temporary file, which the caller renames.
        record: Provenance of the values.
        done: Size of the values received before [bytes].
        total: Size of the values of all parts [bytes].

    Returns:
        ``done`` including this part.

    Raises:
        ForecastError: The server fails.
    """
    ds, what = cut.served.ds, f"fetching {cut.served.address.name}"
    with h5netcdf.File(out, "w", track_order=False) as file:
        file.dimensions = {
            str(dim): _length(cut.parts.get(str(dim), (slice(0, size),)))
            for dim, size in ds.sizes.items()
            if any(dim in ds.variables[name].dims for name in cut.names)
        }
        for name, value in ds.attrs.items():
            _set(file.attrs, str(name), value)
        file.attrs[RECORD] = json.dumps(record, sort_keys=True)
        for name in cut.names:
            variable = ds.variables[name]
            fill = variable.attrs.get("_FillValue")
            numbers = variable.dtype.kind in "iufb"
            made = file.create_variable(
                name,
                tuple(map(str, variable.dims)),
                variable.dtype.newbyteorder("=") if numbers else h5py.string_dtype(),
                fillvalue=None if fill is None else np.asarray(fill, variable.dtype).item(),
            )
            for key, value in variable.attrs.items():
                if key != "_FillValue":
                    _set(made.attrs, str(key), value)
            for source, target in cut.pieces(name):
                values = _values(cut, name, source)
                made[target] = values if numbers else values.astype(object)
                done += values.nbytes
                announce(what, done, total)
    return done


def _set(attributes: Any, name: str, value: object) -> None:
    """Set an attribute, except those reserved by HDF5 or not storable in a file."""
    if name in (
        "DIMENSION_LIST",
        "REFERENCE_LIST",
        "CLASS",
        "NAME",
        "_NCProperties",
        "_Netcdf4Dimid",
    ):
        return
    if isinstance(value, str | int | float | np.generic) or (
        isinstance(value, list | tuple | np.ndarray) and np.asarray(value).dtype.kind in "iufSU"
    ):
        attributes[name] = list(value) if isinstance(value, tuple) else value


def _values(cut: Cut, name: str, source: tuple[slice, ...]) -> np.ndarray:
    """Return the values of a piece of a variable.

    Raises:
        ForecastError: The server fails.
    """
    try:
        values: np.ndarray = cut.served.ds.variables[name][source].values
    except (ReplayKitError, MemoryError):
        raise
    # a library may raise anything
    except Exception as error:
        raise ForecastError(
            f"{cut.served.address}: incomplete answer of the server: {in_words(error)}; check the connection, or try again later"
        ) from error
    return values


def _length(parts: Sequence[slice]) -> int:
    return sum(part.stop - part.start for part in parts)


def _ends(part: slice, chunk: int) -> range:
    """Return one index in each chunk that a part touches."""
    return range(part.start // chunk * chunk, part.stop, chunk)


def _steps(part: slice, most: int, chunk: int) -> Iterator[tuple[int, int]]:
    """Yield the ends of pieces of a part that split no chunk."""
    first = part.start // chunk * chunk
    marks = [part.start, *range(first + most, part.stop, most), part.stop]
    yield from pairwise(marks)
