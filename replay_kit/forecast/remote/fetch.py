"""Download of forecasts: required part of a data set, its size, transfer to a NetCDF file in the cache, and check."""

import hashlib
import json
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError, ReplayKitError
from replay_kit.core.files.paths import Address, Paths, addresses_in, as_groups
from replay_kit.core.region import inside_box
from replay_kit.core.words.progress import announce
from replay_kit.forecast.files import with_dates
from replay_kit.forecast.grids.horizontal import Index
from replay_kit.forecast.members.collection import Collection, open_collection
from replay_kit.forecast.members.rules import parse_rule
from replay_kit.forecast.names import SEA_LEVEL, find_depth, find_time
from replay_kit.forecast.remote.kept import CACHE, RECORD, Kept, key_of
from replay_kit.forecast.remote.parts import Parts, Wanted, parts_of
from replay_kit.forecast.remote.servers import Served, in_words, served

_LOG = logging.getLogger(__name__)
# Without --max-download no more is received; values received at once [bytes].
_MOST, _PIECE = 1e9, 1 << 25
# Values of an axis, whatever it is of.
_SMALL = 100_000


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Part of one data set to receive.

    Attributes:
        served: Data set.
        parts: Positions along its dimensions.
        names: Names of the variables, the velocities first.
        current: Names of the velocities.
    """

    served: Served
    parts: Parts
    names: tuple[str, ...]
    current: tuple[str, ...]

    def axes(self, name: str) -> list[tuple[str, Index, int]]:
        """Return the dimensions of a variable, with the positions taken and the length of a chunk."""
        variable = self.served.ds.variables[name]
        chunks = self.served.chunks(name) or (1,) * variable.ndim
        return [
            (str(dim), self.parts.get(str(dim), np.arange(size)), chunk)
            for (dim, size), chunk in zip(variable.sizes.items(), chunks, strict=True)
        ]

    def cost(self) -> dict[str, Any]:
        """Return the contents and size; ``download_bytes`` counts whole chunks, before they are packed."""
        values = received = 0
        for name in self.names:
            each, axes = self.served.ds.variables[name].dtype.itemsize, self.axes(name)
            values += each * math.prod(index.size for _, index, _ in axes)
            of_chunks = (np.unique(index // chunk).size * chunk for _, index, chunk in axes)
            received += each * math.prod(of_chunks)
        name = self.names[0]
        return {
            "address": str(self.served.address),
            "form": self.served.form,
            "variables": list(self.names),
            "shape": {dim: index.size for dim, index, _ in self.axes(name)},
            "chunks": self.served.chunks(name),
            "bytes": values,
            "download_bytes": received,
        }

    def fingerprint(self) -> str:
        """Return a hash that detects changes of a data set, from metadata, small coordinates and a chunk of each velocity."""
        ds = self.served.ds
        digest = hashlib.sha256(
            json.dumps(ds.to_dict(data=False), sort_keys=True, default=str).encode()
        )
        for name in sorted(map(str, ds.variables)):
            variable = ds.variables[name]
            if variable.ndim <= 1 and variable.size <= _SMALL and variable.dtype.kind in "iufM":
                digest.update(np.ascontiguousarray(variable.values).tobytes())
        for name in self.current:
            first = tuple(int(index[0]) // chunk for _, index, chunk in self.axes(name))
            digest.update(self.served.state(name, first).encode())
        return digest.hexdigest()

    def pieces(self, name: str) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...]]]:
        """Yield the pieces of a variable to receive, which split no chunk: position in the data set, and position in the part."""
        axes, pairs = self.axes(name), []
        size = self.served.ds.variables[name].dtype.itemsize * math.prod(
            index.size for _, index, _ in axes
        )
        for _, index, chunk in axes:
            split = np.diff(index) != 1
            if size > _PIECE:
                split |= np.diff(index // chunk) != 0
            groups = np.split(np.arange(index.size), np.flatnonzero(split) + 1)
            size = size * max(map(len, groups)) // max(1, index.size)
            pairs.append(
                [
                    (slice(index[at[0]], index[at[-1]] + 1), slice(at[0], at[-1] + 1))
                    for at in groups
                ]
            )
        for combined in product(*pairs):
            yield tuple(pair[0] for pair in combined), tuple(pair[1] for pair in combined)

    def received(self, done: float, total: float) -> xr.Dataset:
        """Return the part, received piece by piece; the bytes done before and of all parts are for the progress.

        Raises:
            ForecastError: The server fails.
        """
        ds, variables = self.served.ds, {}
        for name in self.names:
            variable = ds.variables[name]
            values = np.empty([index.size for _, index, _ in self.axes(name)], variable.dtype)
            for source, target in self.pieces(name):
                try:
                    values[target] = variable[source].values
                except (ReplayKitError, MemoryError):
                    raise
                # a library may raise anything
                except Exception as error:
                    raise ForecastError(
                        f"{self.served.address}: incomplete answer of the server: {in_words(error)}; check the connection, or try again "
                        "later"
                    ) from error
                done += values[target].nbytes
                announce(f"fetching {self.served.address.name}", done, total)
            made = xr.Variable(variable.dims, values, _storable(variable.attrs))
            made.encoding = {} if "_FillValue" in made.attrs else {"_FillValue": None}
            variables[name] = made
        return xr.Dataset(variables, attrs=_storable(ds.attrs))


def _storable(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes that a NetCDF file can hold."""
    return {
        str(name): value
        for name, value in attributes.items()
        if not isinstance(value, bool) and np.asarray(value).dtype.kind in "iufSU"
    }


def cuts_of(given: Paths, wanted: Wanted, config: ForecastConfig) -> tuple[Cut, ...]:
    """Return the parts to receive of an ensemble's addresses, in order; only coordinates are received.

    Raises:
        ForecastError: The forecast cannot be used, or covers another region or time.
    """
    with open_collection(given, parse_rule(config.members)) as found:
        cuts = {cut.served.address: cut for cut in _planned(found, wanted, config)}
    return tuple(cuts[address] for address in addresses_in(given))


def _planned(found: Collection, wanted: Wanted, config: ForecastConfig) -> Iterator[Cut]:
    fields = [field for member in (*found.members, found.background) for field in member]
    kind, alone = found.rule.kind, len({field.paths for field in fields}) == 1
    taken: dict[Address, dict[str, Index]] = {}
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
    for address, of_dims in taken.items():
        ds = served(address).ds
        parts = {dim: part for dim, part in of_dims.items() if dim in ds.sizes}
        velocities = dict.fromkeys(
            name for name in currents.get(address, ()) if name in ds.variables
        )
        yield Cut(served(address), parts, _names(ds, parts, tuple(velocities)), tuple(velocities))


def _names(ds: xr.Dataset, parts: Parts, current: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the velocities, their grid variables, and the sea surface height."""
    dims = {dim for name in current for dim in ds.variables[name].dims}
    grid = {dim for name in current for dim in ds.variables[name].dims[-2:]}
    changing = dims - grid - {find_depth(ds, dims)}
    names = dict.fromkeys(current)
    for name, variable in ds.variables.items():
        fits = all(dim in dims or dim in parts for dim in variable.dims)
        fixed = name in SEA_LEVEL or not changing & set(variable.dims)
        small = variable.ndim <= 1 and variable.size <= _SMALL
        if small or (variable.dtype.kind in "iuf" and fits and fixed):
            names[str(name)] = None
    return tuple(names)


def cost_text(row: dict[str, Any]) -> str:
    """Return the contents and cost of a cut as text."""
    shape = " x ".join(f"{size} {dim}" for dim, size in row["shape"].items())
    ratio = row["download_bytes"] / max(row["bytes"], 1)
    chunks = f"; whole chunks make that {ratio:.3g} times the values" if ratio > 2.0 else ""
    return (
        f"{row['address']} ({row['form']}): {shape}, {row['bytes'] / 1e6:.4g} MB of values, {row['download_bytes'] / 1e6:.4g} MB to "
        f"receive before packing{chunks}"
    )


def receive(
    cuts: Sequence[Cut], wanted: Wanted, config: ForecastConfig, why: Mapping[str, object]
) -> tuple[Path, ...]:
    """Return the files of cuts after download into the cache.

    Args:
        cuts: Parts to receive.
        wanted: Requested part.
        config: Settings of the forecast.
        why: Properties of the request for the records.

    Raises:
        ForecastError: The download exceeds the allowed size, or the server fails.
    """
    rows = [cut.cost() for cut in cuts]
    for row in rows:
        _LOG.warning("fetching %s", cost_text(row))
    total = sum(row["download_bytes"] for row in rows)
    most = _MOST if config.max_download is None else 1e6 * config.max_download
    if total > most:
        raise ForecastError(
            f"{rows[0]['address']}: {total / 1e6:.4g} MB to download, more than --max-download {most / 1e6:.4g} MB; "
            "choose less with --region, --levels and --start, --end"
        )
    files, done, size = list[Path](), 0.0, float(sum(row["bytes"] for row in rows))
    for cut, row in zip(cuts, rows, strict=True):
        record = {**_record(cut, wanted, config), **why, "print": cut.fingerprint()}
        part = cut.received(done, size)
        part.attrs[RECORD] = json.dumps(record, sort_keys=True)
        files.append(cache_of(config).add(_readable(cut), part))
        done += row["bytes"]
        _LOG.warning("received %s", files[-1])
    return tuple(files)


def cache_of(config: ForecastConfig) -> Kept:
    """Return the cache of fetched forecasts."""
    return Kept(CACHE if config.cache is None else Path(config.cache))


def with_files(given: Paths, files: dict[Address, Path]) -> tuple[tuple[Path, ...], ...]:
    """Return the arguments with files instead of addresses."""
    return tuple(
        tuple(files[path] if isinstance(path, Address) else path for path in group)
        for group in as_groups(given, "ensemble")
    )


def covers(
    record: dict[str, Any],
    places: np.ndarray,
    deepest: float | None,
    span: tuple[int | None, int | None],
) -> bool:
    """Return whether the record of a fetched file covers positions, a depth [m] and a time span [ns, UTC]."""
    try:
        wanted, times = record["wanted"], record["times"]
        region = wanted["region"]
        if region is not None and len(places) and not inside_box(tuple(region), *places.T).all():
            return False
        if deepest is not None and wanted["deepest"] is not None and wanted["deepest"] < deepest:
            return False
        if times is None or span[0] is None or span[1] is None:
            return True
        day = 86_400 * 10**9
        return bool(times[0] - day <= span[0] and span[1] <= times[1] + day)
    except (LookupError, TypeError, ValueError):
        return False


def _readable(cut: Cut) -> str:
    """Return the file name of a cut: the host and the last part of the address."""
    text = str(cut.served.address).partition("://")[2] or str(cut.served.address)
    host, _, path = text.partition("/")
    return f"{host.partition(':')[0]}-{path.rstrip('/').rpartition('/')[2] or path}"


def _record(cut: Cut, wanted: Wanted, config: ForecastConfig) -> dict[str, object]:
    """Return the provenance of the values of a cut."""
    ds, times = cut.served.ds, None
    time = find_time(ds, ds.variables[cut.current[0]].dims if cut.current else ())
    if time is not None and time in ds.variables and time in cut.parts:
        dates = with_dates(ds[[time]].isel({time: cut.parts[time]}))[time].values
        if dates.dtype.kind == "M":
            ns = dates.astype("M8[ns]").astype(np.int64)
            times = [int(ns.min()), int(ns.max())]
    settings = {"levels": config.levels, "lead": config.lead, "time": config.time}
    return {
        "address": str(cut.served.address),
        "key": key_of(cut.served.address),
        "form": cut.served.form,
        "fetched": datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "wanted": {**asdict(wanted), **settings},
        "times": times,
    }
