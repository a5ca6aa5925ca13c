"""How much a command prints, and the file of ``--log`` that keeps it."""

from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from replay_kit.core.errors import ConfigError

# Columns of a pipe, which has no width of its own; COLUMNS in the environment is honoured before it.
PIPE_WIDTH = 160


@dataclass(frozen=True, slots=True)
class Reporting:
    """What ``-q``, ``-v`` and ``--log`` ask for.

    Attributes:
        quiet: Print errors only; answers that go to files and to ``-`` are not printed and stay.
        verbose: Print whole tables.
        log: File to which every printed line is added.
    """

    quiet: bool = False
    verbose: bool = False
    log: Path | None = None


_DEFAULT = Reporting()
_CURRENT: ContextVar[Reporting] = ContextVar("reporting", default=_DEFAULT)


def current() -> Reporting:
    """Return what the running command asked for."""
    return _CURRENT.get()


def begin(asked: Reporting) -> None:
    """Report from now on as a command asks for.

    Raises:
        ConfigError: The file of ``--log`` cannot be written.
    """
    _CURRENT.set(asked)
    try:
        keep("started")
    except OSError as error:
        _CURRENT.set(Reporting())
        raise ConfigError(
            f"--log: cannot write '{asked.log}': {error.strerror}; choose another file"
        ) from error


def keep(text: str) -> None:
    """Add lines with the time to the file of ``--log``, if there is one."""
    if (path := current().log) is not None and text.strip():
        now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        with path.open("a", encoding="utf-8") as file:
            file.writelines(
                f"{now} {line.rstrip()}\n" for line in text.splitlines() if line.strip()
            )
