"""Bytes of a server: with time-outs, resumed where a connection breaks, never more than was allowed, and never from where nobody asked."""

import base64
import ipaddress
import re
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import public
from replay_kit.core.text import printable

#: Part of a file: first byte and the one after the last, None for its end; a negative first byte counts from the end.
Span = tuple[int, int | None]
#: Largest description of a data set [bytes].
METADATA = 1 << 26
_BLOCK = 1 << 18
_REDIRECTS = 5
_BUSY = (408, 425, 429, 500, 502, 503, 504)
_NOT_THERE = (400, 403, 405, 406, 500, 501)
_MEANINGS = {
    400: "it does not understand the request",
    401: "it asks for a login; write it as https://USER:PASSWORD@HOST/..., or use the provider's own client",
    403: "it refuses access; does the data need a login, or has an address that is signed expired?",
    404: "there is nothing at this address; check it",
    410: "the data were removed",
    413: "it gives no parts as large as this; choose less with --region, --levels and --start, --end",
    429: "it asks for fewer requests; try again later",
    503: "it is busy or closed for maintenance; try again later",
}


@dataclass(frozen=True, slots=True)
class Limits:
    """What a server may take.

    Attributes:
        bytes: All that is received [bytes].
        silence: Longest time without a byte [s]; as long may a hundred bytes a second be the average.
        attempts: Times that a request is tried.
        pause: Before the second attempt [s]; before each later one twice as long.
        memory: Largest part that is held at once, unpacked [bytes].
    """

    bytes: float = 1e9
    silence: float = 30.0
    attempts: int = 6
    pause: float = 0.25
    memory: float = 2.56e8


class _BrokenError(Exception):
    """An answer that another attempt may give."""


class Client:
    """Requests to the servers of one forecast.

    What small answers held is kept, so that metadata and the chunks that told the correlation length are received once.

    Attributes:
        limits: What a server may take.
        received: Bytes of answers.
        refused: What the server said last when it was asked what there is.
    """

    _REMEMBERED = 1 << 26

    def __init__(self, limits: Limits) -> None:
        self.limits, self.received = limits, 0
        self._http = _urllib3()
        timeout = self._http.Timeout(connect=min(10.0, limits.silence), read=limits.silence)
        self._pool = self._http.PoolManager(num_pools=8, maxsize=16, retries=False, timeout=timeout)
        self._lock = threading.Lock()
        self._held: dict[tuple[str, Span], bytes | None] = {}
        self.refused = ""
        self._tags: dict[str, str] = {}

    def close(self) -> None:
        """Close all connections."""
        self._pool.clear()

    def probe(self, url: str, span: Span = (0, None)) -> bytes | None:
        """Return what is at an address, to find out what a data set is; None where the server does not say.

        Raises:
            ForecastError: As in ``get``, but not for an answer that refuses.
        """
        return self.get(url, METADATA, span, probing=True)

    def get(
        self,
        url: str,
        most: float,
        span: Span = (0, None),
        origin: str = "",
        probing: bool = False,
    ) -> bytes | None:
        """Return what is at an address, or a part of it; None where nothing is.

        Args:
            url: The address.
            most: Bytes that are expected at most.
            span: The part.
            origin: The address that the user gave, where a data set of that address names this one.
            probing: Whether a refusal only says that nothing is there.

        Raises:
            ForecastError: The server cannot be reached, refuses, sends something else or too much, or was asked too often.
        """
        if origin:
            check_leads(origin, url)
        if (url, span) in self._held:
            return self._held[url, span]
        body, broken = _Body(span), ""
        for attempt in range(self.limits.attempts):
            if attempt:
                time.sleep(self.limits.pause * 2 ** (attempt - 1))
            try:
                found = self._receive(url, body, most, probing)
            except (_BrokenError, self._http.exceptions.HTTPError, OSError) as error:
                broken = _in_words(error)
                if isinstance(error, self._http.exceptions.TimeoutError) and attempt:
                    break
                continue
            data = None if not found else bytes(body.data)
            # what is not there may only be lost for a moment, unless it was to find out what there is
            small = sum(len(each or b"") for each in self._held.values()) < self._REMEMBERED
            if small and (probing or data is not None):
                self._held[url, span] = data
            return data
        raise ForecastError(
            f"{public(url)}: the server gave no whole answer in {attempt + 1} attempts: {broken}; check the connection, or try again later"
        )

    def head(self, url: str) -> tuple[int | None, str]:
        """Return the bytes at an address, and what says whether they changed; None and empty where the server states nothing.

        Raises:
            ForecastError: It leads to where it may not.
        """
        try:
            response = self._ask("HEAD", url, {})
        except (self._http.exceptions.HTTPError, OSError):
            return None, ""
        response.release_conn()
        length = str(response.headers.get("Content-Length", ""))
        size = int(length) if response.status == 200 and length.isdigit() else None
        return size, _tag(response) or str(response.headers.get("Last-Modified", ""))

    def _receive(self, url: str, body: "_Body", most: float, probing: bool) -> bool:
        """Add to a body what is still missing; return whether there is something at the address."""
        response = self._ask("GET", url, body.headers())
        try:
            if response.status in (404, 410):
                return False
            if response.status == 416:
                raise ForecastError(
                    f"{public(url)}: it is shorter than its own description says; it may have changed: try again"
                )
            if response.status not in (200, 206):
                if probing and response.status in _NOT_THERE:
                    self.refused = f"status {response.status}{_said(response.read(_BLOCK // 64))}"
                    return False
                self._refuse(url, response)
            self._check_tag(url, _tag(response))
            body.begin(response)
            if (length := body.expected) is not None and length > most:
                raise _too_much(url, length, most)
            for block in self._blocks(response):
                body.data += block
                if len(body.data) > most:
                    raise _too_much(url, None, most)
        finally:
            # a connection with an unread rest cannot serve another request
            response.close() if not response.isclosed() else response.release_conn()
        if body.expected is not None and len(body.data) < body.expected:
            raise _BrokenError(
                f"the connection ended after {len(body.data)} of {body.expected} bytes"
            )
        body.finish()
        return True

    def _blocks(self, response: Any) -> Iterator[bytes]:
        """Yield an answer as it comes, and count it.

        Raises:
            ForecastError: More than is allowed in all.
        """
        began, got = time.monotonic(), 0
        while block := response.read1(_BLOCK):
            got += len(block)
            with self._lock:
                self.received += len(block)
            if self.received > self.limits.bytes:
                raise ForecastError(
                    f"more than --max-download {self.limits.bytes / 1e6:.4g} MB were received; choose less with --region, --levels and "
                    "--start, --end, or allow more"
                )
            if (took := time.monotonic() - began) > self.limits.silence and got < 100 * took:
                raise _BrokenError(f"{got} bytes in {took:.1f} s")
            yield block

    def _check_tag(self, url: str, tag: str) -> None:
        if tag and self._tags.setdefault(url, tag) != tag:
            raise ForecastError(
                f"{public(url)}: the data changed between two requests; fetch again, when the provider has finished"
            )

    def _refuse(self, url: str, response: Any) -> None:
        """Raise the error of an answer that holds no data."""
        status, said = response.status, _said(response.read(_BLOCK // 64))
        if status in _BUSY:
            wait = str(response.headers.get("Retry-After", ""))
            if wait.isdigit():
                time.sleep(min(int(wait), 10.0, self.limits.silence))
            raise _BrokenError(f"status {status}{said}")
        meaning = _MEANINGS.get(status, "it cannot answer")
        raise ForecastError(
            f"{public(url)}: the server answers with status {status}: {meaning}{said}"
        )

    def _ask(self, method: str, url: str, headers: dict[str, str]) -> Any:
        """Return the answer to a request, after redirections to where a server may lead."""
        asked = url
        for _ in range(_REDIRECTS):
            parts = urlsplit(url)
            own = {"Accept-Encoding": "identity", "User-Agent": "replay-kit", **headers}
            login = urlsplit(asked)
            if login.username and _place(url) == _place(asked):
                pair = f"{unquote(login.username)}:{unquote(login.password or '')}"
                own["Authorization"] = "Basic " + base64.b64encode(pair.encode()).decode()
            target = parts._replace(netloc=parts.netloc.rpartition("@")[2], fragment="").geturl()
            response = self._pool.request(
                method, target, headers=own, redirect=False, preload_content=False
            )
            if response.status not in (301, 302, 303, 307, 308):
                if response.headers.get("Content-Encoding", "identity") != "identity":
                    response.close()
                    raise ForecastError(
                        f"{public(url)}: the server packs its answers ({response.headers['Content-Encoding']}) although it was asked not to"
                    )
                return response
            response.close()
            url = urljoin(url, response.headers.get("Location", ""))
            check_leads(asked, url)
        raise ForecastError(
            f"{public(asked)}: redirects more than {_REDIRECTS} times; check the address"
        )


class _Body:
    """What was received of an answer, which a later request may complete."""

    def __init__(self, span: Span) -> None:
        self.data = bytearray()
        self.expected: int | None = None
        self._span, self._tag, self._cut = span, "", False

    def headers(self) -> dict[str, str]:
        """Return the headers that ask for what is missing."""
        start, stop = self._span
        # only what is known to be of the same state is continued
        if not self._tag or start < 0:
            self.data.clear()
        have = len(self.data)
        if start < 0:
            return {"Range": f"bytes={start}"}
        if start + have == 0 and stop is None:
            return {}
        found = {"Range": f"bytes={start + have}-{'' if stop is None else stop - 1}"}
        return {**found, "If-Range": self._tag} if have else found

    def begin(self, response: Any) -> None:
        """Take note of how an answer begins."""
        start = self._span[0]
        place = re.match(
            r"bytes (\d+)-(\d+)/(\d+|\*)", str(response.headers.get("Content-Range", ""))
        )
        length = str(response.headers.get("Content-Length", ""))
        left = int(length) if length.isdigit() else None
        if response.status == 206 and place:
            first = int(place[1])
            if start >= 0 and first != start + len(self.data):
                raise _BrokenError("another part than the one asked for")
            left = int(place[2]) - first + 1
        elif response.status == 206:
            raise _BrokenError("a part that does not say which")
        else:
            self.data.clear()
            # the whole although a part was asked for: the part is taken of it
            self._cut = self._span != (0, None)
        self._tag = _tag(response)
        self.expected = None if left is None else left + len(self.data)

    def finish(self) -> None:
        """Leave only the part that was asked for."""
        if self._cut:
            self.data = self.data[self._span[0] : self._span[1]]


def check_leads(origin: str, url: str) -> None:
    """Check that the server of an address may lead to another one.

    Raises:
        ForecastError: It leads to a file, or into a private network to which the address itself does not belong.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ForecastError(
            f"{public(origin)}: leads to {public(url)[:100]}, which is no address of the web; this is refused"
        )
    if _place(url) == _place(origin):
        return
    if urlsplit(origin).scheme == "https" and parts.scheme == "http":
        raise ForecastError(
            f"{public(origin)}: leads to {public(url)}, which is not encrypted; give that address itself if you trust it"
        )
    try:
        found = socket.getaddrinfo(parts.hostname, parts.port or 443, type=socket.SOCK_STREAM)
    except OSError as error:
        raise ForecastError(
            f"{public(origin)}: leads to {public(url)}, whose server is not known: {error}"
        ) from error
    if not all(
        ipaddress.ip_address(str(entry[4][0]).partition("%")[0]).is_global for entry in found
    ):
        raise ForecastError(
            f"{public(origin)}: leads to {public(url)}, which is in a private network; this is refused: give that address itself if it is "
            "meant"
        )


def _place(url: str) -> tuple[str | None, int | None]:
    parts = urlsplit(url)
    return parts.hostname, parts.port or {"http": 80, "https": 443}.get(parts.scheme)


def _tag(response: Any) -> str:
    """Return what names the state of the data, if the server states it for certain."""
    tag = str(response.headers.get("ETag", ""))
    return "" if tag.startswith("W/") else tag


def _too_much(url: str, length: int | None, most: float) -> ForecastError:
    sent = "more" if length is None else f"{length / 1e6:.4g} MB"
    return ForecastError(
        f"{public(url)}: the server sends {sent}, where {most / 1e6:.4g} MB were expected at most; it was not read on"
    )


def _said(body: bytes) -> str:
    """Return what an error's page says, in one line."""
    text = body.decode("utf-8", "replace")
    if quoted := re.search(r'message\s*=\s*"((?:[^"\\]|\\.)*)"', text):
        text = quoted[1]
    text = re.sub(r"(?is)<(script|style).*?</\1>|<[^>]*>", " ", text)
    text = printable(" ".join(text.split()))[:200]
    return f"; it says: {text}" if text else ""


def is_page(data: bytes) -> bool:
    """Return whether bytes are a page of the web, as of a login, and no data."""
    return bool(re.match(rb"\s*(<!doctype|<html|<\?xml)", data[:200], re.IGNORECASE))


def _in_words(error: Exception) -> str:
    """Return what happened to a connection, without the address, which may hold a login."""
    name = type(error).__name__
    if isinstance(error, _BrokenError):
        return str(error)
    if "Timeout" in name:
        return "the server was silent for too long"
    if name in ("NameResolutionError", "gaierror"):
        return "the name of the server is not known"
    if "CERTIFICATE" in str(error).upper():
        return "its certificate is not valid"
    return {
        "NewConnectionError": "the connection is refused",
        "ProtocolError": "the connection was closed",
        "IncompleteRead": "the connection was closed before the end",
    }.get(name, name)


def _urllib3() -> ModuleType:
    """Return the library that speaks to servers.

    Raises:
        ForecastError: It is not installed.
    """
    try:
        import urllib3
    except ImportError as error:
        raise ForecastError(
            "a forecast on a server needs the extra 'remote': pip install 'replay-kit[remote]'"
        ) from error
    return urllib3
