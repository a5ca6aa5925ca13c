"""The reader of a glider's files, by what is in them."""

from collections.abc import Sequence
from pathlib import Path

from replay_kit.config.run import LogConfig
from replay_kit.logs.glider.files import open_glider_file
from replay_kit.logs.glider.reader import GliderReader
from replay_kit.logs.glider.rows import NetcdfRows
from replay_kit.logs.reader import LogFile


def open_glider(
    path: Path,
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
    more: Sequence[Path] = (),
) -> LogFile:
    """Return the reader of a glider's file, or of several that are one log.

    Args:
        path: The file, or the first of them.
        input: Position of the log among the run's inputs.
        config: How logs are read.
        wanted: Without effect.
        more: The others.

    Raises:
        LogError: A file cannot be read, or is of no known dialect.
    """
    files = [file for part in (path, *more) if (file := open_glider_file(part)) is not None]
    return (
        GliderReader(path, input, config, wanted, files=files)
        if files
        else NetcdfRows(path, input, config, wanted)
    )
