"""Records that lie end to end in a log, chosen among the places where one seems to begin."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.signedinteger[Any]]


def chain(start: Indices, end: Indices) -> Indices:
    """Return which records are met when each search begins at the end of the record before, shape (m,), increasing.

    A record that begins inside one that was met is no record: its first bytes are the other's contents.

    Args:
        start: Where each possible record begins, shape (n,), increasing.
        end: Where each ends, shape (n,), greater than its start.
    """
    keep = np.ones(start.size, dtype=np.bool_)
    overlapped = np.flatnonzero(start[1:] < end[:-1])
    after = np.searchsorted(start, end[overlapped])
    for record, following in zip(overlapped.tolist(), after.tolist(), strict=True):
        if keep[record]:
            keep[record + 1 : following] = False
    return np.flatnonzero(keep)
