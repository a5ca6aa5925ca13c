"""Rows that grow, shared by states that never change."""

import numpy as np

from replay_kit.core.arrays import Array


class Buffer:
    """Rows that only ever grow at the end, shared by the states of a run.

    A state owns the first n rows. It appends in place when there are no others; else another state went on from it before, and it goes
    on with a copy. So no state ever changes, and a run of steps copies nothing.
    """

    def __init__(self, capacity: int, size: int) -> None:
        self.rows = np.zeros((capacity, size))
        self.filled = 0

    def appended(self, n: int, more: Array) -> "Buffer":
        """Return a buffer of the first n rows and more ones: this one, if it can be."""
        new = self
        if self.filled != n:
            new = Buffer(*self.rows.shape)
            new.rows[:n] = self.rows[:n]
        new.filled = n + len(more)
        new.rows[n : new.filled] = more
        return new
