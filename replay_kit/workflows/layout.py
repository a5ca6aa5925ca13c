"""The layout of a viewer for a result, as a file."""

import struct
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import LogError
from replay_kit.results.layout.layout import layout_of, layout_text, require_topics


def write_layout(result: Path, out: Path) -> int:
    """Write the layout for a result, also for one of an earlier version, and return the number of its panels.

    Raises:
        LogError: The file is missing, or is no complete result.
        ConfigError: The layout cannot be written.
    """
    try:
        with result.open("rb") as file:
            summary = make_reader(file).get_summary()
        topics = [] if summary is None else [channel.topic for channel in summary.channels.values()]
    except OSError as error:
        raise LogError(f"{result}: cannot read the result: {error.strerror}; check the path") from error
    except (McapError, ValueError, struct.error) as error:
        raise LogError(f"{result}: expected a complete result of replay-kit replay: {error!r}") from error
    require_topics(topics, str(result))
    layout = layout_of(topics)
    with atomic_file(out) as file:
        file.write(layout_text(layout).encode())
    return len(layout["configById"])
