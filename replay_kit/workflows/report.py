"""A result as a page, also when the result is not complete: what can be recovered is shown, and what was lost is said."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replay_kit.config.run import LogConfig
from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import LogError
from replay_kit.core.paths import check_paths
from replay_kit.results import CONTRACT_VERSION
from replay_kit.results.losses import loss_words
from replay_kit.results.outcome.run import ReplaySummary
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.record import read_record
from replay_kit.show import Result, open_result
from replay_kit.show.report import report_html
from replay_kit.workflows.convert import convert


def report(
    path: Path, out: Path, overwrite: bool = False, summary: ReplaySummary | None = None
) -> int:
    """Write the report on a result, and return its size in bytes.

    Args:
        path: A result of a replay or a plan; of one that is cut short the whole chunks are shown.
        out: The page.
        overwrite: Whether an existing page is replaced.
        summary: Of the replay that has just made the result, for its score against a truth, which is not in the file.

    Raises:
        LogError: The file is missing, or is no result.
        ConfigError: The page exists and may not be replaced, or cannot be written.
    """
    check_paths([path], [out], overwrite)
    with opened(path, summary) as contents:
        page = report_html(contents.result, contents.notes).encode()
    with atomic_file(out) as file:
        file.write(page)
    return len(page)


@contextmanager
def opened(path: Path, summary: ReplaySummary | None = None) -> Iterator[Contents]:
    """Yield the contents of a result, with notes on what was lost of it; of one that is cut short, what could be recovered.

    Args:
        path: As in ``report``.
        summary: As in ``report``.

    Raises:
        LogError: The file is missing, or is no result.
    """
    with tempfile.TemporaryDirectory(prefix="replay_kit_") as folder:
        result, notes = _open(path, Path(folder))
        yield Contents(Result(result.path, summary), (*notes, *_version_notes(result)))


def page_of(result: Path) -> Path:
    """Return the name of the page of a result: the result's, with the ending ``.html``."""
    name = result.name.removesuffix(".part").removesuffix(".mcap")
    return result.with_name(f"{name}.html")


def _open(path: Path, folder: Path) -> tuple[Result, tuple[str, ...]]:
    """Return a result, and what was lost of it; of one that is cut short, what was recovered, as a file in a folder."""
    try:
        return open_result(path), ()
    except LogError as error:
        if not path.is_file():
            raise
        recovered = folder / f"{page_of(path).stem}.mcap"
        try:
            converted = convert([path], recovered, False, LogConfig())
            result = open_result(recovered)
        except LogError:
            # of the file itself: what was recovered of it is no result
            raise error from None
    lost = "; ".join(loss_words(loss) for _, loss in converted.losses) or "its end is missing"
    return result, (f"The result is cut short: {lost}. This page shows what could be recovered.",)


def _version_notes(result: Result) -> tuple[str, ...]:
    version = read_record(result.path).metadata.get("contract", {}).get("version", "unknown")
    if version == str(CONTRACT_VERSION):
        return ()
    return (
        f"The result has version {version} of the contract, this program version {CONTRACT_VERSION}: "
        "what changed between them is not shown, or under its former name.",
    )
