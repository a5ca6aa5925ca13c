"""A vehicle's attitudes, and its motion by a DVL: over the ground for pings that lack it, through water as a ping of one cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.table import Columns, Table
from replay_kit.measurements.earth import Attitudes, Motions, horizontal
from replay_kit.measurements.ledger import Ledger

_KEPT = "attitude: kept for pings without their own"
_NO_ATTITUDE = "DVL: no attitude within 1 s"
_NO_DECLINATION = "DVL heading: true or magnetic north unknown; set measurements.magnetic_declination (0 for true north)"
_NO_LAYER = "DVL water track does not state its layer depth; set measurements.water_track_distance"
_NO_BOTTOM = "DVL water track without a bottom track gives no current"
_STD_BELIEVED = (1e-6, 1e3)
_NAN = np.nan


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
            water.append((_rows(one, (why == "") & ~bottom), velocity[(why == "") & ~bottom]))
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
            found.append(_ping(_rows(one, known), velocity[known], config))
    return motions, found


def _velocity(
    table: Table, attitudes: Attitudes, config: MeasurementConfig
) -> tuple[Array, NDArray[np.object_]]:
    """Return true east, true north and error of velocities, shape (n, 3) [m/s], and in words why they are not known."""
    angles, declination = attitudes.at(table.time, table.order), config.magnetic_declination
    why = np.where(np.isfinite(angles[:, 0]), "", _NO_ATTITUDE).astype(object)
    if declination is None:
        why[why == ""] = _NO_DECLINATION
        return np.full((len(table), 3), _NAN), why
    left_up = table["axes"] == 2
    if config.dvl_axes is not None:
        left_up = np.full(len(table), config.dvl_axes == "forward-left-up")
    ground = horizontal(table["velocity"], angles, declination, left_up)
    return np.column_stack([ground, table["error_std"]]), why


def _rows(table: Table, at: NDArray[np.bool_]) -> Table:
    columns: Columns = {name: column[at] for name, column in table.columns.items()}
    return replace(
        table,
        time=table.time[at],
        order=table.order[at],
        position=table.position[at],
        columns=columns,
    )


def _ping(table: Table, velocity: Array, config: MeasurementConfig) -> Table:
    """Return velocities through a layer of water as pings of one cell: the water's velocity relative to the vehicle is its opposite."""
    n = len(table)
    blank, std, distance = np.full(n, _NAN), velocity[:, 2], config.water_track_distance
    believed = (std >= _STD_BELIEVED[0]) & (std <= _STD_BELIEVED[1])
    cells = np.column_stack([-velocity[:, :2], blank])[:, None]
    columns = dict.fromkeys(
        ("heading", "pitch", "roll", "declination", "pressure", "transducer_depth"), blank
    )
    columns |= dict.fromkeys(("bottom_std", "bottom_range", "platform_std"), blank)
    columns |= {
        "velocity": cells,
        "error_std": np.where(believed, std, _NAN)[:, None],
        "distance": np.full((n, 1), distance),
        "bottom": np.full((n, 4), _NAN),
        "platform": np.full((n, 2), _NAN),
        "dive": np.full(n, -1),
        "messages": np.ones(n, np.int64),
        "place": np.full((n, 3), _NAN),
    }
    for name in ("amplitude", "correlation", "percent_good", "snr", "error_velocity"):
        columns[f"no_{name}"] = np.full(n, f"the ping has no {name}", object)
    fixed = {
        "frame": "earth",
        "reference": "platform",
        "orientation": "down",
        "cell_size": _NAN,
        "vectors": None,
        "bin_mapped": False,
        "noise_floor": np.array([_NAN]),
        "needs_depth": False,
        "correlation_depth": _NAN,
        "derived": False,
        "convention": "None",
        "gimbal": False,
        "tilt_applied": True,
        "declination_applied": True,
        "layout": "water track",
    }
    return replace(table, kind="ping", columns=columns, fixed=fixed)
