"""The layout of a viewer for a result, as a file."""

from pathlib import Path

from replay_kit.core.atomic import atomic_file
from replay_kit.results.layout.layout import layout_of, layout_text, require_topics
from replay_kit.results.topics import topics_of


def write_layout(result: Path, out: Path) -> int:
    """Write the layout for a result, also for one of an earlier version, and return the number of its panels.

    Raises:
        LogError: The file is missing, or is no complete result.
        ConfigError: The layout cannot be written.
    """
    topics = topics_of(result)
    require_topics(topics, str(result))
    layout = layout_of(topics)
    with atomic_file(out) as file:
        file.write(layout_text(layout).encode())
    return len(layout["configById"])
