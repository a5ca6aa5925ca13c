"""The status of a result: read, shown, written as a page."""

from pathlib import Path

from replay_kit.core.atomic import atomic_file
from replay_kit.show.status.held import read_held
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import Status, status_of


def read_status(path: Path, now_ns: int | None = None) -> Status:
    """Return the status of a result.

    Args:
        path: The result.
        now_ns: The present time [ns, UTC]; None for the last time of the result.

    Raises:
        LogError: The file is missing, or is no complete result.
    """
    return status_of(read_held(path), now_ns)


def write_page(status: Status, path: Path, refresh_s: int = 60) -> None:
    """Write a status as a page that loads itself again every so many seconds.

    Raises:
        ConfigError: The page cannot be written.
    """
    with atomic_file(path) as file:
        file.write(status_page(status, refresh_s).encode())
