"""Payloads of ``replay_kit.AdcpPing`` that the ADCPs of gliders have in common."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.logs.glider.columns import Columns
from replay_kit.logs.glider.currents import DiveMean
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, number, stamp

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


#: Topic of the profiles.
PROFILES = "/adcp/absolute"


def absolute_profiles(
    columns: Columns, means: Sequence[DiveMean], notes: list[str]
) -> Iterator[Entry]:
    """Yield the absolute profiles of a mission as pings at the middle of their dives, where the file states it.

    They were referenced to the mean currents: ``computed_from`` and, in the mean currents, ``also_in`` keep them from counting twice.
    """
    profile, samples = columns.profile, columns.samples
    if not profile:
        return
    depth = profile["depth"]
    steps = np.diff(depth)
    even = bool(steps.size and np.allclose(steps, steps[0]) and steps[0] > 0.0)
    placed = {mean.middle.time_ns for mean in means if mean.middle is not None}
    notes.append(
        "absolute profiles: taken as east and north relative to the earth, each at the middle of its dive"
    )
    for k in range(len(profile["east"])):
        velocity = np.column_stack([profile["east"][k], profile["north"][k]])
        if not np.isfinite(velocity).all(axis=1).any():
            continue
        middle_ns = int(samples["dac_time"][k]) if "dac_time" in samples else 0
        time_ns = middle_ns if middle_ns in placed else int(samples["time"][k])
        payload = earth_ping(
            time_ns,
            k,
            int(samples["dive"][k]),
            velocity,
            (float(steps[0]) if even else 1.0, float(depth[0])),
        )
        payload |= FROM_SURFACE | {
            "computed_from": ["/dac"],
            **({} if even else {"cell_distances": depth.tolist()}),
        }
        yield time_ns, PROFILES, PING, payload
