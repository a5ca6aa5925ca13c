"""What holds of every page: each figure has a caption, a text alternative, its data and units, and nothing is fetched."""

import re
from typing import Any

from tests.show.report.html_of import elements, figures


def check_figures(page: str) -> dict[str, dict[str, Any]]:
    """Return the figures of a page by their keys, all of them checked."""
    check_ids(page)
    found = figures(page)
    shown = {attrs["id"] or "": text for attrs, text in elements(page, "figure")}
    assert list(shown) == list(found)
    assert all(len(text) > 20 for _, text in elements(page, "figcaption"))
    plots = [attrs for attrs, _ in elements(page, "div") if attrs.get("class") == "plot"]
    assert all(
        len(attrs["aria-label"] or "") > 30
        and attrs["tabindex"] == "0"
        and attrs["role"] == "group"
        for attrs in plots
    )
    assert len(plots) == len(found)
    for key, figure in found.items():
        for panel in figure.get("panels", ()):
            units = r"\[.+\]|UTC|NIS|dive|density|innovation /|values|pings"
            assert all(re.search(units, text) for text in panel["axes"]), (key, panel["axes"])
            _check_marks(key, panel)
    _check_nothing_is_fetched(page)
    return found


def check_ids(page: str) -> None:
    """Check that each id is that of one element, and that what names an id is about an element of the page."""
    ids = re.findall(r'<[a-z][^<>]*\sid="([^"]*)"', page)
    assert sorted(set(ids)) == sorted(ids)
    named = [
        attrs["href"][1:]
        for attrs, _ in elements(page, "a")
        if (attrs["href"] or "").startswith("#")
    ]
    labels = [attrs for tag in ("label", "output") for attrs, _ in elements(page, tag)]
    # a label of a layer is around its box
    named += [attrs["for"] for attrs in labels if "for" in attrs]
    assert set(named) <= set(ids)


def _check_marks(key: str, panel: dict[str, Any]) -> None:
    """Check that what is said beside the pointer is of a length with the places of its mark."""
    for mark in panel["marks"]:
        x, y, z, text = (mark.get(part) for part in ("x", "y", "z", "text"))
        assert len(x) > 0, key
        assert len(z) == (len(x) - 1) * (len(y) - 1) if z else len(x) == len(y), key
        assert text is None or len(text) == len(x), key


def _check_nothing_is_fetched(page: str) -> None:
    fetching = [
        attrs["src"]
        for tag in ("script", "link", "img", "iframe")
        for attrs, _ in elements(page, tag)
        if attrs.get("src")
    ]
    assert [url for url in fetching if not (url or "").startswith("data:")] == []
    assert [attrs["href"] for attrs, _ in elements(page, "link")] == ["data:,"]
    own = re.sub(r'<script type="application/octet-stream".*?</script>', "", page, flags=re.DOTALL)
    assert "http" not in own.replace("http-equiv", "")
    assert "connect-src 'none'" in page
