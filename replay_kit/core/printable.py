"""Texts of others, made harmless for a terminal and for a spreadsheet.

Source: OWASP, "CSV Injection" (owasp.org/www-community/attacks/CSV_Injection).
"""

import re
from typing import Any

# Controls of a terminal (ESC among them), ends of lines, marks that turn the direction of writing, and halves of characters, which have no
# bytes.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return a text that a terminal shows and does not obey: controls and ends of lines as ``\x1b`` or ``\n``.

    Names of topics, files, frames, units and attributes are what a log's author wrote.
    """
    return _CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


#: What a text begins with that a spreadsheet takes for a formula, or for what comes before one; also as a full-width character.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def csv_cell(value: Any) -> Any:
    """Return a value for a CSV file: a text that a spreadsheet would run begins with an apostrophe, other values are as they are.

    Names of topics, sensors, frames and missions are what a log's author wrote.
    """
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value
