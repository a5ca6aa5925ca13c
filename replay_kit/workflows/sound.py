"""A result whose checksums fit: the file itself, or of a damaged one a copy of what could be recovered, and what was lost.

Every command that reads a result begins here. The checksums of a file's data and of its summary are compared first, without unpacking it;
only where they do not fit is the file scanned, as a damaged log is.
"""

import shutil
import tempfile
import warnings
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.message import Loss
from replay_kit.core.paths import as_path
from replay_kit.results.losses import loss_words
from replay_kit.results.topics import DAMAGED, OpenResult, checksums_fit

if TYPE_CHECKING:
    from replay_kit.show.notebook import Result

# What readers raise on what could be recovered of a result, beside what they raise on any damaged file.
_INCOMPLETE = (*DAMAGED, TypeError, AttributeError, RuntimeError)


@dataclass(frozen=True, slots=True)
class Sound:
    """A result whose checksums fit.

    Attributes:
        file: What can be read of it, opened.
        of: The file that was given.
        losses: What of that file is not in it.
        unchecked: Whether the file has no checksum that covers all of it, as files of other programs.
    """

    file: OpenResult
    of: Path
    losses: tuple[Loss, ...] = ()
    unchecked: bool = False

    @property
    def path(self) -> Path:
        """Where it can be read."""
        return self.file.path

    @property
    def exit_code(self) -> int:
        """4 where something was lost, else 0."""
        return 4 if self.losses else 0

    @property
    def lines(self) -> tuple[str, ...]:
        """What was lost, and whether damage could be detected, a line each."""
        lost = tuple(f"LOST: {self.of.name}: {loss_words(loss)}" for loss in self.losses)
        note = f"Note: {self.of.name}: has no checksum over all of it, so that damage cannot be detected"
        return (*lost, note) if self.unchecked else lost


@contextmanager
def sound_result(path: Path) -> Iterator[Sound]:
    """Yield a result whose checksums fit; what its readers raise for want of what was lost names the loss.

    Raises:
        LogError: Too little of the file could be recovered.
    """
    with tempfile.TemporaryDirectory(prefix="replay_kit_") as folder:
        sound = recover(path, Path(folder))
        try:
            yield sound
        except (ReplayKitError, *_INCOMPLETE) as error:
            if not sound.losses or getattr(error, "exit_code", 3) != LogError.exit_code:
                raise
            raise _too_little(sound, error) from error


def _too_little(sound: Sound, error: Exception) -> LogError:
    why = str(error).replace(str(sound.path), str(sound.of))
    own = isinstance(error, ReplayKitError)
    return LogError(
        f"{why if own else f'{sound.of}: expected a result of replay-kit replay or plan, but too little of it could be recovered'}"
        f" ({'; '.join(sound.lines)}); copy the file again, or make the result again"
    )


def recover(path: Path, folder: Path) -> Sound:
    """Return a result whose checksums fit; a copy of what could be recovered is made only of a damaged file.

    Args:
        path: The result.
        folder: Where the copy is made.

    Raises:
        LogError: The file is missing, or is no MCAP file.
    """
    file = OpenResult(path)
    if checksums_fit(file.file):
        return Sound(file, path)
    # here, because a sound result needs no reader of logs
    from replay_kit.logs.mcap.reader import McapReader
    from replay_kit.logs.mcap.writer import open_mcap_log

    copy = folder / path.name.removesuffix(".part")
    with McapReader(path) as log, open_mcap_log(copy, log.profile() or "") as writer:
        for message in log.raw_messages(writer.copy_extra):
            writer.copy(message)
        losses = log.report().losses
    return Sound(OpenResult(copy), path, losses) if losses else Sound(file, path, unchecked=True)


def open_result(path: str | Path) -> "Result":
    """Return a result that ``replay`` wrote, with its estimate and tables; they are read when first asked for.

    Of a damaged file a copy of what could be recovered is opened, and a warning says what was lost.

    Raises:
        LogError: The file is missing, or is no result.
        ConfigError: The path is neither text nor a ``Path``.
    """
    # here, because tables and estimates take half a second to load
    from replay_kit.show.notebook import read_result

    given, folder = as_path(path, "result"), tempfile.mkdtemp(prefix="replay_kit_")
    try:
        sound = recover(given, Path(folder))
        result = read_result(sound.path, opened=sound.file)
    except BaseException:
        shutil.rmtree(folder)
        raise
    weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    if sound.lines:
        warnings.warn("; ".join(sound.lines), stacklevel=2)
    return result
