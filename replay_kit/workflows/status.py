"""The status of a result: read, shown, written as a page."""

from pathlib import Path

from replay_kit.core.atomic import atomic_file
from replay_kit.show.status.held import read_held
from replay_kit.show.status.page import status_page
from replay_kit.show.status.status import Status, status_of
from replay_kit.workflows.sound import Sound, sound_result


def read_status(path: Path, now_ns: int | None = None) -> tuple[Status, Sound]:
    """Return the status of a result, and what was lost of the file.

    Args:
        path: The result; of a damaged one what could be recovered counts.
        now_ns: The present time [ns, UTC]; None for the last time of the result.

    Raises:
        LogError: The file is missing, or is no result.
    """
    with sound_result(path) as sound:
        return status_of(read_held(sound.path), now_ns), sound


def write_page(status: Status, path: Path, refresh_s: int = 60) -> None:
    """Write a status as a page that loads itself again every so many seconds.

    Raises:
        ConfigError: The page cannot be written.
    """
    with atomic_file(path) as file:
        file.write(status_page(status, refresh_s).encode())
