"""Results with valid checksums: the file itself, or a copy of a damaged file's recoverable content, with its losses.

All commands read results through this module. The checksums of data and summary are compared first, without decompression; only on a
mismatch is the file scanned as a damaged log.
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

from threadpoolctl import threadpool_limits

from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.files.paths import as_path
from replay_kit.core.message import Loss
from replay_kit.results.losses import loss_words
from replay_kit.results.mcap.topics import DAMAGED, OpenResult, checksums_fit

if TYPE_CHECKING:
    from replay_kit.show.notebook import Result

# What readers raise on what could be recovered of a result, beside what they raise on any damaged file.
_INCOMPLETE = (*DAMAGED, TypeError, AttributeError, RuntimeError)


@dataclass(frozen=True, slots=True)
class Sound:
    """Result with valid checksums.

    Attributes:
        file: Opened readable file.
        given: File as given.
        losses: Content of that file that was lost.
        unchecked: Whether no checksum covers the whole file, as in files of other programs.
    """

    file: OpenResult
    given: Path
    losses: tuple[Loss, ...] = ()
    unchecked: bool = False

    @property
    def path(self) -> Path:
        """Path of the readable file."""
        return self.file.path

    @property
    def exit_code(self) -> int:
        """4 if something was lost, else 0."""
        return 4 if self.losses else 0

    @property
    def lines(self) -> tuple[str, ...]:
        """Losses, and whether damage could be detected, one line each."""
        lost = tuple(f"LOST: {self.given.name}: {loss_words(loss)}" for loss in self.losses)
        note = f"Note: {self.given.name}: has no checksum of the whole file, so damage cannot be detected"
        return (*lost, note) if self.unchecked else lost


@contextmanager
def sound_result(path: Path) -> Iterator[Sound]:
    """Yield a result with valid checksums; errors of its readers from lost content name the loss.

    The products of matrices in a result are small: threads of a library would only wait for each other.

    Raises:
        LogError: Too little of the file could be recovered.
    """
    folder = tempfile.TemporaryDirectory(prefix="replay_kit_")
    with threadpool_limits(limits=1), folder as name:
        sound = recover(path, Path(name))
        try:
            yield sound
        except (ReplayKitError, *_INCOMPLETE) as error:
            if not sound.losses or getattr(error, "exit_code", 3) != LogError.exit_code:
                raise
            raise _too_little(sound, error) from error


def _too_little(sound: Sound, error: Exception) -> LogError:
    why = str(error).replace(str(sound.path), str(sound.given))
    is_ours = isinstance(error, ReplayKitError)
    return LogError(
        f"{why if is_ours else f'{sound.given}: expected a result of replay-kit replay or plan, but too little of it could be recovered'}"
        f" ({'; '.join(sound.lines)}); copy the file again, or make the result again"
    )


def recover(path: Path, folder: Path) -> Sound:
    """Return a result with valid checksums, a copy of the recoverable content only for a damaged file.

    Args:
        path: Result.
        folder: Folder of the copy.

    Raises:
        LogError: The file is missing, or is not an MCAP file.
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
    """Return a result of ``replay``, with its estimate and tables, which are read on first access.

    For a damaged file a copy of the recoverable content is opened, with a warning about the losses.

    Raises:
        LogError: The file is missing, or is not a result.
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
