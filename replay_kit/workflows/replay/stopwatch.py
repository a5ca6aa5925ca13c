"""Wall time spent in each stage of a run."""

import time
from dataclasses import dataclass, field


@dataclass(slots=True)
class Stopwatch:
    """Wall time spent in each stage.

    It is mutable, because a stage adds its time also when it raises; no result depends on it.

    Attributes:
        seconds: By stage.
    """

    seconds: dict[str, float] = field(default_factory=dict)

    def stage(self, name: str) -> "_Stage":
        """Add the time that a block takes to a stage."""
        return _Stage(self.seconds, name)


class _Stage:
    """A block of a stage; a generator would take longer than many a block."""

    __slots__ = ("_began", "_name", "_seconds")

    def __init__(self, seconds: dict[str, float], name: str) -> None:
        self._seconds, self._name, self._began = seconds, name, 0.0

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._name] = (
            self._seconds.get(self._name, 0.0) + time.perf_counter() - self._began
        )
