"""What many tests would compute again: the fits of a prior, half of a small replay's set-up, and the options of a command."""

import copy
import functools
from collections.abc import Callable, Sequence
from typing import Any

from cyclopts import App
from cyclopts.argument import Argument, ArgumentCollection

from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.prior import fit
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

_assemble = App.assemble_argument_collection
_options: dict[tuple[object, ...], ArgumentCollection] = {}


def assemble_argument_collection(app: App, **settings: Any) -> ArgumentCollection:
    """Return the options of a command, without a value, as cyclopts finds them: a process asks once, a test file a hundred times."""
    key = app.default_command, repr(app.app_stack.default_parameter), repr(settings)
    if key not in _options:
        _options[key] = _assemble(app, **settings)
    return _without_values(_options[key], {})


def _without_values(
    arguments: ArgumentCollection, copies: dict[int, Argument]
) -> ArgumentCollection:
    for argument in arguments:
        if id(argument) not in copies:
            copies[id(argument)] = copied = copy.copy(argument)
            copied.tokens = []
            copied.children = _without_values(argument.children, copies)
    return ArgumentCollection(copies[id(argument)] for argument in arguments)
