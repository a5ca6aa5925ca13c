"""Current profiles in messages of two packages, as payloads of ``replay_kit.AdcpPing``.

Fields that a message does not state are omitted, such as ``reference``, which the configuration may give. Definitions:
``ds_sensor_msgs/Adcp`` (Field-Robotics-Lab/ds_msgs).
"""

from collections.abc import Sequence

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    field,
    guarded,
    number,
    stated,
    whole_number,
    why,
)
from replay_kit.logs.tables.instruments import SYSTEMS, pings
from replay_kit.logs.tables.vehicle import no_place

_WHOLE_METRES = (
    "cell_depth is 0: this message holds whole metres only, so that the size of cells below 1 m is lost; "
    "state it with a [[measurements.map]] entry for the topic"
)
_BOTTOM_ALONE = "bottom track alone: motion of the vehicle, no current"


def adcp_pings(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of ``replay_kit.AdcpPing`` messages; ``place`` marks a mooring or a drifter."""
    payloads = raw.payloads
    moored = np.array(
        [place is not None and hasattr(place, "get") for place in field(payloads, "place")]
    )
    cells, *place = stated(payloads, "n_cells place.lon place.lat")
    bottom = [*map(bool, field(payloads, "bottom_track"))]
    reasons = {_BOTTOM_ALONE: (cells == 0) & bottom}
    reasons |= {word: moored & wrong for word, wrong in no_place(*place).items()}
    words = np.broadcast_to(why(reasons), len(payloads)).tolist()
    said = payloads
    if any(words):
        said = [word or payload for word, payload in zip(words, payloads, strict=True)]
    depth = np.where(moored, 0.0, np.nan)
    return pings(raw, said, config, places=np.column_stack([*place, depth]))


def ds_adcps(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of ``ds_sensor_msgs/Adcp`` messages."""
    return pings(raw, [guarded(_ds_adcp, one) for one in raw.payloads], config)


def _ds_adcp(payload: Payload) -> Payload | str:
    """Return the profile of a ``ds_sensor_msgs/Adcp``, or the reason for exclusion.

    A cell holds one vector, or in beam coordinates one vector per beam; zeros mean no solution. Reference and orientation are not stated:
    downward is assumed, as for a DVL's water track.
    """
    mode, cells = whole_number(payload.get("coordinate_mode")), payload["vel_bin_beams"]
    if mode is None or not 0 <= mode < len(SYSTEMS):
        return "coordinate_mode is none of 0 (beam), 1 (instrument), 2 (ship), 3 (earth)"
    cell_size = number(payload.get("cell_depth"))
    if cell_size == 0.0:
        return _WHOLE_METRES
    directions = _vectors(payload["beam_unit_vec"])
    found = [_vectors(cell["velocity_bin_beam"]) for cell in cells]
    for vectors in found:
        vectors[~vectors.any(axis=1)] = np.nan
    velocity = [vectors[:1].ravel().tolist() or None for vectors in found]
    if SYSTEMS[mode] == "beam":
        velocity = [
            [float(one @ unit) for one, unit in zip(vectors, directions, strict=True)]
            for vectors in found
        ]
    return {
        "coordinate_system": SYSTEMS[mode],
        "orientation": "down",
        "n_cells": len(cells),
        "cell_size": cell_size,
        "bin0_distance": payload.get("bin0_distance"),
        "beam_unit_vectors": directions.tolist(),
        "velocity": velocity,
    }


def _vectors(values: Sequence[Payload]) -> Array:
    """Return x, y, z of messages, shape (n, 3)."""
    xyz = [[number(value.get(axis)) for axis in "xyz"] for value in values]
    return np.array(xyz, np.float64).reshape(-1, 3)
