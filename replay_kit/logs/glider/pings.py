"""Payloads of ``replay_kit.AdcpPing`` that the ADCPs of gliders have in common."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.logs.shared.payloads import number, stamp

_UNKNOWN = (
    *(
        "beam_unit_vectors",
        "velocity_std",
        "amplitude",
        "correlation",
        "percent_good",
        "sound_speed",
        "temperature",
    ),
    *("heading", "pitch", "roll", "magnetic_declination", "bottom_track"),
)


#: Of a profile that was computed from others and begins at the surface, not at the glider: its levels are depths.
FROM_SURFACE = {
    "reference": "earth",
    "orientation": "down",
    "bin_mapped": True,
    "pressure": 0.0,
    "declination_applied": True,
    "derived": True,
}


def earth_ping(
    time_ns: int, ordinal: int, dive: int | None, velocity: Array, cells: tuple[float, float]
) -> dict[str, Any]:
    """Return a ping in earth coordinates; unknown fields are null.

    Args:
        time_ns: [ns, UTC].
        ordinal: Of the ping.
        dive: Number of its dive; None when unknown.
        velocity: shape (n_cells, 2 or 3) [m/s], east, north, up; NaN where missing.
        cells: Size of the cells, and distance of the first one's centre [m].
    """
    return {
        "stamp": stamp(time_ns),
        "frame_id": "adcp",
        "ping": ordinal,
        **({} if dive is None else {"dive": dive}),
        "coordinate_system": "earth",
        "n_cells": len(velocity),
        "cell_size": cells[0],
        "bin0_distance": cells[1],
        "transducer_depth": 0.0,
        "velocity": [
            [number(component) for component in cell] for cell in np.round(velocity, 6).tolist()
        ],
        **dict.fromkeys(_UNKNOWN),
    }
