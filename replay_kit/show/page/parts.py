"""HTML elements of pages: tables, lists, a compass."""

from collections.abc import Sequence
from html import escape

#: Rows of a table that is open at first.
_ROWS_OPEN = 14


def table_html(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    """Return a table as HTML, scrollable if wide and folded if long.

    Args:
        heads: Column headings.
        rows: Rows of escaped cells.
        caption: Caption.
    """
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    table = (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
        f"<table><caption><span>{escape(caption)}</span></caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )
    if len(rows) <= _ROWS_OPEN:
        return table
    return f"<details><summary>{escape(caption)} ({len(rows)} rows)</summary>{table}</details>"


def items_html(items: Sequence[str]) -> str:
    """Return a list of escaped items as HTML."""
    return f"<ul>{''.join(f'<li>{item}</li>' for item in items)}</ul>"


def compass(bearing: float, what: str) -> str:
    """Return a compass with an arrow as SVG.

    Args:
        bearing: Bearing clockwise from north [degrees].
        what: Text alternative.
    """
    return (
        f'<svg class="compass" viewBox="-33 -33 66 66" role="img" aria-label="{escape(what)}"><circle r="31"/><text y="-20">N</text>'
        f'<path transform="rotate({bearing:.1f})" d="M0-25 L8 12 L0 6 L-8 12Z"/></svg>'
    )
