"""Attitudes of a vehicle, and its DVL velocity: over ground for pings that lack it, through water as a ping of one cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.observation.table import Columns, Raw, Rows, Table
from replay_kit.logs.tables.instruments import pings
from replay_kit.measurements.profiles.earth import ATTITUDE_AGE, BOTTOM_AGE, Words, last_triple
from replay_kit.measurements.profiles.frames import attitude_of, nortek_rotation, turned
from replay_kit.measurements.step import Step
from replay_kit.measurements.track.positions import in_order

_KEPT = "attitude: kept for pings without their own"


def attitudes_of(before: Columns, tables: Sequence[Table], step: Step) -> Rows:
    """Return the last earlier attitude and those of a block, and note the messages that state only attitudes."""
    parts = [before]
    for one in tables:
        if one.kind == "attitude":
            step.note(one, _KEPT)
        if one.kind == "attitude" or one.fixed.get("oriented"):
            angles = attitude_of(one["quaternion"], one["ned"].astype(bool))
            parts.append({"time": one.time, "order": one.order, "values": angles})
    return in_order(*parts)


def motions_of(
    before: Columns, tables: Sequence[Table], attitudes: Columns, step: Step
) -> tuple[Rows, list[Table]]:
    """Return the last earlier velocity over ground and those of a block, and velocities through water as pings.

    Args:
        before: Last earlier velocity.
        tables: Tables of DVLs.
        attitudes: Attitudes of the vehicle.
        step: Block.
    """
    parts, water = [before], list[Table]()
    for one in tables:
        values, why = velocity_of(one, attitudes, step.config)
        one = step.kept(replace(one, columns={**one.columns, "values": values}), why)
        bottom = one["bottom"].astype(bool)
        ground, rest = one.rows(bottom), one.rows(~bottom)
        step.note(ground)
        parts.append({"time": ground.time, "order": ground.order, "values": ground["values"]})
        if step.config.water_track_distance is not None:
            water.append(rest)
        else:
            words = "DVL water track does not state its layer depth; set measurements.water_track_distance"
            step.note(rest, words)
    motions, found = in_order(*parts), list[Table]()
    for one in water:
        known = np.isfinite(last_triple(motions, one, BOTTOM_AGE, BOTTOM_AGE)[:, 0])
        why = np.where(known, "", "DVL water track without a bottom track gives no current")
        found += _pings(step.kept(one, why), step)
    return motions, found


def velocity_of(table: Table, attitudes: Columns, config: MeasurementConfig) -> tuple[Array, Words]:
    """Return true east, true north and error of velocities, shape (n, 3) [m/s], and the reasons of unknown ones."""
    heading, pitch, roll = last_triple(attitudes, table, ATTITUDE_AGE).T
    declination, axes = config.magnetic_declination, config.dvl_axes
    why = np.where(np.isfinite(heading), "", "DVL: no attitude within 1 s").astype(object)
    if declination is None:
        declination = np.nan
        why[why == ""] = (
            "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
        )
    left_up = table["axes"] == 2 if axes is None else np.array(axes == "forward-left-up")
    body = table["velocity"] * np.where(left_up[..., None], (1.0, -1.0, -1.0), 1.0)
    # Nortek's angles are those of an attitude: nose up, starboard down
    rotation = nortek_rotation(heading + declination, pitch, roll, True)
    ground = turned(body[:, None], rotation)[:, 0, :2]
    return np.column_stack([ground, table["error_std"]]), why


def _pings(table: Table, step: Step) -> list[Table]:
    """Return velocities through a layer of water as pings of one cell with the opposite velocity."""
    fixed = {
        "coordinate_system": "earth",
        "reference": "platform",
        "orientation": "down",
        "n_cells": 1,
        "cell_distances": [step.config.water_track_distance],
        "declination_applied": True,
    }
    payloads = [
        {**fixed, "velocity": [[-east, -north]], "velocity_std": std}
        for east, north, std in table["values"].tolist()
    ]
    raw = Raw(table.topic, "", table.input, table.time, table.order, table.position, payloads)
    # a DVL states its own unit
    return pings(raw, payloads, step.config.model_copy(update={"velocity_unit": None}))
