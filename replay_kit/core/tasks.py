"""How independent calls of a function are made: one after the other here, or by whoever has been given them, such as processes."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

Value = TypeVar("Value")

#: As the builtin ``map``: a function and columns of its arguments in, its values out, in their order.
Calls = Callable[..., Iterator[Any]]

_MADE: ContextVar[Calls] = ContextVar("tasks", default=map)


@contextmanager
def made_by(calls: Calls) -> Iterator[None]:
    """Let a function make the calls of ``each_of`` in this context; results never depend on it."""
    token = _MADE.set(calls)
    try:
        yield
    finally:
        _MADE.reset(token)


def each_of(function: Callable[..., Value], *columns: Iterable[Any]) -> Iterator[Value]:
    """Yield the values of a function for rows of arguments, in their order; each may be computed in another process.

    Args:
        function: Of a module, without side effects; it and its arguments can be pickled.
        columns: Its arguments, as for the builtin ``map``; an argument that stands in several rows is sent once.
    """
    return _MADE.get()(function, *columns)
