"""What a study results in, of the results that it yields as they come."""

from collections.abc import Iterable
from typing import TypeVar

Result = TypeVar("Result")


def final(results: Iterable[Result]) -> Result:
    """Return the last result of a study."""
    *_, last = results
    return last
