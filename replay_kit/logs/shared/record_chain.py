"""Records that lie end to end in a log: which of the candidates are records, and which bytes between them are lost."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.logs.shared.statistics import ReadStatistics

Indices = NDArray[np.signedinteger[Any]]


def chain(start: Indices, end: Indices) -> Indices:
    """Return which candidates are records when each search begins at the end of the record before, shape (m,), increasing.

    A candidate that begins inside a record is none: its first bytes are the record's contents.

    Args:
        start: Where each candidate begins, shape (n,), increasing.
        end: Where each ends, shape (n,), greater than its start.
    """
    keep = np.ones(start.size, dtype=np.bool_)
    overlapped = np.flatnonzero(start[1:] < end[:-1])
    after = np.searchsorted(start, end[overlapped])
    for record, following in zip(overlapped.tolist(), after.tolist(), strict=True):
        if keep[record]:
            keep[record + 1 : following] = False
    return np.flatnonzero(keep)


def lose_gaps(
    statistics: ReadStatistics, what: str, before: int, start: Indices, end: Indices
) -> int:
    """Record the bytes between records as losses and return where the last record ends [bytes].

    Args:
        statistics: Where the losses are recorded.
        what: Description of such a loss.
        before: Where the record before the first one ends in the file.
        start: Where each record begins in the file, shape (n,), increasing.
        end: Where each ends, shape (n,).
    """
    ends = np.concatenate([[before], end])
    for gap in np.flatnonzero(start > ends[:-1]).tolist():
        statistics.lose(what, int(ends[gap]), int(start[gap] - ends[gap]))
    return int(ends[-1])
