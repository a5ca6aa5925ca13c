"""How studies run: options checked, progress counted, failures kept as results while the other parts go on."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import tee
from typing import Any, TypeVar

import numpy as np

from replay_kit.core.errors import (
    ConfigError,
    EstimatorError,
    ForecastError,
    MeasurementError,
    PlanError,
)
from replay_kit.core.progress import Progress, each_call, silent

Value = TypeVar("Value")

#: A matrix that cannot be factorised, and inputs that one method or study cannot use. A wrong option (``ConfigError``) concerns the
#: whole run, and any other error is a bug: neither is kept as a result.
EXPECTED_FAILURES = (
    np.linalg.LinAlgError,
    EstimatorError,
    ForecastError,
    MeasurementError,
    PlanError,
)


def reason_of(error: Exception) -> str:
    """Return the reason of a failure as results state it: the error's class and message."""
    return f"{type(error).__name__}: {error}"


class Advance:
    """Counts steps as done and reports each to a progress function; in another process, to which it is sent, it counts nothing.

    It is mutable: calls count in it as they go, where they are made in this process.
    """

    def __init__(self, total: int = 0, progress: Progress = silent) -> None:
        """Begin with no step done.

        Args:
            total: Steps in all.
            progress: Called with steps done, steps in all, and what is being run.
        """
        self._total, self._progress, self.done = total, progress, 0

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of what is being run."""
        self.done += steps
        self._progress(self.done, self._total, what)

    def __reduce__(self) -> tuple[type["Advance"], tuple[()]]:
        return Advance, ()


def each_counted(
    function: Callable[..., Value],
    calls: Iterable[tuple[Any, ...]],
    advance: Advance,
    steps: Callable[..., int],
) -> Iterator[tuple[tuple[Any, ...], Value]]:
    """Yield each call with its value, see ``each_call``; the steps of one made in another process are counted when it is done.

    Args:
        function: As of ``each_call``; it counts its steps where it runs.
        calls: Its arguments.
        advance: Counts steps.
        steps: Number of steps of a call, of the same arguments.
    """
    done, (calls, made) = advance.done, tee(calls)
    for call, value in zip(calls, each_call(function, made), strict=True):
        done += steps(*call)
        if done > advance.done:
            advance("cases", done - advance.done)
        yield call, value


def check_names(option: str, chosen: Sequence[str], known: Collection[str]) -> None:
    """Raise ConfigError unless some known names are chosen, each once.

    Args:
        option: That they come from.
        chosen: As given.
        known: All there are.
    """
    if not chosen or not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
        raise ConfigError(
            f"{option}: expected some of {', '.join(known)}, each once, got {', '.join(chosen) or 'none'}"
        )


def check_positive(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number above 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"--{name}: expected a finite number above 0, got {value:g}")


def check_not_negative(**options: float) -> None:
    """Raise ConfigError unless every option, by its name without dashes, is a finite number of at least 0."""
    for name, value in options.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ConfigError(f"--{name}: expected a finite number of at least 0, got {value:g}")


def check_counts(pings: Sequence[int]) -> None:
    """Raise ConfigError unless the numbers of pings at which estimates are scored increase from at least 1."""
    if not pings or min(pings) < 1 or list(pings) != sorted(set(pings)):
        raise ConfigError(
            f"--pings: expected increasing numbers of at least 1, got {', '.join(map(str, pings)) or 'none'}"
        )
