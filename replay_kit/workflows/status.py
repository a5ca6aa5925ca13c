"""Status of a result: read, displayed, written as a page."""

from collections.abc import Mapping
from pathlib import Path

from replay_kit.core.files.atomic import write_whole
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import ResultReader, part_path
from replay_kit.show.status.held import Held, read_held
from replay_kit.show.status.lines import several_page, status_page
from replay_kit.show.status.status import Status, status_of
from replay_kit.workflows.sound import Sound, sound_result


def read_status(
    path: Path, now_ns: int | None = None
) -> tuple[dict[str, Status], Outcome | None, Sound]:
    """Return the status by vehicle of a result, with an empty name for a single one, the outcome, and the losses.

    Args:
        path: Result; of a damaged one the recoverable content.
        now_ns: Present time [ns, UTC]; None for the last time of the result.

    Raises:
        LogError: The file is missing, or is not a result.
    """
    with sound_result(path) as sound:
        reader = ResultReader(sound.path, opened=sound.file)
        each = read_each(reader)
        found = {name: status_of(held, now_ns, name) for name, held in each.items()}
        return found, reader.outcome, sound


def read_each(reader: ResultReader) -> dict[str, Held]:
    """Return the data for the status by vehicle of a result, with an empty name for a single one.

    Raises:
        LogError: The file is missing, or is not a complete result.
    """
    names = [one.name for one in reader.vehicles if not one.why_not] or [""]
    return {name: read_held(reader.part(name)) for name in names}


def write_pages(
    statuses: Mapping[str, Status], outcome: Outcome | None, path: Path, refresh_s: int = 60
) -> None:
    """Write the status page of a result; for several vehicles a table and a page for each.

    Raises:
        ConfigError: A page cannot be written.
    """
    if "" in statuses:
        write_whole(path, status_page(statuses[""], refresh_s))
        return
    pages = {name: part_path(path, name, path.parent) for name in statuses}
    for name, page in pages.items():
        write_whole(page, status_page(statuses[name], refresh_s))
    names = {name: page.name for name, page in pages.items()}
    write_whole(path, several_page(statuses, outcome, names, refresh_s))
