"""Texts of others, made harmless for a terminal."""

import re

# Controls of a terminal (ESC among them), ends of lines, marks that turn the direction of writing, and halves of characters, which have no
# bytes.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return a text that a terminal shows and does not obey: controls and ends of lines as ``\x1b`` or ``\n``.

    Names of topics, files, frames, units and attributes are what a log's author wrote.
    """
    return _CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)
