"""A vehicle's attitudes, and its motion by a DVL: over the ground for pings that lack it, through water as a ping of one cell."""

from collections.abc import Sequence

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.table import Columns, Raw, Table
from replay_kit.logs.tables.instruments import pings
from replay_kit.measurements.earth import (
    ATTITUDE_AGE,
    BOTTOM_AGE,
    Words,
    horizontal,
    last_triple,
)
from replay_kit.measurements.frames import attitude_of
from replay_kit.measurements.ledger import Ledger
from replay_kit.measurements.positions import Rows, in_order

_KEPT = "attitude: kept for pings without their own"
_NO_ATTITUDE = "DVL: no attitude within 1 s"
_NO_DECLINATION = "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
_NO_LAYER = "DVL water track does not state its layer depth; set measurements.water_track_distance"
_NO_BOTTOM = "DVL water track without a bottom track gives no current"


def attitudes_of(before: Columns, tables: Sequence[Table], ledger: Ledger) -> Rows:
    """Return the attitudes of a block after the last one before it, and note the messages that state nothing else."""
    parts = [before]
    for one in tables:
        if one.kind == "attitude":
            ledger.add(one.order, one.topic, _KEPT)
        if one.kind == "attitude" or one.fixed.get("oriented"):
            angles = attitude_of(one["quaternion"], one["ned"].astype(bool))
            parts.append({"time": one.time, "order": one.order, "values": angles})
    return in_order(*parts)


def motions_of(
    before: Columns,
    tables: Sequence[Table],
    attitudes: Columns,
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple[Rows, list[Table]]:
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
        bottom = one["bottom"].astype(bool)
        if config.water_track_distance is None:
            why[(why == "") & ~bottom] = _NO_LAYER
        told, through = (why != "") | bottom, (why == "") & ~bottom
        ledger.add(one.order[told], one.topic, why[told])
        at = (why == "") & bottom
        parts.append({"time": one.time[at], "order": one.order[at], "values": velocity[at]})
        water.append((one.rows(through), velocity[through]))
    motions, found = in_order(*parts), list[Table]()
    for one, velocity in water:
        known = np.isfinite(last_triple(motions, one, BOTTOM_AGE, BOTTOM_AGE)[:, 0])
        ledger.add(one.order[~known], one.topic, _NO_BOTTOM)
        if known.any():
            found += _pings(one.rows(known), velocity[known], config)
    return motions, found


def _velocity(table: Table, attitudes: Columns, config: MeasurementConfig) -> tuple[Array, Words]:
    """Return true east, true north and error of velocities, shape (n, 3) [m/s], and in words why they are not known."""
    angles, declination = last_triple(attitudes, table, ATTITUDE_AGE), config.magnetic_declination
    why = np.where(np.isfinite(angles[:, 0]), "", _NO_ATTITUDE).astype(object)
    if declination is None:
        declination, why[why == ""] = np.nan, _NO_DECLINATION
    left_up = table["axes"] == 2
    if config.dvl_axes is not None:
        left_up[:] = config.dvl_axes == "forward-left-up"
    ground = horizontal(table["velocity"], angles, declination, left_up)
    return np.column_stack([ground, table["error_std"]]), why


def _pings(table: Table, velocity: Array, config: MeasurementConfig) -> list[Table]:
    """Return velocities through a layer of water as pings of one cell: the water's velocity relative to the vehicle is its opposite."""
    fixed = {
        "coordinate_system": "earth",
        "reference": "platform",
        "orientation": "down",
        "n_cells": 1,
        "cell_distances": [config.water_track_distance],
        "declination_applied": True,
    }
    payloads = [
        {**fixed, "velocity": [[-east, -north]], "velocity_std": std}
        for east, north, std in velocity.tolist()
    ]
    raw = Raw(table.topic, "", table.input, table.time, table.order, table.position, payloads)
    # a DVL states its own unit
    return pings(raw, payloads, config.model_copy(update={"velocity_unit": None}))
