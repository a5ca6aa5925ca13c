"""What a server's answers are: a body that later answers complete, errors in words, and where the server may lead."""

import ipaddress
import re
import socket
from typing import Any
from urllib.parse import urlsplit

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import public
from replay_kit.core.text import printable

#: Part of a file: first byte and the one after the last, None for its end; a negative first byte counts from the end.
Span = tuple[int, int | None]
#: States of an answer that say that nothing is there, to one who only asks what is.
NOT_THERE = (400, 403, 405, 406, 500, 501)
#: What states of an answer mean, and what to do.
MEANINGS = {
    400: "it does not understand the request",
    401: "it asks for a login; write it as https://USER:PASSWORD@HOST/..., or use the provider's own client",
    403: "it refuses access; does the data need a login, or has an address that is signed expired?",
    404: "there is nothing at this address; check it",
    410: "the data were removed",
    413: "it gives no parts as large as this; choose less with --region, --levels and --start, --end",
    429: "it asks for fewer requests",
    503: "it is busy or closed for maintenance",
}


class BrokenAnswerError(Exception):
    """An answer that another attempt may give."""


class Body:
    """What was received of an answer, which a later request may complete."""

    def __init__(self, span: Span) -> None:
        self.data = bytearray()
        self.expected: int | None = None
        self._span, self.tag_of, self._cut = span, "", False

    def headers(self) -> dict[str, str]:
        """Return the headers that ask for what is missing."""
        start, stop = self._span
        # only what is known to be of the same state is continued
        if not self.tag_of or start < 0:
            self.data.clear()
        have = len(self.data)
        if start < 0:
            return {"Range": f"bytes={start}"}
        if start + have == 0 and stop is None:
            return {}
        found = {"Range": f"bytes={start + have}-{'' if stop is None else stop - 1}"}
        return {**found, "If-Range": self.tag_of} if have else found

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
                raise BrokenAnswerError("another part than the one asked for")
            left = int(place[2]) - first + 1
        elif response.status == 206:
            raise BrokenAnswerError("a part that does not say which")
        else:
            self.data.clear()
            # the whole although a part was asked for: the part is taken of it
            self._cut = self._span != (0, None)
        self.tag_of = tag_of(response)
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
    if place_of(url) == place_of(origin):
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


def place_of(url: str) -> tuple[str | None, int | None]:
    """Return the host and the port of an address."""
    parts = urlsplit(url)
    return parts.hostname, parts.port or {"http": 80, "https": 443}.get(parts.scheme)


def tag_of(response: Any) -> str:
    """Return what names the state of the data, if the server states it for certain."""
    tag = str(response.headers.get("ETag", ""))
    return "" if tag.startswith("W/") else tag


def too_much(url: str, length: int | None, most: float) -> ForecastError:
    """Return the error of an answer of more bytes than expected; a length of None is not known."""
    sent = "more" if length is None else f"{length / 1e6:.4g} MB"
    return ForecastError(
        f"{public(url)}: the server sends {sent}, where {most / 1e6:.4g} MB were expected at most; it was not read on"
    )


def said_in(body: bytes) -> str:
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


def in_words(error: Exception) -> str:
    """Return what happened to a connection, without the address, which may hold a login."""
    name = type(error).__name__
    if isinstance(error, BrokenAnswerError):
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


def foreign_words(error: Exception) -> str:
    """Return the first line of a foreign error that says something, without addresses, which may hold a login."""
    text = re.sub(r"\S+://\S+", "(an address)", " ".join(str(error).split()))
    return text[:200] or type(error).__name__
