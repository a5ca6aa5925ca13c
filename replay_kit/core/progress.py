"""How work reports its progress."""

from collections.abc import Callable

#: Called with what is done, what there is in all (0 where that is not known), and the stage, which may have details behind a colon.
Progress = Callable[[float, float, str], None]


def silent(done: float, total: float, what: str) -> None:
    """Report nothing."""
