"""Messages of a simulated mission as a vehicle would log them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.message import Message
from replay_kit.logs.payloads import DIVE_MEAN, FIX, PING, location_fix, number, stamp
from replay_kit.studies.twins.adcp import BIN0_DISTANCE, CELL_SIZE, N_CELLS, measure
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import NS_PER_S, Dive, Mission, Pings


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Simulated mission with its measurements; created by ``measured_on``.

    Attributes:
        field: Truth.
        mission: Mission of the vehicle.
        noise: Standard deviation of each velocity component [m/s].
        measured: shape (n_pings, n_cells, 2) [m/s], noisy velocity over ground, true east and north; NaN where bad.
    """

    field: Field
    mission: Mission
    noise: float
    measured: Array

    @property
    def places(self) -> Array:
        """Positions of the pings, shape (pings, 2) [m], local axes."""
        return np.column_stack([self.mission.pings.east, self.mission.pings.north])

    def messages(self) -> Iterator[Message]:
        """Yield the log's messages in order of time: at equal times position, mean current of a dive, ping."""
        entries: list[tuple[int, int, str, str, dict[str, Any]]] = []
        for at in self.mission.positions:
            place = at.time_ns, at.longitude, at.latitude, at.depth
            fix = location_fix(*place, at.dead_reckoned, math.nan)
            entries.append((at.time_ns, 0, at.source.topic, FIX, fix))
        for dive in self.mission.dives:
            entries.append((dive.end.time_ns, 1, "/dac", DIVE_MEAN, _depth_averaged_current(dive)))
        entries += self._pings()
        entries.sort(key=lambda entry: entry[:2])
        for ordinal, (time_ns, _, topic, schema, payload) in enumerate(entries):
            yield Message(time_ns, topic, schema, payload, 0, ordinal)

    def _pings(self) -> Iterator[tuple[int, int, str, str, dict[str, Any]]]:
        """Yield the pings as logged by the instrument, with times and order among messages of equal time."""
        latitudes = {position.time_ns: position.latitude for position in self.mission.positions}
        for k, time_ns in enumerate(self.mission.pings.time_ns.tolist()):
            ping = _adcp_ping(
                self.mission.pings, k, self.noise, self.measured[k], latitudes[time_ns]
            )
            yield time_ns, 2, "/adcp", PING, ping


def measured_on(mission: Mission, field: Field, noise: float, rng: np.random.Generator) -> Flight:
    """Return a mission with its measurements.

    Args:
        mission: Mission of the vehicle.
        field: Truth.
        noise: Standard deviation of each velocity component [m/s].
        rng: Generator of the noise.
    """
    return Flight(field, mission, noise, measure(field, mission.pings, noise, rng))


def _depth_averaged_current(dive: Dive) -> dict[str, Any]:
    fixes = (
        {"time": stamp(fix.time_ns), "lon": fix.longitude, "lat": fix.latitude}
        for fix in (dive.start, dive.end)
    )
    return {
        "stamp": stamp(dive.end.time_ns),
        "dive": dive.number,
        "dac_eastward": round(dive.current[0], 6),
        "dac_northward": round(dive.current[1], 6),
        "error": None,
        **dict(zip(("start_fix", "end_fix"), fixes, strict=True)),
        "duration": (dive.end.time_ns - dive.start.time_ns) / NS_PER_S,
        "dac_kind": "dead_reckoning",
    }


def _adcp_ping(
    pings: Pings, ordinal: int, noise: float, velocity: Array, latitude: float
) -> dict[str, Any]:
    pressure = (
        float(gsw.p_from_z(-pings.depth[ordinal], latitude)) if pings.depth[ordinal] > 0.0 else 0.0
    )
    # a tenth of the millimetre per second that instruments resolve, so that the numbers stay short
    cells = [
        [*(number(component) for component in cell), None]
        for cell in np.round(velocity, 4).tolist()
    ]
    return {
        "stamp": stamp(int(pings.time_ns[ordinal])),
        "frame_id": "adcp",
        "ping": ordinal,
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": N_CELLS,
        "cell_size": CELL_SIZE,
        "bin0_distance": BIN0_DISTANCE,
        "transducer_depth": 0.0,
        "beam_unit_vectors": None,
        "velocity": cells,
        # a noise-free instrument states no error: zero would be a weight without bound
        "velocity_std": noise if noise > 0.0 else None,
        "amplitude": None,
        "correlation": None,
        "percent_good": None,
        "sound_speed": 1500.0,
        "temperature": None,
        "pressure": round(pressure, 3),
        "heading": round(float(pings.heading_deg[ordinal]), 2),
        "pitch": float(pings.pitch_deg[ordinal]),
        "roll": 0.0,
        "magnetic_declination": None,
        "declination_applied": True,
        "bottom_track": None,
    }
