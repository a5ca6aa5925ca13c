"""What an address stands for: Zarr, OPeNDAP, NetCDF, a data set of Copernicus Marine; opened, and values received when they are used."""

import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import xarray as xr
import zarr

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Address
from replay_kit.forecast.remote.answers import is_page
from replay_kit.forecast.remote.client import Client, Limits
from replay_kit.forecast.remote.opendap import dataset_address, open_cmems, open_opendap
from replay_kit.forecast.remote.stores import (
    ServedFile,
    ServedStore,
    folder_store,
    under,
)

# Coordinates with more values are not compared.
_SMALL = 100_000
_CMEMS = "cmems:"


@dataclass(frozen=True, slots=True, eq=False)
class Served:
    """A data set on a server.

    Attributes:
        address: Its address.
        ds: Its variables as the server holds them, packed and with times as numbers.
        form: In words.
        store: Of Zarr; None for others.
        url: Where its objects lie; empty where another client knows it.
        key: Name of a chunk within a Zarr store, from variable and position.
    """

    address: Address
    ds: xr.Dataset
    form: str
    store: Any = None
    url: str = ""
    key: Callable[[str, tuple[int, ...]], str] | None = None

    def object_url(self, name: str, position: tuple[int, ...]) -> str:
        """Return the address of a chunk of a variable, or of the file that holds all."""
        return self.url if self.key is None else under(self.url, self.key(name, position))

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Return the shape of the parts that a variable is received in; None where any part can be asked for."""
        encoding = self.ds.variables[name].encoding
        found = encoding.get("chunks") or encoding.get("chunksizes")
        return None if not found or self.store is None else tuple(found)


class Session:
    """The data sets that are open, and the client that asks their servers."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._client: Client | None = None
        self._served: dict[Address, Served] = {}

    @property
    def client(self) -> Client:
        """The client; made when first asked for."""
        if self._client is None:
            self._client = Client(self.limits)
        return self._client

    @property
    def received(self) -> int:
        """Bytes received."""
        return 0 if self._client is None else self._client.received

    def served(self, address: Address) -> Served:
        """Return the data set of an address, opened once.

        Raises:
            ForecastError: There is none that can be read.
        """
        if address not in self._served:
            found = _opened(self, address)
            if found.store is not None:
                _limit_chunks(found, self.limits)
            self._served[address] = found
        return self._served[address]

    def again(self) -> "Session":
        """Return a session that knows nothing yet, with the same limits."""
        return Session(self.limits)

    def close(self) -> None:
        """Close all."""
        for served in self._served.values():
            served.ds.close()
        if self._client is not None:
            self._client.close()


_SESSION: ContextVar[Session | None] = ContextVar("session", default=None)


@contextmanager
def asking(limits: Limits) -> Iterator[Session]:
    """Give the session by which addresses are opened in this context."""
    session = Session(limits)
    token = _SESSION.set(session)
    try:
        yield session
    finally:
        _SESSION.reset(token)
        session.close()


def open_address(address: Address) -> xr.Dataset:
    """Return the data set of an address with unpacked values, in the context of ``asking``.

    Raises:
        ForecastError: It cannot be read; or nobody asked for requests.
    """
    if (session := _SESSION.get()) is None:
        raise ForecastError(
            f"{address}: this command reads files; fetch the forecast first: replay-kit fetch --ensemble {address} -o forecast.nc"
        )
    return xr.decode_cf(session.served(address).ds, decode_times=False, decode_timedelta=False)


def fingerprint(served: Served, session: Session, urls: Sequence[str]) -> str:
    """Return a hash of what shows that a data set was changed: description, small coordinates, and the state of some chunks.

    Args:
        served: The data set.
        session: Asks for the state of chunks.
        urls: Addresses of these chunks.
    """
    ds, digest = served.ds, hashlib.sha256()
    for name in sorted(map(str, ds.variables)):
        variable = ds.variables[name]
        shown = {key: np.asarray(value).tolist() for key, value in variable.attrs.items()}
        about = [name, list(map(str, variable.dims)), list(variable.shape), str(variable.dtype)]
        digest.update(json.dumps([*about, shown], sort_keys=True, default=str).encode())
        if variable.ndim <= 1 and variable.size <= _SMALL and variable.dtype.kind in "iufM":
            digest.update(np.ascontiguousarray(variable.values).tobytes())
    for url in urls:
        digest.update(session.client.head(url)[1].encode())
    return digest.hexdigest()


def _limit_chunks(served: Served, limits: Limits) -> None:
    """Bound what the chunks of a store may be.

    Raises:
        ForecastError: One takes more memory than is allowed.
    """
    largest = 0.0
    for name, variable in served.ds.variables.items():
        shape = variable.encoding.get("shards") or served.chunks(str(name)) or variable.shape
        inner = math.prod(served.chunks(str(name)) or variable.shape) * variable.dtype.itemsize
        if inner > limits.memory and variable.ndim > 1:
            raise ForecastError(
                f"{served.address}: a chunk of {name} takes {inner / 1e6:.4g} MB in memory, at most {limits.memory / 1e6:.4g} are allowed; "
                "use a copy with smaller chunks"
            )
        largest = max(largest, math.prod(shape) * variable.dtype.itemsize)
    if isinstance(served.store, ServedStore):
        served.store.most = 1.5 * largest + 1e6


def _opened(session: Session, address: Address) -> Served:
    url = address.url
    if url.lower().startswith(_CMEMS):
        return Served(address, open_cmems(address, url[len(_CMEMS) :]), "Copernicus Marine")
    client = session.client
    path = urlsplit(url).path.lower()
    ways: list[Callable[[Client, Address], Served | None]] = [_zarr, _opendap, _file]
    if any(mark in path for mark in ("/griddap/", "/dodsc/", "/opendap/", "/dap/")):
        ways = [_opendap, _zarr, _file]
    elif path.endswith((".nc", ".nc4")):
        ways = [_file, _opendap, _zarr]
    for way in ways:
        if (found := way(client, address)) is not None:
            return found
    raise ForecastError(
        f"{address}: expected a Zarr store with consolidated metadata, an OPeNDAP or griddap data set, or a NetCDF file; the server has "
        f"none of these there{f' ({client.refused})' if client.refused else ''}: check the address"
    )


def _zarr(client: Client, address: Address) -> Served | None:
    url = address.url
    found = {
        mark: data
        for mark in (".zmetadata", "zarr.json")
        if (data := client.probe(under(url, mark))) is not None
    }
    text = next(iter(found.values()), b"")
    if not text:
        if client.probe(under(url, ".zgroup")) is None:
            return None
        text = b"{}"
    if is_page(text):
        # what answers every address with a page may still speak OPeNDAP
        return None
    try:
        listed = json.loads(text)
        consolidated = ".zmetadata" in found or bool(listed.get("consolidated_metadata"))
    except (ValueError, AttributeError) as error:
        raise ForecastError(
            f"{address}: its metadata are damaged ({error}); is the store being written? try again later"
        ) from error
    if not consolidated:
        raise ForecastError(
            f"{address}: a Zarr store without consolidated metadata, which a server cannot list; its owner can add them with "
            "zarr.consolidate_metadata, or download it"
        )
    # Any: the stubs of xarray know no stores of Zarr
    store: Any = folder_store(client, url)
    try:
        ds = xr.open_dataset(store, engine="zarr", decode_cf=False, consolidated=None)
    except (OSError, ValueError, LookupError, TypeError, RuntimeError) as error:
        words = " ".join(str(error).split())[:200]
        raise ForecastError(f"{address}: cannot be read as Zarr: {words}") from error
    return Served(address, ds, "Zarr", store, url, partial(_key, zarr.open_group(store, mode="r")))


def _key(group: zarr.Group, name: str, position: tuple[int, ...]) -> str:
    """Return the key of a chunk in a store."""
    array = group[name]
    assert isinstance(array, zarr.Array)
    return f"{name}/{array.metadata.encode_chunk_key(position)}"


def _opendap(client: Client, address: Address) -> Served | None:
    url = dataset_address(address.url).rstrip("/")
    if not urlsplit(url).path:
        return None
    ds = open_opendap(client, url)
    form = "ERDDAP griddap" if "/griddap/" in url else "OPeNDAP"
    return None if ds is None else Served(address, ds, form, url=url + ".dds")


def _file(client: Client, address: Address) -> Served | None:
    url = address.url
    head = client.probe(url, (0, 8))
    if head is None:
        return None
    if is_page(head + b" ") or head.lstrip().startswith(b"<"):
        raise ForecastError(
            f"{address}: expected a forecast, got a page of the web, as of a login or a catalogue; open the address in a browser"
        )
    if head[1:4] == b"HDF":
        ds = xr.open_dataset(
            io.BufferedReader(ServedFile(client, url)),
            engine="h5netcdf",
            decode_cf=False,
            phony_dims="access",
        )
        return Served(address, ds, "NetCDF-4", url=url)
    if head[:1] == b"{" or head[:4] == b"PK\x03\x04":
        raise ForecastError(
            f"{address}: expected Zarr as a folder of objects, got a zip archive or references to files; give the address of the store"
        )
    if head[:3] == b"CDF":
        raise ForecastError(
            f"{address}: a NetCDF-3 file, of which no part can be received; download it, and give the file"
        )
    return None
