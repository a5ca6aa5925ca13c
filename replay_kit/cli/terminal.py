"""Escape control characters before printing; loaded with rich, when something is printed."""

from typing import Any

from rich.console import Console
from rich.text import Text

from replay_kit.core.text import printable


class SafeConsole(Console):
    """A console that shows control characters in texts, such as those of names in a log, and obeys none of them."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text to be laid out: of a printed line, and of each cell and heading of a table."""
        return super().render_str(printable(text), **options)
