"""Progress of a study: steps done, steps in all, and what is being run."""

from collections.abc import Callable
from typing import Protocol

Progress = Callable[[int, int, str], None]


class Advance(Protocol):
    """Counts steps as done; made by ``counter``."""

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of what is being run."""
        ...


def counter(total: int, progress: Progress | None) -> Advance:
    """Return a function that counts steps and reports each to a progress function.

    Args:
        total: Steps in all.
        progress: Called with steps done, steps in all, and what is being run; None reports nothing.
    """
    done = 0

    def advance(what: str, steps: int = 1) -> None:
        nonlocal done
        done += steps
        if progress is not None:
            progress(done, total, what)

    return advance
