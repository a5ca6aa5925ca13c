"""Independent calls of a function: one after the other, or on a pool of workers."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import starmap
from typing import Any, TypeVar

Value = TypeVar("Value")

#: As ``itertools.starmap``: a function and rows of its arguments in, its values out, in the order of the rows.
Caller = Callable[[Callable[..., Any], Iterable[tuple[Any, ...]]], Iterator[Any]]

_CALLER: ContextVar[Caller] = ContextVar("caller", default=starmap)


@contextmanager
def called_by(caller: Caller) -> Iterator[None]:
    """Make the calls of ``each_call`` in this context by another function, such as a pool's; results never depend on it."""
    token = _CALLER.set(caller)
    try:
        yield
    finally:
        _CALLER.reset(token)


def each_call(function: Callable[..., Value], rows: Iterable[tuple[Any, ...]]) -> Iterator[Value]:
    """Yield the values of a function for rows of arguments, in their order; each may be computed in another process.

    Args:
        function: Without side effects; it and its arguments can be pickled.
        rows: Its arguments; one that stands in several rows is sent once. Here each row is asked for after the call before it.
    """
    return _CALLER.get()(function, rows)
