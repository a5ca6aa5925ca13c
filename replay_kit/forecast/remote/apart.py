"""Call in a separate process with a timeout, as libraries for servers may hang or crash."""

import logging
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from replay_kit.core.errors import ForecastError, ReplayKitError
from replay_kit.core.words.progress import announce, shown_by

_LOG = logging.getLogger(__name__)
_Value = TypeVar("_Value")
# s after which a process that announces no progress is ended
_SILENCE = 60.0
# s between two words of progress, and memory that a server's answers may take [bytes]
_OFTEN, _MEMORY = 0.2, 4 << 30


_ASKING: ContextVar[bool] = ContextVar("asking", default=False)


def may_ask() -> bool:
    """Return whether this process may contact servers: only a separate one may."""
    return _ASKING.get()


@contextmanager
def asking() -> Iterator[None]:
    """Allow contact with servers in this context."""
    token = _ASKING.set(True)
    try:
        yield
    finally:
        _ASKING.reset(token)


def call_apart(function: Callable[..., _Value], *arguments: Any, what: str) -> _Value:
    """Return the value of a call in a separate process, whose progress and log messages are passed on.

    Args:
        function: Function at module level; its arguments and value can be pickled.
        arguments: Arguments of the function.
        what: Subject of the call, for errors.

    Raises:
        ForecastError: The process was silent for too long, or died.
        ReplayKitError: Error raised by the function.
    """
    # what libraries write there is no word of ours
    errors = tempfile.TemporaryFile()  # noqa: SIM115
    process = subprocess.Popen(
        [sys.executable, "-c", f"from {__name__} import main; main()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
    )
    try:
        assert process.stdin is not None
        assert process.stdout is not None
        with process.stdin as file:
            file.write(pickle.dumps((sys.path, what, function, arguments)))
        with Connection(os.dup(process.stdout.fileno()), writable=False) as said:
            while True:
                if not said.poll(_SILENCE):
                    raise ForecastError(
                        f"{what}: the server was silent for {_SILENCE:g} s; check the connection, or try again later"
                    )
                kind, value = said.recv()
                if kind == "progress":
                    announce(*value)
                elif kind == "log":
                    _LOG.warning(value)
                elif kind == "error":
                    raise value
                else:
                    return value  # type: ignore[no-any-return]
    except EOFError as error:
        status = process.wait()
        errors.seek(0)
        last = errors.read()[-1000:].decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise ForecastError(
            f"{what}: reading from the server ended with status {status}{f' ({last})' if last else ''}; try again later, or download the "
            "forecast and give the file"
        ) from error
    finally:
        process.kill()
        process.wait()
        errors.close()
        if process.stdout is not None:
            process.stdout.close()


class _Forward(logging.Handler):
    def __init__(self, said: Connection) -> None:
        super().__init__(logging.WARNING)
        self._said = said

    def emit(self, record: logging.LogRecord) -> None:
        if record.name.startswith("replay_kit"):
            self._said.send(("log", record.getMessage()))


def main() -> None:
    """Execute the call read from standard input, and write its result to standard output."""
    sys.path[:], what, function, arguments = pickle.load(sys.stdin.buffer)
    said = Connection(os.dup(1), readable=False)
    # what a library prints is no word of ours
    os.dup2(2, 1)
    _limit_memory()
    logging.getLogger().addHandler(_Forward(said))
    last = 0.0

    def progress(done: float, total: float, subject: str) -> None:
        nonlocal last
        if (now := time.monotonic()) - last > _OFTEN:
            last = now
            said.send(("progress", (subject, done, total)))

    with asking(), shown_by(progress):
        try:
            said.send(("value", function(*arguments)))
        except ReplayKitError as error:
            said.send(("error", error))
        except MemoryError:
            words = f"{what}: the server sends more than the memory limit; reading was stopped"
            said.send(("error", ForecastError(words)))


def _limit_memory() -> None:
    """Limit the memory of a server's answers, if the system supports it."""
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:
            now = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + _MEMORY,) * 2)
