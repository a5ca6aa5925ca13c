"""Report page of a result, also of an incomplete one: recoverable content, and a note of losses."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replay_kit.core.files.atomic import write_whole
from replay_kit.core.files.paths import check_paths
from replay_kit.results.mcap.schemas import CONTRACT_VERSION
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.reader import part_path
from replay_kit.results.views.contents import Contents
from replay_kit.show.notebook import Result, read_result
from replay_kit.workflows.sound import sound_result

_RECOVERED = "The result is damaged or truncated: only its recoverable content is shown."


def report(
    path: Path, out: Path, overwrite: bool = False, made: Outcome | None = None
) -> tuple[int, Contents]:
    """Write the report on a result, and return its size [bytes] and contents.

    Args:
        path: Result of a replay or a plan; a truncated one is shown up to its last complete chunk.
        out: Page to write.
        overwrite: Whether an existing page is replaced.
        made: Outcome of the replay just finished, for its score against a truth, which the file lacks.

    Raises:
        LogError: The file is missing, or is not a result.
        ConfigError: The page exists and may not be replaced, or cannot be written.
    """
    # here, because plots and exports need no pages
    from replay_kit.show.report.pages import report_html, several_html

    check_paths([path], [out], overwrite)
    with opened_contents(path, made) as contents:
        each = {name: part_path(out, name, out.parent) for name in contents.each if name}
        check_paths([path], each.values(), overwrite)
        for name, page in each.items():
            _write(page, report_html(contents.each[name].result, contents.notes))
        names = {name: page.name for name, page in each.items()}
        text = (
            several_html(contents, names) if each else report_html(contents.result, contents.notes)
        )
        return _write(out, text), contents


def _write(path: Path, text: str) -> int:
    """Write a page, and return its size [bytes]."""
    page = text.encode()
    write_whole(path, page)
    return len(page)


@contextmanager
def opened_contents(path: Path, made: Outcome | None = None) -> Iterator[Contents]:
    """Yield the recoverable contents of a result, with notes on its losses.

    Args:
        path: See ``report``.
        made: See ``report``.

    Raises:
        LogError: The file is missing, or is not a result.
    """
    with sound_result(path) as sound:
        result = read_result(sound.path, made, sound.file)
        notes = (*sound.lines, *(_RECOVERED for _ in sound.losses[:1]), *_version_notes(result))
        yield Contents(result, notes, sound.exit_code)


def page_of(result: Path) -> Path:
    """Return the file of a result's page: the name of the result with the ending ``.html``."""
    name = result.name.removesuffix(".part").removesuffix(".mcap")
    return result.with_name(f"{name}.html")


def _version_notes(result: Result) -> tuple[str, ...]:
    version = result.reader.metadata.get("contract", {}).get("version", "unknown")
    if version == str(CONTRACT_VERSION):
        return ()
    return (
        f"The result has version {version} of the contract, this program version {CONTRACT_VERSION}: "
        "changes between them may not be shown.",
    )
