"""Bytes of a server: with time-outs, resumed where a connection breaks, never more than was allowed, and never from where nobody asked."""

import base64
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urljoin, urlsplit

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import public
from replay_kit.forecast.remote.answers import (
    MEANINGS,
    NOT_THERE,
    Body,
    BrokenAnswerError,
    Span,
    check_leads,
    in_words,
    place_of,
    said_in,
    tag_of,
    too_much,
)

#: Largest description of a data set [bytes].
METADATA = 1 << 26
_BLOCK = 1 << 18
_REDIRECTS = 5
_BUSY = (408, 425, 429, 500, 502, 503, 504)


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
        self._kept = 0
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
        body, broken = Body(span), ""
        for attempt in range(self.limits.attempts):
            if attempt:
                time.sleep(self.limits.pause * 2 ** (attempt - 1))
            try:
                found = self._receive(url, body, most, probing)
            except (BrokenAnswerError, self._http.exceptions.HTTPError, OSError) as error:
                broken = in_words(error)
                if isinstance(error, self._http.exceptions.TimeoutError) and attempt:
                    break
                continue
            data = None if not found else bytes(body.data)
            # what is not there may only be lost for a moment, unless it was to find out what there is
            # chunks are received by several threads
            with self._lock:
                if self._kept < self._REMEMBERED and (probing or data is not None):
                    self._held[url, span] = data
                    self._kept += len(data or b"")
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
        return size, tag_of(response) or str(response.headers.get("Last-Modified", ""))

    def _receive(self, url: str, body: "Body", most: float, probing: bool) -> bool:
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
                if probing and response.status in NOT_THERE:
                    self.refused = f"status {response.status}{said_in(response.read(_BLOCK // 64))}"
                    return False
                self._refuse(url, response)
            self._check_tag(url, tag_of(response))
            body.begin(response)
            if (length := body.expected) is not None and length > most:
                raise too_much(url, length, most)
            for block in self._blocks(response):
                body.data += block
                if len(body.data) > most:
                    raise too_much(url, None, most)
        finally:
            # a connection with an unread rest cannot serve another request
            response.close() if not response.isclosed() else response.release_conn()
        if body.expected is not None and len(body.data) < body.expected:
            raise BrokenAnswerError(
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
                raise BrokenAnswerError(f"{got} bytes in {took:.1f} s")
            yield block

    def _check_tag(self, url: str, tag: str) -> None:
        if tag and self._tags.setdefault(url, tag) != tag:
            raise ForecastError(
                f"{public(url)}: the data changed between two requests; fetch again, when the provider has finished"
            )

    def _refuse(self, url: str, response: Any) -> None:
        """Raise the error of an answer that holds no data."""
        status, said = response.status, said_in(response.read(_BLOCK // 64))
        if status in _BUSY:
            wait = str(response.headers.get("Retry-After", ""))
            if wait.isdigit():
                time.sleep(min(int(wait), 10.0, self.limits.silence))
            why = f": {MEANINGS[status]}" if status in MEANINGS else ""
            raise BrokenAnswerError(f"status {status}{why}{said}")
        meaning = MEANINGS.get(status, "it cannot answer")
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
            if login.username and place_of(url) == place_of(asked):
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
