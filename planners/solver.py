"""IPOPT as the planners of paths ask it: its settings, and the solvers that share one program's derivatives."""

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from replay_kit.core.arrays import Array

# Programs measure distances in kilometres and times in hours, so that their unknowns are of order one to a hundred.
KM, HOUR = 1e3, 3600.0
MOST_ITERATIONS = 80
OPTIONS: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    # metres and seconds are wanted of kilometres and hours
    "ipopt.tol": 1e-6,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_iter": 3,
    "ipopt.max_iter": MOST_ITERATIONS,
    "ipopt.nlp_scaling_method": "none",
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
        solver: Made of it with ``OPTIONS``.
        lower: Lower bounds of its constraints.
        upper: Upper bounds.
        problem: Its expressions, for further solvers.
        further: The further solvers made so far.
    """

    solver: Any
    lower: Array
    upper: Array
    problem: dict[str, Any]
    further: dict[tuple[bool, int], Any] = field(default_factory=dict)

    def solver_for(self, nearly_optimal: bool, most: int) -> Any:
        """Return the solver for guesses that are nearly optimal or not, with so many iterations at most; all share their derivatives."""
        key = nearly_optimal, most
        if key == (False, MOST_ITERATIONS):
            return self.solver
        if key not in self.further:
            same = {name: self.solver.get_function(f"nlp_{name}") for name in ("jac_g", "grad_f")}
            same["hess_lag"] = self.solver.get_function("nlp_hess_l")
            options = {**OPTIONS, **(_WARM if nearly_optimal else {}), "ipopt.max_iter": most, **same}
            self.further[key] = ca.nlpsol("further", "ipopt", self.problem, options)
        return self.further[key]
