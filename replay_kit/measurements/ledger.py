"""Whether each message of a block was used, and why not; and the numbers of topics."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.table import Integers

_LEFT_OUT, _BY = "left out: ", " (measurements.without)"


def left_out_reason(rules: Sequence[str]) -> str:
    """Return the reason of a message whose measurement rules of the settings leave out."""
    return f"{_LEFT_OUT}{', '.join(rules)}{_BY}"


def left_out_rules(reason: str) -> Sequence[str]:
    """Return the rules of the settings that a reason names; none where it is another."""
    if not reason.startswith(_LEFT_OUT):
        return []
    return reason.removeprefix(_LEFT_OUT).removesuffix(_BY).split(", ")


class Ledger:
    """The outcomes of the messages of a block."""

    def __init__(self, topics: Sequence[str]) -> None:
        """Begin without any.

        Args:
            topics: Names known so far.
        """
        self._topics = {name: number for number, name in enumerate(topics)}
        self._reasons: dict[str, int] = {}
        self._rows: list[Integers] = []

    @property
    def topics(self) -> tuple[str, ...]:
        """Names by number."""
        return tuple(self._topics)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons by number."""
        return tuple(self._reasons)

    def topic(self, name: str) -> int:
        """Return the number of a topic, which is new or known."""
        return self._topics.setdefault(name, len(self._topics))

    def add(self, due: Integers, topic: str, reasons: str | NDArray[np.object_] = "") -> None:
        """Note messages of a topic.

        Args:
            due: shape (n,), place in the stream at which the use of each was decided.
            topic: Theirs.
            reasons: Why they are not used, one for all or for each; empty for those that are.
        """
        words = np.broadcast_to(np.asarray(reasons, object), due.shape)
        for reason in dict.fromkeys(words):
            at = due[words == reason]
            code = self._reasons.setdefault(reason, len(self._reasons)) if reason else -1
            row = self.topic(topic), code
            self._rows.append(np.column_stack([at, np.full((at.size, 2), row, np.int64)]))

    def outcomes(self) -> Integers:
        """Return the outcomes in order, as in ``Block``."""
        rows = np.concatenate([np.empty((0, 3), np.int64), *self._rows])
        return rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
