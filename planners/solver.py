"""What the nonlinear programs share: units, IPOPT's options, solvers that share one program's derivatives, a cache of programs."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import casadi as ca

from replay_kit.core.arrays import Array

T = TypeVar("T")
# Programs measure distances in kilometres and times in hours, so that their unknowns are of order one to a hundred.
KM, HOUR = 1e3, 3600.0
MOST_ITERATIONS = 80
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
    "ipopt.max_iter": MOST_ITERATIONS,
    "ipopt.mu_init": 1e-2,
    "ipopt.bound_push": 1e-4,
    "ipopt.bound_frac": 1e-4,
    "ipopt.slack_bound_push": 1e-6,
    "ipopt.slack_bound_frac": 1e-6,
}
# From an optimum of nearly the same problem a large barrier only leads away and back.
_WARM: dict[str, Any] = {"ipopt.mu_init": 1e-6, "ipopt.bound_push": 1e-8, "ipopt.bound_frac": 1e-8}


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A nonlinear program.

    Attributes:
        solver: Its solver with ``OPTIONS``.
        lower: Lower bounds of its constraints.
        upper: Upper bounds.
        problem: Its expressions, for further solvers.
        further: Further solvers made so far, by warm start and iteration limit.
    """

    solver: Any
    lower: Array
    upper: Array
    problem: dict[str, Any]
    further: dict[tuple[bool, int], Any] = field(default_factory=dict)

    def solver_for(self, warm_start: bool, max_iterations: int) -> Any:
        """Return the solver for a guess that is nearly optimal (``warm_start``) or not; all solvers share their derivatives."""
        key = warm_start, max_iterations
        if key == (False, MOST_ITERATIONS):
            return self.solver
        if key not in self.further:
            same = {name: self.solver.get_function(f"nlp_{name}") for name in ("jac_g", "grad_f")}
            same["hess_lag"] = self.solver.get_function("nlp_hess_l")
            options = {**OPTIONS, **(_WARM if warm_start else {}), "ipopt.max_iter": max_iterations, **same}
            self.further[key] = ca.nlpsol("further", "ipopt", self.problem, options)
        return self.further[key]


class Recent(Generic[T]):
    """The values used most recently, by key: programs and splines are worth keeping while estimates share their nodes.

    ``functools.lru_cache`` would keep the arguments as well, whole estimates with all their modes.
    """

    def __init__(self, most: int) -> None:
        """Keep so many values at most."""
        self._most, self._values = most, OrderedDict[Hashable, T]()

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
