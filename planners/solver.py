"""The turn of threads at the solver."""

from collections.abc import Callable
from functools import wraps
from threading import RLock
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
# IPOPT's linear solver and a program's own data are one for the whole process; a second thread in them ends it.
_TURN = RLock()


def one_at_a_time(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that builds or solves programs, of which one at a time is run in a process: other threads wait for their turn."""

    @wraps(function)
    def in_turn(*arguments: P.args, **named: P.kwargs) -> T:
        with _TURN:
            return function(*arguments, **named)

    return in_turn
