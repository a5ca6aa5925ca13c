"""Data sets on servers, opened by address: Zarr and NetCDF over https by fsspec, OPeNDAP by netCDF4.

Values are received when used. All access happens in a separate process (``call_apart``), as a library may hang or crash.
"""

import asyncio
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import xarray as xr
import zarr
from zarr.core.buffer import Buffer
from zarr.storage import FsspecStore

from replay_kit.core.errors import ForecastError, ReplayKitError
from replay_kit.core.files.paths import Address
from replay_kit.forecast.remote.apart import may_ask

# s without a byte; the longest connection
_SILENCE, _CONNECT = 30.0, 10.0
# Bytes of a NetCDF file that are asked for at once.
_PIECE = 1 << 18
# Largest chunk that is held at once, unpacked [bytes].
_MOST = 2.56e8
_CMEMS = "cmems:"
# Times that a chunk is asked for, and s before the second one; before each later one twice as long.
_ATTEMPTS, _PAUSE = 4, 0.5


class _Store(FsspecStore):
    """Store on a server that requests a chunk again if an answer breaks off."""

    async def get(self, *key: Any, **part: Any) -> Buffer | None:
        for attempt in range(_ATTEMPTS - 1):
            try:
                return await super().get(*key, **part)
            # a library may raise anything
            except Exception:
                await asyncio.sleep(_PAUSE * 2**attempt)
        return await super().get(*key, **part)


@dataclass(frozen=True, slots=True, eq=False)
class Served:
    """Data set on a server.

    Attributes:
        address: Address of the data set.
        ds: Variables as on the server, packed and with times as numbers.
        form: Format as text.
        files: File system of its objects; None if another client reads them.
        url_of: Address of the object that holds a chunk, from variable and position.
    """

    address: Address
    ds: xr.Dataset
    form: str
    files: Any = None
    url_of: Callable[[str, tuple[int, ...]], str] | None = None

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Return the chunk shape of a variable; None if any part can be requested."""
        encoding = self.ds.variables[name].encoding
        found = encoding.get("chunks") or encoding.get("chunksizes")
        return None if not found or self.form != "Zarr" else tuple(found)

    def state(self, name: str, position: tuple[int, ...]) -> str:
        """Return the size and version of the object that holds a chunk; empty if not stated."""
        if self.url_of is None:
            return ""
        try:
            found = self.files.info(self.url_of(name, position))
        # a library may raise anything
        except Exception:
            return ""
        return f"{found.get('size')} {found.get('ETag') or found.get('Last-Modified')}"


def open_address(address: Address) -> xr.Dataset:
    """Return the data set of an address with unpacked values.

    Raises:
        ForecastError: The data set cannot be read, or this command does not contact servers.
    """
    if not may_ask():
        raise ForecastError(
            f"{address}: this command reads files; fetch the forecast first: replay-kit fetch --ensemble {address} -o forecast.nc"
        )
    return xr.decode_cf(served(address).ds, decode_times=False, decode_timedelta=False)


@cache
def served(address: Address) -> Served:
    """Return the data set of an address, opened once per process.

    Raises:
        ForecastError: The address has no readable data set.
    """
    url = address.url
    if url.lower().startswith(_CMEMS):
        return Served(address, _cmems(address, url[len(_CMEMS) :]), "Copernicus Marine")
    _files()
    parts = urlsplit(url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    try:
        socket.create_connection((parts.hostname or "", port), _CONNECT).close()
    except OSError as error:
        raise ForecastError(
            f"{address}: the server cannot be reached: {error.strerror or error}; check the address and the connection"
        ) from error
    path = parts.path.lower()
    ways = [_zarr, _file, _opendap]
    if any(mark in path for mark in ("/griddap/", "/dodsc/", "/opendap/", "/dap/")):
        ways = [_opendap, _zarr, _file]
    elif path.endswith((".nc", ".nc4")):
        ways = [_file, _opendap, _zarr]
    why = ""
    for way in ways:
        try:
            if (found := way(address)) is not None:
                return found
        except (ReplayKitError, MemoryError):
            raise
        # a library may raise anything
        except Exception as error:
            why = why or in_words(error)
    raise ForecastError(
        f"{address}: expected a Zarr store with consolidated metadata, an OPeNDAP or griddap data set, or a NetCDF file; the server gives "
        f"none of these there{f' ({why})' if why else ''}: check the address"
    )


def in_words(error: BaseException) -> str:
    """Return a library's error as one line, without addresses, which may hold a login."""
    text = re.sub(r"\S+://\S+", "(an address)", " ".join(str(error).split()))
    return text[:200] or type(error).__name__


def _files(asynchronous: bool = False) -> Any:
    """Return the file system for https.

    Raises:
        ForecastError: Its library is not installed.
    """
    try:
        import aiohttp
        import fsspec
    except ImportError as error:
        raise ForecastError(
            "a forecast on a server needs the extra 'remote': pip install 'replay-kit[remote]'"
        ) from error
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=_CONNECT, sock_read=_SILENCE)
    return fsspec.filesystem(
        "http", asynchronous=asynchronous, client_kwargs={"timeout": timeout, "trust_env": True}
    )


def _zarr(address: Address) -> Served | None:
    files, url = _files(), address.url.rstrip("/")
    if not any(files.exists(f"{url}/{mark}") for mark in (".zmetadata", "zarr.json", ".zgroup")):
        return None
    store = _Store(_files(asynchronous=True), read_only=True, path=url)
    group = zarr.open_group(store, mode="r")
    if group.metadata.consolidated_metadata is None:
        raise ForecastError(
            f"{address}: a Zarr store without consolidated metadata, which a server cannot list; its owner can add them with "
            "zarr.consolidate_metadata, or download it"
        )
    ds = xr.open_dataset(store, engine="zarr", decode_cf=False, consolidated=None)  # type: ignore[arg-type]
    for name, variable in ds.variables.items():
        chunk = variable.encoding.get("chunks") or variable.shape
        size = float(np.prod(chunk)) * variable.dtype.itemsize
        if size > _MOST and variable.ndim > 1:
            raise ForecastError(
                f"{address}: a chunk of {name} takes {size / 1e6:.4g} MB in memory, at most {_MOST / 1e6:.4g} are allowed; use a copy with "
                "smaller chunks"
            )

    def url_of(name: str, position: tuple[int, ...]) -> str:
        array = group[name]
        assert isinstance(array, zarr.Array)
        return f"{url}/{name}/{array.metadata.encode_chunk_key(position)}"

    return Served(address, ds, "Zarr", files, url_of)


def _opendap(address: Address) -> Served | None:
    import netCDF4  # noqa: F401

    parts = urlsplit(address.url)
    path = re.sub(r"\.(dds|das|dods|html)$", "", parts.path).rstrip("/")
    if not path:
        return None
    url = parts._replace(path=path, query="", fragment="").geturl()
    ds = xr.open_dataset(url, engine="netcdf4", decode_cf=False)
    form = "ERDDAP griddap" if "/griddap/" in url else "OPeNDAP"
    # axes are read once
    axes = {name: ds[name].load() for name in ds.dims if name in ds.variables}
    return Served(address, ds.assign_coords(axes), form)


def _file(address: Address) -> Served | None:
    files, url = _files(), address.url
    if not files.exists(url):
        return None
    file = files.open(url, block_size=_PIECE, cache_type="readahead")
    head = file.read(8)
    if head.lstrip().startswith(b"<"):
        raise ForecastError(
            f"{address}: expected a forecast, got a web page, such as a login or a catalogue; open the address in a browser"
        )
    if head[:3] == b"CDF" or not file.seekable():
        raise ForecastError(
            f"{address}: no part of this file can be received, as it is NetCDF-3 or the server gives none; download it, and give the file"
        )
    if head[1:4] != b"HDF":
        return None
    ds = xr.open_dataset(file, engine="h5netcdf", decode_cf=False, phony_dims="access")
    return Served(address, ds, "NetCDF-4", files, lambda name, position: url)


def _cmems(address: Address, name: str) -> xr.Dataset:
    """Return a data set of Copernicus Marine from the provider's client, which keeps the login; times are numbers.

    Raises:
        ForecastError: The client is not installed, or fails.
    """
    try:
        import copernicusmarine
    except ImportError as error:
        raise ForecastError(
            f"{address}: needs the client of Copernicus Marine (EUPL licence): pip install 'replay-kit[cmems]'; then copernicusmarine login"
        ) from error
    try:
        ds: xr.Dataset = copernicusmarine.open_dataset(dataset_id=name)
    except Exception as error:
        raise ForecastError(
            f"{address}: Copernicus Marine's client answers: {in_words(error)}; is the name right, and copernicusmarine login done?"
        ) from error
    ds = ds.drop_encoding()
    dated = {
        name: xr.conventions.encode_cf_variable(variable, name=name)
        for name, variable in ds.variables.items()
        if variable.dtype.kind in "mM"
    }
    return ds.assign(dated)
