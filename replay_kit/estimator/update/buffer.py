"""Rows that grow at the end, shared by immutable states."""

import numpy as np

from replay_kit.core.arrays import Array


class Buffer:
    """Rows that only grow at the end, shared by the states of a run.

    A state owns the first n rows. If the buffer holds no others, ``appended`` writes in place; otherwise another state has already
    continued from this one, and it writes to a copy. So no state ever changes, and a run of steps copies nothing.
    """

    def __init__(self, capacity: int, size: int) -> None:
        self.rows = np.zeros((capacity, size))
        self.filled = 0

    def appended(self, n: int, more: Array) -> "Buffer":
        """Return a buffer of the first n rows followed by ``more``: this buffer where possible, else a copy."""
        new = self
        if self.filled != n:
            new = Buffer(*self.rows.shape)
            new.rows[:n] = self.rows[:n]
        new.filled = n + len(more)
        new.rows[n : new.filled] = more
        return new
