"""A vehicle's attitudes, and its motion by a DVL: over the ground for pings that lack it, through water as a ping of one cell."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.instruments import pings
from replay_kit.measurements.earth import Attitudes, Motions, horizontal
from replay_kit.measurements.ledger import Ledger

_KEPT = "attitude: kept for pings without their own"
_NO_ATTITUDE = "DVL: no attitude within 1 s"
_NO_DECLINATION = "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
_NO_LAYER = "DVL water track does not state its layer depth; set measurements.water_track_distance"
_NO_BOTTOM = "DVL water track without a bottom track gives no current"


def attitudes_of(before: Attitudes, tables: Sequence[Table], ledger: Ledger) -> Attitudes:
    """Return the attitudes of a block after the last one before it, and note the messages that state nothing else."""
    parts = [before]
    for one in tables:
        if one.kind == "attitude":
            ledger.add(one.order, one.topic, _KEPT)
        if one.kind == "attitude" or (one.kind == "pose" and one.fixed["oriented"]):
            ned = one["ned"].astype(np.bool_)
            parts.append(Attitudes(one.time, one.order, one["quaternion"], ned))
    if len(parts) == 1:
        return before
    whole = Attitudes(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.order for part in parts]),
        np.concatenate([part.quaternion for part in parts]),
        np.concatenate([part.ned for part in parts]),
    )
    return whole.part(np.argsort(whole.order, kind="stable"))


def motions_of(
    before: Motions,
    tables: Sequence[Table],
    attitudes: Attitudes,
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple[Motions, list[Table]]:
    """Return the velocities over the ground after the last one before a block, and those through the water as pings.

    Args:
        before: The last one.
        tables: Of DVLs.
        attitudes: Of the vehicle.
        config: The declination, the axes, and the distance of the layer of water.
        ledger: Of the block.
    """
    parts, water = [before], list[tuple[Table, Array]]()
    for one in tables:
        velocity, why = _velocity(one, attitudes, config)
        bottom = one["bottom"].astype(np.bool_)
        if config.water_track_distance is None:
            why[(why == "") & ~bottom] = _NO_LAYER
        ledger.add(one.order[why != ""], one.topic, why[why != ""])
        at = (why == "") & bottom
        ledger.add(one.order[at], one.topic)
        parts.append(Motions(one.time[at], one.order[at], velocity[at]))
        if ((why == "") & ~bottom).any():
            water.append((one.rows((why == "") & ~bottom), velocity[(why == "") & ~bottom]))
    whole = Motions(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.order for part in parts]),
        np.concatenate([part.velocity for part in parts]),
    )
    motions, found = whole.part(np.argsort(whole.order, kind="stable")), list[Table]()
    for one, velocity in water:
        moves = motions.at(one.time, one.order)
        known = np.isfinite(moves[:, 0])
        ledger.add(one.order[~known], one.topic, _NO_BOTTOM)
        if known.any():
            found += _pings(one.rows(known), velocity[known], config)
    return motions, found


def _velocity(
    table: Table, attitudes: Attitudes, config: MeasurementConfig
) -> tuple[Array, NDArray[np.object_]]:
    """Return true east, true north and error of velocities, shape (n, 3) [m/s], and in words why they are not known."""
    angles, declination = attitudes.at(table.time, table.order), config.magnetic_declination
    why = np.where(np.isfinite(angles[:, 0]), "", _NO_ATTITUDE).astype(object)
    if declination is None:
        why[why == ""] = _NO_DECLINATION
        return np.full((len(table), 3), np.nan), why
    left_up = table["axes"] == 2
    if config.dvl_axes is not None:
        left_up = np.full(len(table), config.dvl_axes == "forward-left-up")
    ground = horizontal(table["velocity"], angles, declination, left_up)
    return np.column_stack([ground, table["error_std"]]), why


def _pings(table: Table, velocity: Array, config: MeasurementConfig) -> list[Table]:
    """Return velocities through a layer of water as pings of one cell: the water's velocity relative to the vehicle is its opposite."""
    payloads = [
        {
            "coordinate_system": "earth",
            "reference": "platform",
            "orientation": "down",
            "n_cells": 1,
            "velocity": [[-east, -north]],
            "velocity_std": std,
            "cell_distances": [config.water_track_distance],
            "declination_applied": True,
        }
        for east, north, std in velocity.tolist()
    ]
    raw = Raw(table.topic, "", table.input, table.time, table.order, table.position, payloads)
    # a DVL states its own unit
    return pings(raw, payloads, config.model_copy(update={"velocity_unit": None}))
