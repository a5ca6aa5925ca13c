"""Studies run: the command of one, and the last of the results that it yields as they come."""

from collections.abc import Iterable
from typing import TypeVar

from tests.command import Outcome, invoke

Result = TypeVar("Result")


def experiment(words: str) -> Outcome:
    """Run ``replay-kit experiment`` with words between spaces."""
    return invoke(["experiment", *words.split()])


def final(results: Iterable[Result]) -> Result:
    """Return the last result of a study."""
    *_, last = results
    return last
