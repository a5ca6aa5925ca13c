"""A simulated mission as the messages a vehicle would log."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.message import Message
from replay_kit.studies.twins.adcp import AdcpSettings
from replay_kit.studies.twins.faults import Faults
from replay_kit.studies.twins.vehicle import Dive, Mission, Position

_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What an instrument logs.

    Attributes:
        velocity: shape (n_pings, n_cells, 2) [m/s], true east and north; NaN where bad.
        settings: The instrument.
        faults: What the velocities are relative to, and with which error the platform's velocity is stated.
        platform: shape (n_pings, 2) [m/s], the platform's velocity, true east and north; None where it is not stated.
    """

    velocity: Array
    settings: AdcpSettings
    faults: Faults
    platform: Array | None


def mission_messages(mission: Mission, record: Record | None) -> Iterator[Message]:
    """Yield the log's messages in order of time: at one time the position, then a dive's mean current, then the ping.

    Args:
        mission: What the vehicle did.
        record: What its instrument logs; None without one.
    """
    entries: list[tuple[int, int, str, str, dict[str, Any]]] = []
    latitudes = {}
    for position in mission.positions:
        topic = "/vehicle/position" if position.dead_reckoned else "/vehicle/fix"
        entries.append((position.time_ns, 0, topic, "foxglove.LocationFix", _location_fix(position)))
        latitudes[position.time_ns] = position.latitude
    for dive in mission.dives:
        entries.append((dive.end.time_ns, 1, "/dac", "replay_kit.DepthAveragedCurrent", _depth_averaged_current(dive)))
    for number, time_ns in enumerate(mission.pings.time_ns.tolist() if record is not None else ()):
        assert record is not None
        ping = _adcp_ping(mission, number, record, latitudes[time_ns])
        entries.append((time_ns, 2, "/adcp", "replay_kit.AdcpPing", ping))
    entries.sort(key=lambda entry: entry[:2])
    for ordinal, (time_ns, _, topic, schema, payload) in enumerate(entries):
        yield Message(time_ns, topic, schema, payload, 0, ordinal)


def _stamp(time_ns: int) -> dict[str, int]:
    return {"sec": time_ns // _NS, "nsec": time_ns % _NS}


def _location_fix(position: Position) -> dict[str, Any]:
    return {
        "timestamp": _stamp(position.time_ns),
        "frame_id": "vehicle",
        "latitude": position.latitude,
        "longitude": position.longitude,
        "altitude": -position.depth,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,
        "metadata": [
            {"key": "depth", "value": f"{position.depth:.3f}"},
            {"key": "dead_reckoned", "value": "true" if position.dead_reckoned else "false"},
        ],
    }


def _depth_averaged_current(dive: Dive) -> dict[str, Any]:
    fixes = ({"time": _stamp(fix.time_ns), "lon": fix.longitude, "lat": fix.latitude} for fix in (dive.start, dive.end))
    return {
        "stamp": _stamp(dive.end.time_ns),
        "dive": dive.number,
        "dac_eastward": round(dive.current[0], 6),
        "dac_northward": round(dive.current[1], 6),
        "error": None,
        **dict(zip(("start_fix", "end_fix"), fixes, strict=True)),
        "duration": (dive.end.time_ns - dive.start.time_ns) / _NS,
        "dac_kind": "dead_reckoning",
    }


def _adcp_ping(mission: Mission, number: int, record: Record, latitude: float) -> dict[str, Any]:
    pings, settings = mission.pings, record.settings
    pressure = float(gsw.p_from_z(-pings.depth[number], latitude)) if pings.depth[number] > 0.0 else 0.0
    # a tenth of the millimetre per second that instruments resolve, so that the numbers stay short
    cells = [[*(_number(component) for component in cell), None] for cell in np.round(record.velocity[number], 4).tolist()]
    return {
        "stamp": _stamp(int(pings.time_ns[number])),
        "frame_id": "adcp",
        "ping": number,
        "coordinate_system": "earth",
        "reference": record.faults.reference,
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": settings.n_cells,
        "cell_size": settings.cell_size,
        "bin0_distance": settings.bin0_distance,
        "transducer_depth": 0.0,
        "beam_unit_vectors": None,
        "velocity": cells,
        # a noise-free instrument states no error: zero would be a weight without bound
        "velocity_std": settings.noise if settings.noise > 0.0 else None,
        "amplitude": None,
        "correlation": None,
        "percent_good": None,
        "sound_speed": 1500.0,
        "temperature": None,
        "pressure": round(pressure, 3),
        "heading": round(float(pings.heading_deg[number]), 2),
        "pitch": float(pings.pitch_deg[number]),
        "roll": 0.0,
        "magnetic_declination": None,
        "declination_applied": True,
        "bottom_track": None,
        **_platform_velocity(record, number),
    }


def _platform_velocity(record: Record, number: int) -> dict[str, Any]:
    if record.platform is None:
        return {}
    east, north = np.round(record.platform[number], 4).tolist()
    return {"platform_velocity": {"east": east, "north": north, "velocity_std": record.faults.platform_std, "source": "flight_model"}}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
