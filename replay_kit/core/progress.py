"""Progress callbacks, explicit or ambient."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

#: Called with what is done, what there is in all (0 where that is not known), and the stage, which may have details behind a colon.
Progress = Callable[[float, float, str], None]


def silent(done: float, total: float, what: str) -> None:
    """Report nothing."""


_SHOWN: ContextVar[Progress] = ContextVar("progress", default=silent)


@contextmanager
def shown_by(progress: Progress) -> Iterator[None]:
    """Show what is announced in this context by a function; results never depend on it."""
    token = _SHOWN.set(progress)
    try:
        yield
    finally:
        _SHOWN.reset(token)


def announce(what: str, done: float = 0, total: float = 0) -> None:
    """Report a stage to the function that shows progress; without one nothing happens."""
    _SHOWN.get()(done, total, what)


def counted(what: str, total: float) -> Callable[[], None]:
    """Return a function that is called after each of some steps and announces how many are done."""
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        announce(what, done, total)

    return advance
