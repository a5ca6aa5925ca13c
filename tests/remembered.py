"""The fits of a prior, half of a small replay's set-up: many tests replay over the same ensemble, to which each is fitted once."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior import centre, fit
from replay_kit.estimator.prior.fit import Members


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of members and settings that computes what it returns once for the same arguments."""
    found: dict[tuple[object, ...], Any] = {}

    @functools.wraps(function)
    def once(members: Members, *args: Any) -> Any:
        arrays = members.weights, members.velocity_modes, members.nodes
        # shifted modes are those of the members by the settings
        rest = (arg for arg in args if not isinstance(arg, ShiftedModes))
        key = (
            *(array.tobytes() for array in arrays),
            members.weights.shape,
            *(tuple(arg) if isinstance(arg, Sequence) else arg for arg in rest),
        )
        if key not in found:
            found[key] = function(members, *args)
        return found[key]

    # a recording of which test executes which line empties every cache before each test
    once.cache_clear = found.clear  # type: ignore[attr-defined]
    return once


score_member = remembered(fit._score_member)
fitted_kernels = remembered(centre.fitted_kernels)
