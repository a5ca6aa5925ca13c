"""Progress of stages, and calls that may run on a pool of workers; the caller decides both."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from itertools import count, starmap
from typing import Any, TypeVar

#: Called with what is done, what there is in all (0 where that is not known), and the stage, which may have details behind a colon.
Progress = Callable[[float, float, str], None]


def silent(done: float, total: float, what: str) -> None:
    """Ignore progress."""


_SHOWN: ContextVar[Progress] = ContextVar("progress", default=silent)


Value = TypeVar("Value")


@contextmanager
def _set(variable: ContextVar[Value], value: Value) -> Iterator[None]:
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def shown_by(progress: Progress) -> AbstractContextManager[None]:
    """Report progress in this context to a function; results do not depend on it."""
    return _set(_SHOWN, progress)


def announce(what: str, done: float = 0, total: float = 0) -> None:
    """Report a stage to the function that shows progress, if any."""
    _SHOWN.get()(done, total, what)


def step_counter(what: str, total: float) -> Callable[[], None]:
    """Return a function that reports one more step done at each call."""
    done = count(1)
    return lambda: announce(what, next(done), total)


#: As ``itertools.starmap``: a function and rows of its arguments in, its values out, in the order of the rows.
Caller = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterator[Any]]

_CALLER: ContextVar[Caller] = ContextVar("caller", default=starmap)


def called_by(caller: Caller) -> AbstractContextManager[None]:
    """Execute the calls of ``each_call`` in this context by another function, such as a pool's; results do not depend on it."""
    return _set(_CALLER, caller)


def each_call(function: Callable[..., Value], rows: Iterable[tuple[Any, ...]]) -> Iterator[Value]:
    """Yield the values of a function for rows of arguments, in their order; each may be computed in another process.

    Args:
        function: Function without side effects that can be pickled, as its arguments.
        rows: Its arguments; one used in several rows is sent once. Without a pool rows are drawn lazily.
    """
    return _CALLER.get()(function, rows)


@dataclass(slots=True)
class Stopwatch:
    """Wall time spent in each stage.

    Mutable, as a stage adds its time also when it raises.

    Attributes:
        seconds: Wall time by stage [s].
    """

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
