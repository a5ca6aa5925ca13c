"""How a study runs: its steps counted and reported, and the failures that one part may end with while the others go on."""

from collections.abc import Callable

import numpy as np

from replay_kit.core.errors import EstimatorError, ForecastError, MeasurementError, PlanError

Progress = Callable[[int, int, str], None]

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

    It is mutable: calls of ``each_call`` count in it as they go, where they are made in this process.
    """

    def __init__(self, total: int = 0, progress: Progress | None = None) -> None:
        """Begin with no step done.

        Args:
            total: Steps in all.
            progress: Called with steps done, steps in all, and what is being run; None reports nothing.
        """
        self._total, self._progress, self.done = total, progress, 0

    def __call__(self, what: str, steps: int = 1) -> None:
        """Count steps of what is being run."""
        self.done += steps
        if self._progress is not None:
            self._progress(self.done, self._total, what)

    def reach(self, done: int, what: str) -> None:
        """Count what a call has done that was made elsewhere: as many steps as are missing to a number of them."""
        if done > self.done:
            self(what, done - self.done)

    def __reduce__(self) -> tuple[type["Advance"], tuple[()]]:
        return Advance, ()
