"""IPOPT's functions, computed with NumPy for all legs at once instead of by a graph."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from planners.shooting.functions import MissionFunctions
from planners.solver import MOST_ITERATIONS, OPTIONS, WARM
from replay_kit.core.arrays import Array


class _Callback(ca.Callback):
    """A CasADi function that calls one of NumPy's arrays."""

    def __init__(
        self,
        name: str,
        given: Sequence[Any],
        found: Sequence[Any],
        evaluate: Callable[..., Sequence[Array | float]],
    ) -> None:
        """Take the sparsities of what is given and found, and the function between their entries."""
        ca.Callback.__init__(self)
        self._given, self._found, self._evaluate = given, found, evaluate
        self.construct(name, {})

    def get_n_in(self) -> int:
        """Return the number of what is given."""
        return len(self._given)

    def get_n_out(self) -> int:
        """Return the number of what is found."""
        return len(self._found)

    def get_sparsity_in(self, index: int) -> Any:
        """Return the sparsity of what is given."""
        return self._given[index]

    def get_sparsity_out(self, index: int) -> Any:
        """Return the sparsity of what is found."""
        return self._found[index]

    def has_eval_buffer(self) -> bool:
        """Return that entries are passed where they lie in memory."""
        return True

    def eval_buffer(self, given: Sequence[Any], found: Sequence[Any]) -> int:
        """Evaluate the function."""
        values = [
            np.frombuffer(one) if size.nnz() else np.zeros(0)
            for one, size in zip(given, self._given, strict=True)
        ]
        for out, value in zip(found, self._evaluate(*values), strict=True):
            if out is not None:
                np.frombuffer(out)[:] = value
        return 0


class Program:
    """A mission's program of one layout, with its solvers."""

    def __init__(self, functions: MissionFunctions) -> None:
        """Make the callbacks of some functions."""
        self.functions, layout = functions, functions.layout
        self.lower = np.concatenate([np.zeros(layout.n_equal), np.full(layout.n_limited, -np.inf)])
        self.upper = np.zeros(layout.n_equal + layout.n_limited)
        unknowns, one, none = (
            ca.Sparsity.dense(layout.n_unknowns, 1),
            ca.Sparsity.dense(1, 1),
            ca.Sparsity(0, 0),
        )
        limits = ca.Sparsity.dense(self.upper.size, 1)
        value, jacobian, hessian = (
            functions.value,
            functions.jacobian_entries,
            functions.hessian_entries,
        )
        # held: CasADi does not keep them
        self._value = _Callback("mission", [unknowns], [one, limits], value)
        self._derivatives = {
            "grad_f": _Callback(
                "grad_f",
                [unknowns, none],
                [one, unknowns],
                lambda x, _: (value(x)[0], functions.gradient(x)),
            ),
            "jac_g": _Callback(
                "jac_g",
                [unknowns, none],
                [limits, functions.jacobian.sparsity],
                lambda x, _: (value(x)[1], jacobian(x)),
            ),
            "hess_lag": _Callback(
                "hess_lag",
                [unknowns, none, one, limits],
                [functions.hessian.sparsity],
                lambda x, _, f, g: (hessian(x, float(f[0]), g),),
            ),
        }
        self._solvers: dict[bool, Any] = {}

    def solver(self, warm_start: bool = False) -> Any:
        """Return the solver for a guess that is nearly optimal (``warm_start``) or not; all share the same functions."""
        if warm_start not in self._solvers:
            x = ca.MX.sym("x", self.functions.layout.n_unknowns)
            cost, constraints = self._value(x)
            options = {
                **OPTIONS,
                **(WARM if warm_start else {}),
                "ipopt.max_iter": MOST_ITERATIONS,
                "no_nlp_grad": True,
                **self._derivatives,
            }
            self._solvers[warm_start] = ca.nlpsol(
                "mission", "ipopt", {"x": x, "f": cost, "g": constraints}, options
            )
        return self._solvers[warm_start]
