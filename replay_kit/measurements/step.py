"""What a block of messages is measured by: its positions, depths, clock and settings; and whether each message was used, or why not."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import LinearMeasurement, Source
from replay_kit.core.table import Columns, Integers, Rows, Table, chosen
from replay_kit.measurements.dives import no_depths
from replay_kit.measurements.positions import as_of, no_rows
from replay_kit.measurements.reach import Reach

_LEFT_OUT, _BY = "left out: ", " (measurements.without)"
#: Place in the stream, and the measurement that its message completes.
Found = list[tuple[int, LinearMeasurement]]


def left_out_reason(rules: Sequence[str]) -> str:
    """Return the reason of a message whose measurement rules of the settings leave out."""
    return f"{_LEFT_OUT}{', '.join(rules)}{_BY}"


def left_out_rules(reason: str) -> Sequence[str]:
    """Return the rules of the settings that a reason names; none where it is another."""
    if not reason.startswith(_LEFT_OUT):
        return []
    return reason.removeprefix(_LEFT_OUT).removesuffix(_BY).split(", ")


class Step(NamedTuple):
    """A block of messages.

    Attributes:
        config: How messages become measurements.
        clock: Places in the stream and times [ns, UTC] of all messages.
        last: Whether the log ends with them.
        topics: Numbers of topics, by name.
        reasons: Numbers of the reasons for which messages are not used, in words.
        noted: Outcomes so far, as in ``Block``.
        positions: Those of the last 40 s before, and those of the block.
        new: Number of the first of the block.
        depths: The vehicle's.
        reach: What its positions say of those that it can reach.
    """

    config: MeasurementConfig
    clock: tuple[Integers, Integers]
    last: bool
    topics: dict[str, int]
    reasons: dict[str, int]
    noted: list[Integers]
    positions: Columns = no_rows()
    new: int = 0
    depths: Columns = no_depths()
    reach: Reach = Reach()

    def dived(self, order: Integers) -> Rows:
        """Return the vehicle's depth and dive after messages at places in the stream, columns as of ``dives.depths_of``."""
        return chosen(self.depths, as_of(order, self.depths["order"]))

    def messages(self, tables: Sequence[Table]) -> list[tuple[Table, Source]]:
        """Return the rows of tables one by one, in order, with their messages."""
        rows = [one.rows(slice(k, k + 1)) for one in tables for k in range(len(one))]
        rows.sort(key=lambda one: int(one.order[0]))
        return [
            (one, Source(one.input, one.topic, int(one.position[0]), int(one.time[0])))
            for one in rows
        ]

    def topic(self, name: str) -> int:
        """Return the number of a topic, which is new or known."""
        return self.topics.setdefault(name, len(self.topics))

    def add(self, due: Integers, topic: Integers | int, why: Any = "") -> None:
        """Note messages.

        Args:
            due: shape (n,), place in the stream at which the use of each was decided.
            topic: Number of its topic, one for all or for each.
            why: Why it is not used, one for all or for each; empty for those that are.
        """
        words, codes = np.full(len(due), why, object), np.full(len(due), -1)
        for reason in {*words} - {""}:
            codes[words == reason] = self.reasons.setdefault(reason, len(self.reasons))
        self.noted.append(np.column_stack(np.broadcast_arrays(due, topic, codes)))

    def note(self, table: Table, why: Any = "", due: Integers | None = None) -> None:
        """Note the messages of a table, each where it comes unless ``due`` says another place; the pings of several as often."""
        times = table.columns.get("messages", 1)
        words = np.repeat(np.full(len(table), why, object), times)
        due = np.repeat(table.order if due is None else due, times)
        self.add(due, self.topic(table.topic), words)

    def kept(self, table: Table, why: Any) -> Table:
        """Note the messages of a table that are not used, and return the others."""
        why = np.full(len(table), why, object)
        good = why == ""
        if good.all():
            return table
        self.note(table.rows(~good), why[~good])
        return table.rows(good)

    def left_out(self, kind: str, dive: int) -> str:
        """Return why the settings leave out a measurement of a kind and dive; empty where they do not."""
        rules = rules_for(self.config.without, kind, dive)
        return left_out_reason(rules) if rules else ""

    def outcomes(self) -> Integers:
        """Return the outcomes in order, as in ``Block``."""
        rows = np.concatenate([np.empty((0, 3), np.int64), *self.noted])
        return rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
