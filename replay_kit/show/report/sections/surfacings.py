"""Where dives were expected to surface, and where they did: a table and how often the ellipses held."""

from collections.abc import Mapping
from html import escape
from typing import Any

from replay_kit.show.page.section import number, table_html
from replay_kit.show.words import surfacings_sentences

_HEADS = (
    "dive",
    "earlier dives",
    "distance [m]",
    "50 % ellipse [m]",
    "90 % ellipse [m]",
    "held by",
    "log score",
    "log score of the last dive's current",
)


def surfacings_html(found: Mapping[str, Any] | None) -> str:
    """Return the expected surfacings of a summary as a table with its sentences; empty without any."""
    if not found:
        return ""
    words = "".join(
        f"<p>{escape(sentence[0].upper() + sentence[1:])}.</p>"
        for sentence in surfacings_sentences(found)
    )
    rows = [_row(f"expected_surfacings.each.{k}", one) for k, one in enumerate(found["each"])]
    return (
        table_html(list(_HEADS), rows, "Surfacings: each expected from the dives before it") + words
    )


def _row(key: str, one: dict[str, Any]) -> list[str]:
    held = "50 %" if one["inside_50"] else "90 %" if one["inside_90"] else "neither"
    axes = [
        f"{one[name]['major_m']:.0f} x {one[name]['minor_m']:.0f}"
        for name in ("ellipse_50", "ellipse_90")
    ]
    scores = [
        number(f"{key}.{name}", one[name], _text(one[name]))
        for name in ("log_score", "persistent_log_score")
    ]
    counts = [
        number(f"{key}.{name}", one[name], str(one[name])) for name in ("dive", "earlier_dives")
    ]
    return [
        *counts,
        number(f"{key}.distance_m", one["distance_m"], f"{one['distance_m']:.0f}"),
        *axes,
        held,
        *scores,
    ]


def _text(score: float | None) -> str:
    return "" if score is None else f"{score:.2f}"
