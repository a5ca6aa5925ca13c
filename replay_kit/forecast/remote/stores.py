"""Zarr on a server: a folder of objects as a read-only store; and a file that is read in pieces."""

import asyncio
import io
from collections.abc import AsyncIterator, Callable, Iterable
from typing import Any
from urllib.parse import urlsplit

from zarr.abc.store import (
    ByteRequest,
    OffsetByteRequest,
    RangeByteRequest,
    Store,
    SuffixByteRequest,
)
from zarr.core.buffer import Buffer, BufferPrototype

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import public
from replay_kit.forecast.remote.answers import Span, is_page
from replay_kit.forecast.remote.client import METADATA, Client

_WHOLE: Span = (0, None)
#: Bytes of the object of a key, or of a part of it; None where there is none.
Read = Callable[[str, Span, float], bytes | None]
# Bytes of a NetCDF file that are asked for at once.
_PIECE = 1 << 18
_MARKS = ("zarr.json", ".zarray", ".zgroup", ".zattrs", ".zmetadata")


class ServedStore(Store):
    """A Zarr store that cannot be written.

    Attributes:
        most: Bytes that a chunk, or its shard, has at most.
        absent: Number of chunks that were not there, which Zarr reads as missing values.
    """

    supports_writes = False
    supports_deletes = False
    supports_listing = True

    def __init__(self, read: Read) -> None:
        super().__init__(read_only=True)
        self._read = read
        self.most, self.absent = float(METADATA), 0

    def __eq__(self, other: object) -> bool:
        return self is other

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """Return the bytes of a key, or of a part of it."""
        span = _WHOLE
        if isinstance(byte_range, RangeByteRequest):
            span = (byte_range.start, byte_range.end)
        elif isinstance(byte_range, OffsetByteRequest):
            span = (byte_range.offset, None)
        elif isinstance(byte_range, SuffixByteRequest):
            span = (-byte_range.suffix, None)
        described = key.rpartition("/")[2] in _MARKS
        data = await asyncio.to_thread(self._read, key, span, METADATA if described else self.most)
        if data is None:
            self.absent += not described
            return None
        return prototype.buffer.from_bytes(data)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Return the bytes of several parts."""
        return [await self.get(key, prototype, part) for key, part in key_ranges]

    async def exists(self, key: str) -> bool:
        """Return whether there is an object."""
        return await asyncio.to_thread(self._read, key, _WHOLE, self.most) is not None

    async def set(self, key: str, value: Buffer) -> None:
        """Refuse to write, as a store that is read only does."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Refuse to delete, as a store that is read only does."""
        self._check_writable()

    async def list(self) -> AsyncIterator[str]:
        """Yield nothing, as a server lists no folder."""
        for key in tuple[str, ...]():
            yield key

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """Yield nothing."""
        for key in tuple[str, ...]():
            yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """Yield nothing."""
        for key in tuple[str, ...]():
            yield key


def under(url: str, key: str) -> str:
    """Return the address of an object of a store; a query, as of a signed address, stays."""
    parts = urlsplit(url)
    return parts._replace(path=f"{parts.path.rstrip('/')}/{key}").geturl()


def folder_store(client: Client, url: str) -> ServedStore:
    """Return the store whose objects lie below an address; metadata must be consolidated, as a server lists no folder."""

    def read(key: str, span: Span, most: float) -> bytes | None:
        # a chunk that is absent is a missing value, so that the server is asked twice
        data = client.get(under(url, key), most, span) or client.get(under(url, key), most, span)
        if data is not None and is_page(data):
            raise ForecastError(
                f"{public(under(url, key))}: expected data, got a page of the web, as of a login; open the address in a browser"
            )
        return data

    return ServedStore(read)


class ServedFile(io.RawIOBase):
    """A file on a server that is read in pieces.

    Raises:
        ForecastError: The server does not state its size.
    """

    def __init__(self, client: Client, url: str) -> None:
        size = client.head(url)[0]
        if size is None:
            raise ForecastError(
                f"{public(url)}: the server does not state the size of the file, so no part of it can be read; download it"
            )
        self._client, self._url, self._size, self._at = client, url, size, 0

    def readable(self) -> bool:
        """Return whether it can be read."""
        return True

    def seekable(self) -> bool:
        """Return whether it can be read from any place."""
        return True

    def tell(self) -> int:
        """Return the place."""
        return self._at

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place."""
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer; return the number of bytes."""
        view = memoryview(buffer).cast("B")
        stop = min(self._at + len(view), self._size)
        done = 0
        while self._at < stop:
            piece = self._at // _PIECE
            span = (piece * _PIECE, min((piece + 1) * _PIECE, self._size))
            data = self._client.get(self._url, 2 * _PIECE, span)
            part = (data or b"")[self._at - span[0] : stop - span[0]]
            if not part:
                raise OSError(f"{public(self._url)}: ends before its stated size")
            view[done : done + len(part)] = part
            done += len(part)
            self._at += len(part)
        return done
