"""What is in a page: its figures, and the numbers that its text carries."""

import base64
import gzip
import json
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np


class _Reader(HTMLParser):
    """Collects elements with their attributes and text, and sees that tags are closed in order."""

    VOID = frozenset({"meta", "link", "input", "br", "img"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[list[Any]] = []
        self.elements: list[tuple[str, dict[str, str | None], str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in self.VOID:
            self.elements.append((tag, dict(attrs), ""))
        else:
            self.open.append([tag, dict(attrs), ""])

    def handle_endtag(self, tag: str) -> None:
        opened, attrs, text = self.open.pop()
        assert opened == tag, f"<{opened}> is closed by </{tag}>"
        self.elements.append((tag, attrs, text))
        if self.open:
            self.open[-1][2] += text

    def handle_data(self, data: str) -> None:
        if self.open:
            self.open[-1][2] += data


def elements(page: str, tag: str) -> list[tuple[dict[str, str | None], str]]:
    """Return the attributes and the text of the elements of a kind."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return [(attrs, text) for name, attrs, text in reader.elements if name == tag]


def figures(page: str) -> dict[str, dict[str, Any]]:
    """Return the data of the figures by their keys."""
    (packed,) = (text for attrs, text in elements(page, "script") if attrs.get("id") == "figures")
    return {
        figure["key"]: figure for figure in json.loads(gzip.decompress(base64.b64decode(packed)))
    }


def track_of(page: str) -> dict[str, Any]:
    """Return the mark of the track on the map of a page."""
    marks = figures(page)["current-map"]["map"]["marks"]
    return next(mark for mark in marks if mark["role"] == "track")


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    """Return a packed array as the page's script reads it."""
    low, high = np.frombuffer(base64.b64decode(packed["data"]), np.uint8).reshape(2, -1)
    steps = np.stack([low, high], axis=1).reshape(-1).view("<i2").reshape(packed["shape"])
    whole = np.cumsum(steps, axis=packed["along"], dtype=np.int16)
    return np.where(whole == -32768, np.nan, whole * packed["scale"])


def text_of(page: str, section: str) -> str:
    """Return the text of a section without its markup."""
    (text,) = (text for attrs, text in elements(page, "section") if attrs.get("id") == section)
    return text


def table(page: str, caption: str) -> list[list[str]]:
    """Return the rows of a table by its caption."""
    (html,) = re.findall(
        rf"<caption><span>{re.escape(caption)}</span></caption>.*?<tbody>(.*?)</tbody>", page
    )
    return [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", html)]
