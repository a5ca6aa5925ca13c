"""Admission stage: selection of the checked events to assimilate, and memory of all."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import replace
from replay_kit.core.observation import PathMean, kind_of
from replay_kit.core.observation.block import LINEAR, MEAN, PING, POSITION, Block
from replay_kit.core.observation.table import Integers
from replay_kit.measurements.observed import path_mean
from replay_kit.workflows.replay.events import Aside, Events
from replay_kit.workflows.replay.stages.consistency import tracked
from replay_kit.workflows.replay.stages.counts import added
from replay_kit.workflows.replay.stages.estimation import inputs_of
from replay_kit.workflows.replay.state import OfVehicle, Setup
from replay_kit.workflows.replay.surfacings.flight_bias import corrected, with_block


def admitted(of: OfVehicle, setup: Setup, block: Block, rows: Integers) -> OfVehicle:
    """Return a vehicle's states with events of a block waiting for assimilation.

    DACs that are not assimilated still serve to predict surfacings.

    Args:
        of: States before.
        setup: Setup of the vehicle.
        block: Checked block.
        rows: shape (n, 3), rows of ``block.events``.
    """
    config, kinds = setup.config, inputs_of(setup.estimator)
    monitoring, flight, unsupported, rejected = of.monitoring, of.flight, list[tuple[str, int]](), 0
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
            unsupported.append((kind_of(event), 1))
        if fits and not monitoring.left_out:
            others.append(event)
        elif is_mean:
            others.append(Aside(event))
        else:
            unused[k] = True
    if bias:
        flight = with_block(flight, block, rows[before:][is_ping[before:], 2])
    if monitoring.left_out:
        rejected = int(np.count_nonzero(kind != POSITION))
        unused |= is_ping
    events = Events.of(replace(block, events=rows[~unused]), others)
    counts = replace(
        of.counts,
        unsupported=added(of.counts.unsupported, unsupported),
        rejected=of.counts.rejected + rejected,
    )
    waiting = of.waiting.followed_by(events, of.due_ns)
    first = [int(events.time.min())] if len(events) else []
    return replace(
        of,
        monitoring=monitoring,
        flight=flight,
        counts=counts,
        waiting=waiting,
        due_ns=int(waiting.due[-1]) if len(waiting) else of.due_ns,
        first_ns=min([*first, *([] if of.first_ns is None else [of.first_ns])], default=None),
    )
