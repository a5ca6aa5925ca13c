"""How a study runs: its steps counted and reported, and the failures that one part may end with while the others go on."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from replay_kit.core.errors import EstimatorError, ForecastError, MeasurementError, PlanError

Progress = Callable[[int, int, str], None]

#: A matrix that cannot be factorised, and inputs that one method or study cannot use. A wrong option (``ConfigError``) concerns the
#: whole run, and any other error is a bug: neither is kept as a result.
EXPECTED_FAILURES = (np.linalg.LinAlgError, EstimatorError, ForecastError, MeasurementError, PlanError)


def reason_of(error: Exception) -> str:
    """Return the reason of a failure as results state it: the error's class and message."""
    return f"{type(error).__name__}: {error}"


class Advance(Protocol):
    """Counts steps as done; made by ``counter``."""

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of what is being run."""
        ...


def counter(total: int, progress: Progress | None) -> Advance:
    """Return a function that counts steps and reports each to a progress function.

    Args:
        total: Steps in all.
        progress: Called with steps done, steps in all, and what is being run; None reports nothing.
    """
    done = 0

    def advance(what: str, steps: int = 1) -> None:
        nonlocal done
        done += steps
        if progress is not None:
            progress(done, total, what)

    return advance
