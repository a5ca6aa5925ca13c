"""What the nonlinear programs share: units, IPOPT's options, their turn among threads, a cache of programs."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from threading import RLock
from typing import Any, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
# IPOPT's linear solver and a program's own data are one for the whole process; a second thread in them ends it.
_TURN = RLock()
# Programs measure distances in kilometres and times in hours, so that their unknowns are of order one to a hundred.
KM, HOUR = 1e3, 3600.0
# Of a mission, for each leg and beside these: from a poor guess ten legs take 31 at most, fifty took 96; from an optimum of nearly the same
# problem, which rarely takes forty-five. What has not come to an end by then hardly ever does.
MOST_ITERATIONS = {False: (1, 50), True: (0, 60)}
# The same along a line: where the width cannot be kept, later ones still bring the track nearer.
MOST_ALONG_LINE = {False: (0, 150), True: (0, 80)}
# An evaluation that is not a number is IPOPT's to report through its return status, not CasADi's to print.
QUIET: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.nlp_scaling_method": "none",
}
OPTIONS: dict[str, Any] = {
    **QUIET,
    # kilometres and hours are to be right to metres and seconds
    "ipopt.tol": 1e-6,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_iter": 3,
    "ipopt.max_iter": 80,
    "ipopt.mu_init": 1e-2,
    "ipopt.bound_push": 1e-4,
    "ipopt.bound_frac": 1e-4,
    "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6,
}
# From an optimum of nearly the same problem a large barrier only leads away and back.
WARM: dict[str, Any] = {"ipopt.mu_init": 1e-6, "ipopt.bound_push": 1e-8, "ipopt.bound_frac": 1e-8}


def one_at_a_time(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that builds or solves programs, of which one at a time is run in a process: other threads wait for their turn."""

    @wraps(function)
    def in_turn(*arguments: P.args, **named: P.kwargs) -> T:
        with _TURN:
            return function(*arguments, **named)

    return in_turn


class Recent(Generic[T]):
    """The values used most recently, by key: programs and splines are worth keeping while estimates share their nodes.

    ``functools.lru_cache`` would keep the arguments as well, whole estimates with all their modes.
    """

    def __init__(self, most: int) -> None:
        """Keep so many values at most."""
        self._most, self._values = most, OrderedDict[Hashable, T]()

    @one_at_a_time
    def get(self, key: Hashable, build: Callable[[], T]) -> T:
        """Return the value of a key; it is built when there is none."""
        if key not in self._values:
            self._values[key] = build()
            if len(self._values) > self._most:
                self._values.popitem(last=False)
        self._values.move_to_end(key)
        return self._values[key]

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()
