"""Servers on the loopback address: files with faults on demand, OPeNDAP by pydap, griddap by xpublish-erddap."""

import hashlib
import re
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import chain, repeat
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import numpy as np
import xarray as xr


@dataclass
class Files:
    """What a server serves and what it was asked.

    Attributes:
        objects: Bytes by path; or a function that makes them, None for none.
        fault: Called with path and number of the request; answers with the fault's name, or nothing.
        sent: Bytes of bodies.
        asked: Paths, in order.
    """

    objects: Mapping[str, bytes] | Callable[[str], bytes | None]
    fault: Callable[[str, int], str] = lambda path, number: ""
    redirect: str = ""
    sent: int = 0
    asked: list[str] = field(default_factory=list)
    headers: list[Any] = field(default_factory=list)
    url: str = ""

    @property
    def counts(self) -> Counter:
        return Counter(self.asked)


_BROKEN = b'Error {\n code=500;\n message="out of order";\n};'
#: Status and body in place of an answer, by fault.
_ANSWERS = {
    "500": (500, _BROKEN),
    "403": (403, _BROKEN),
    "html": (200, b"<!DOCTYPE html><html><body>Please log in</body></html>"),
}


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    files: Files

    def log_message(self, *_: Any) -> None:
        pass

    def do_HEAD(self) -> None:
        self._answer(False)

    def do_GET(self) -> None:
        self._answer(True)

    def _answer(self, whole: bool) -> None:
        files, path = self.files, self.path.lstrip("/")
        files.asked.append(path)
        files.headers.append(self.headers)
        fault = files.fault(path, len(files.asked)) if whole else ""
        if fault == "close":
            self.close_connection = True
            return
        if fault == "redirect":
            self._head(302, 0, {"Location": files.redirect})
            return
        if fault in _ANSWERS:
            self._send(*_ANSWERS[fault], whole)
            return
        objects = files.objects
        data = objects(path) if callable(objects) else objects.get(path.partition("?")[0])
        if fault == "flood" and data is not None:
            self._flood(data)
            return
        if data is None:
            self._send(404, b"<html>not found</html>", whole)
            return
        if fault == "short":
            data = data[: len(data) // 2]
        self._part(data, whole, cut=fault == "cut")

    def _flood(self, data: bytes) -> None:
        """Send 10 GB, without a word of how much it will be."""
        self.send_response(200)
        self.end_headers()
        self.close_connection = True
        for block in chain([data], repeat(bytes(1 << 20), 10_000)):
            self.wfile.write(block)
            self.files.sent += len(block)

    def _part(self, data: bytes, whole: bool, cut: bool) -> None:
        more = {"ETag": f'"{hashlib.md5(data).hexdigest()}"', "Accept-Ranges": "bytes"}
        asked = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        fresh = self.headers.get("If-Range", more["ETag"]) == more["ETag"]
        if asked and fresh:
            if asked[1]:
                first, last = int(asked[1]), min(int(asked[2] or len(data)), len(data) - 1)
            else:
                first, last = len(data) - int(asked[2]), len(data) - 1
            more["Content-Range"] = f"bytes {first}-{last}/{len(data)}"
            self._send(206, data[first : last + 1], whole, more, cut)
        else:
            self._send(200, data, whole, more, cut)

    def _send(
        self, status: int, body: bytes, whole: bool, more: Mapping[str, str] = {}, cut: bool = False
    ) -> None:
        self._head(status, len(body), more)
        if whole:
            part = body[: len(body) // 2] if cut else body
            self.files.sent += len(part)
            self.wfile.write(part)
            self.close_connection = self.close_connection or cut

    def _head(self, status: int, size: int, more: Mapping[str, str]) -> None:
        self.send_response(status)
        for key, value in {"Content-Length": str(size), **more}.items():
            self.send_header(key, value)
        self.end_headers()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *_: Any) -> None:
        pass


@contextmanager
def serving(files: Files) -> Iterator[Files]:
    """Serve files; ``files.url`` is the address of the server."""
    handler = type("Handler", (_Handler,), {"files": files})
    server = _Server(("127.0.0.1", 0), handler)
    files.url = f"http://127.0.0.1:{server.server_address[1]}"
    with _running(server):
        yield files


@contextmanager
def _running(server: Any) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Quiet(WSGIRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@contextmanager
def opendap(ds: xr.Dataset) -> Iterator[str]:
    """Serve a dataset by pydap, as grids with their axes; give the address."""
    with warnings.catch_warnings():
        # its own dependency imports a module that Python 3.13 has no more
        warnings.simplefilter("ignore")
        from pydap.handlers.lib import BaseHandler
        from pydap.model import BaseType, DatasetType, GridType

    dataset = DatasetType("forecast", NC_GLOBAL=dict(ds.attrs))
    for name in ds.dims:
        axis = ds[name]
        dataset[name] = BaseType(
            name, np.asarray(axis.values), dims=(f"/{name}",), attributes=dict(axis.attrs)
        )
    for name, variable in ds.data_vars.items():
        grid = GridType(name, attributes=dict(variable.attrs))
        grid[name] = BaseType(
            name, np.asarray(variable.values), dims=variable.dims, attributes=dict(variable.attrs)
        )
        for dim in variable.dims:
            grid[dim] = BaseType(dim, np.asarray(ds[dim].values), attributes=dict(ds[dim].attrs))
        dataset[name] = grid
    server = make_server("127.0.0.1", 0, BaseHandler(dataset), WSGIServer, _Quiet)
    with _running(server):
        yield f"http://127.0.0.1:{server.server_port}/forecast"


@contextmanager
def griddap(ds: xr.Dataset) -> Iterator[str]:
    """Serve a dataset by xpublish-erddap; give the address."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import uvicorn
        import xpublish
        from xpublish_erddap import ErddapPlugin

    rest = xpublish.Rest({"forecast": ds}, plugins={"erddap": ErddapPlugin()})
    server = uvicorn.Server(
        uvicorn.Config(rest.app, host="127.0.0.1", port=0, log_level="error", lifespan="off")
    )
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}/erddap/griddap/forecast"
    finally:
        server.should_exit = True
        thread.join()


def zarr_objects(ds: xr.Dataset, **options: Any) -> dict[str, bytes]:
    """Return the objects of a Zarr store of a dataset, by key."""
    import zarr

    held: dict[str, Any] = {}
    store = zarr.storage.MemoryStore(held)
    ds.to_zarr(store, consolidated=True, **options)
    return {key: value.to_bytes() for key, value in held.items()}
