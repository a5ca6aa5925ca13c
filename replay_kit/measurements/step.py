"""Inputs of the measurement of a block: positions, depths, clock and settings, also by the region; and the outcome of each message."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import LinearMeasurement, Source
from replay_kit.core.observation.table import Columns, Integers, Rows, Table, chosen_rows
from replay_kit.measurements.track.dives import no_depths
from replay_kit.measurements.track.positions import as_of, no_rows
from replay_kit.measurements.track.reach import Reach

_LEFT_OUT, _BY = "left out: ", " (measurements.without)"
#: Place in the stream, and the measurement that its message completes.
Found = list[tuple[int, LinearMeasurement]]


def left_out_reason(rules: Sequence[str]) -> str:
    """Return the reason of a message withheld by rules of the settings."""
    return f"{_LEFT_OUT}{', '.join(rules)}{_BY}"


def left_out_rules(reason: str) -> Sequence[str]:
    """Return the rules of the settings in a reason; empty for other reasons."""
    if not reason.startswith(_LEFT_OUT):
        return []
    return reason.removeprefix(_LEFT_OUT).removesuffix(_BY).split(", ")


class Step(NamedTuple):
    """Block of messages with its settings and vehicle state.

    Attributes:
        config: Settings of the measurements.
        clock: Positions in the stream and times [ns, UTC] of all messages.
        last: Whether the log ends with them.
        topics: Numbers of topics, by name.
        reasons: Numbers of the reasons for exclusion, by text.
        noted: Outcomes so far, as in ``Block``.
        positions: Positions of the block and of 40 s before.
        new: Index of the first of the block.
        depths: Depths of the vehicle.
        reach: Reach of the vehicle.
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
        """Return the vehicle's depth and dive after messages at positions in the stream, as columns of ``dives.depths_of``."""
        return chosen_rows(self.depths, as_of(order, self.depths["order"]))

    def messages(self, tables: Sequence[Table]) -> list[tuple[Table, Source]]:
        """Return the single rows of tables in order, with their messages."""
        rows = [message.rows(slice(k, k + 1)) for message in tables for k in range(len(message))]
        rows.sort(key=lambda message: int(message.order[0]))
        return [
            (
                message,
                Source(
                    message.input, message.topic, int(message.position[0]), int(message.time[0])
                ),
            )
            for message in rows
        ]

    def topic(self, name: str) -> int:
        """Return the number of a topic, registered if new."""
        return self.topics.setdefault(name, len(self.topics))

    def add(self, due: Integers, topic: Integers | int, why: Any = "") -> None:
        """Note the outcomes of messages.

        Args:
            due: shape (n,), position in the stream of each decision.
            topic: Number of the topic, common or for each.
            why: Reason for exclusion, common or for each; empty if used.
        """
        words, codes = np.full(len(due), why, object), np.full(len(due), -1)
        for reason in dict.fromkeys(filter(None, words)):
            codes[words == reason] = self.reasons.setdefault(reason, len(self.reasons))
        self.noted.append(np.column_stack(np.broadcast_arrays(due, topic, codes)))

    def note(self, table: Table, why: Any = "", due: Integers | None = None) -> None:
        """Note the outcomes of a table's messages, at their own position or ``due``; pings of several messages count as often."""
        times = table.columns.get("messages", 1)
        words = np.repeat(np.full(len(table), why, object), times)
        self.add(
            np.repeat(table.order if due is None else due, times), self.topic(table.topic), words
        )

    def kept(self, table: Table, why: Any) -> Table:
        """Note the excluded messages of a table, and return the others."""
        why = np.full(len(table), why, object)
        good = why == ""
        if good.all():
            return table
        self.note(table.rows(~good), why[~good])
        return table.rows(good)

    def left_out(self, kind: str, dive: int) -> str:
        """Return why the settings withhold a measurement of a kind and dive; empty if they do not."""
        rules = rules_for(self.config.without, kind, dive)
        return left_out_reason(rules) if rules else ""

    def outcomes(self) -> Integers:
        """Return the outcomes in order, as in ``Block``."""
        rows = np.concatenate([np.empty((0, 3), np.int64), *self.noted])
        return rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]


_MEMBERS, _COLUMNS = 4, 500


def for_region(config: RunConfig, ensemble: Ensemble) -> RunConfig:
    """Return the settings of a run completed by its ensemble: speed of the currents, extent and resolution."""
    measurements, grid = config.measurements, ensemble.grid
    # some columns of some members tell as much as all of them, and a region without a CTD is not read for it
    every = 1 + math.isqrt(grid.east.size // _COLUMNS)
    squares = np.square(ensemble.velocity[:_MEMBERS, ..., ::every, ::every]).sum(axis=1)
    speed = float(np.sqrt(np.mean(squares, where=np.isfinite(squares))))
    steps = [grid.steps(axis) for axis in (0, 1)]
    longitude = unwrap_longitude(grid.longitude, grid.projection.longitude)
    found = {
        "regional_speed": speed or None,
        "surface_spacing": max(
            (2.0 * float(np.median(step)) for step in steps if step.size), default=None
        ),
        "surface_box": tuple(
            float(end(each)) for end in (np.min, np.max) for each in (longitude, grid.latitude)
        ),
    }
    lacks = {name: value for name, value in found.items() if getattr(measurements, name) is None}
    return config.model_copy(update={"measurements": measurements.model_copy(update=lacks)})
