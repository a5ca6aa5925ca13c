"""The admission stage: what of a block that was checked the estimate is given, what it is not, and what is remembered of both."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import replace
from replay_kit.core.block import LINEAR, MEAN, PING, POSITION, Block
from replay_kit.core.observation import Measurement, PathMean
from replay_kit.core.table import Integers
from replay_kit.measurements.observed import path_mean
from replay_kit.workflows.replay.events import Aside, Events
from replay_kit.workflows.replay.stages.consistency import MonitoringState, tracked
from replay_kit.workflows.replay.statistics import RunStatistics
from replay_kit.workflows.replay.surfacings.flight_bias import FlightState, corrected, with_block


@dataclass(frozen=True, slots=True, eq=False)
class Admission:
    """What is remembered of a vehicle's events.

    Attributes:
        monitoring: Of the consistency checks.
        flight: Of the flight model's error.
        statistics: What was counted.
    """

    monitoring: MonitoringState
    flight: FlightState
    statistics: RunStatistics


def admitted(
    state: Admission,
    block: Block,
    rows: Integers,
    config: RunConfig,
    kinds: tuple[type[Measurement], ...],
) -> tuple[Admission, Events]:
    """Return what is remembered after some events of a block, and the events as the estimate is given them.

    A mean current that it is not given goes past it: surfacings are still expected from it.

    Args:
        state: Before them.
        block: What messages measured, after its checks.
        rows: shape (n, 3), of ``block.events``.
        config: The run's settings.
        kinds: Measurements that the estimator takes.
    """
    monitoring, flight, statistics = state.monitoring, state.flight, state.statistics
    if config.consistency.on_failure != "ignore":
        monitoring = tracked(monitoring, block, rows)
    bias, kind, others, before = config.measurements.flight_bias, rows[:, 1], list[Any](), 0
    is_ping, unused = kind == PING, np.zeros(len(rows), np.bool_)
    for k in np.flatnonzero((kind == MEAN) | (kind == LINEAR)).tolist():
        row = int(rows[k, 2])
        event: Any = path_mean(block, row) if kind[k] == MEAN else block.linear[row]
        is_mean = isinstance(event, PathMean)
        if is_mean:
            if bias:
                flight = with_block(flight, block, rows[before:k][is_ping[before:k], 2])
                (flight, event), before = corrected(flight, event), k
            monitoring = replace(monitoring, means=(*monitoring.means, event))
        # profiles beside a mean current were computed from it
        beside = is_mean and event.beside_profiles
        fits = isinstance(event, kinds) and (bias or not beside)
        if not (fits or beside or monitoring.left_out):
            statistics = statistics.with_unsupported(event)
        if fits and not monitoring.left_out:
            others.append(event)
        elif is_mean:
            others.append(Aside(event))
        else:
            unused[k] = True
    if bias:
        flight = with_block(flight, block, rows[before:][is_ping[before:], 2])
    if monitoring.left_out:
        statistics = statistics.with_rejected(int(np.count_nonzero(kind != POSITION)))
        unused |= is_ping
    events = Events.of(replace(block, events=rows[~unused]), others)
    return Admission(monitoring, flight, statistics), events
