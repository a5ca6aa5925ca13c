"""Log of a twin experiment: a vehicle's mission as messages, with the pings of a down-looking ADCP."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import check_paths
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.payloads import DIVE_MEAN, FIX, PING, location_fix, numbers, stamp
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.mission import Mission, dives, survey

Vehicle = Literal["vessel", "glider"]
#: Number of bins, their size and the distance from the transducer to the centre of the first [m].
_CELLS: dict[str, Any] = {"n_cells": 22, "cell_size": 32.0, "bin0_distance": 16.0}
#: Depths of the bins below the transducer [m].
BELOW: Array = _CELLS["bin0_distance"] + _CELLS["cell_size"] * np.arange(
    _CELLS["n_cells"], dtype=np.float64
)


@dataclass(frozen=True, slots=True)
class Twin:
    """Settings of a simulated log.

    Attributes:
        vehicle: ``vessel``, a survey of random positions, or ``glider``, a sawtooth along a course.
        pings: Number of pings.
        noise: Standard deviation of each velocity component [m/s].
        seed: Seed of positions and noise.
    """

    vehicle: Vehicle
    pings: int
    noise: float
    seed: int

    def check(self) -> None:
        """Raise ConfigError if a value cannot be simulated."""
        sound = np.isfinite(self.noise) and min(self.noise, self.seed, self.pings - 1) >= 0
        if self.vehicle not in get_args(Vehicle) or not sound:
            got = f"{self.vehicle}, {self.pings}, {self.noise:g} and {self.seed}"
            raise ConfigError(
                f"twin: expected vehicle {' or '.join(get_args(Vehicle))}, pings >= 1, noise >= 0 and seed >= 0, got {got}"
            )


def make_twin(truth: Ensemble, twin: Twin, out: Path, overwrite: bool = False) -> Mission:
    """Write the log of a simulated vehicle in a truth, and return the mission; equal arguments give equal bytes.

    Args:
        truth: Ensemble of one.
        twin: Vehicle, survey, and errors of the instrument.
        out: Log, ``.mcap``.
        overwrite: Whether an existing log is replaced.

    Raises:
        ConfigError: An argument is invalid, or the output exists.
        ForecastError: The truth does not cover the track.
    """
    if out.suffix.lower() != ".mcap":
        raise ConfigError(f"{out}: a twin's log is .mcap, got '{out.suffix}'; choose this ending")
    check_paths([], [out], overwrite)
    twin.check()
    rng = np.random.default_rng(twin.seed)
    field = build_field(truth)
    mission = (survey if twin.vehicle == "vessel" else dives)(field, twin.pings, rng)
    velocity = measure(field, mission.place[mission.pinged], twin.noise, rng)
    write_mcap_log(out, messages(mission, velocity, twin.noise))
    return mission


def measure(field: Field, place: Array, noise: float, rng: np.random.Generator) -> Array:
    """Return the measured velocity of each bin of each ping, shape (n, 22, 2) [m/s], true east and north.

    NaN below the truth's last level, on land and outside its grid.

    Args:
        field: Truth.
        place: shape (n, 3) [m], transducer in the local frame: east, north, depth.
        noise: Standard deviation of each component of each bin [m/s].
        rng: Generator of the noise; dry bins draw too, so that noise does not depend on other bins' water.
    """
    east, north, depth = place.T[..., None]
    velocity = field.velocity(east, north, depth + BELOW)
    where = to_geographic(field.grid.projection, east, north)
    true = rotate_to_geographic(field.grid.projection, *where, *np.moveaxis(velocity, -1, 0))
    return np.stack(true, axis=-1) + noise * rng.standard_normal(velocity.shape)


def messages(mission: Mission, velocity: Array, noise: float) -> Iterator[Message]:
    """Yield a log's messages in order of time: at equal times position, mean current of a dive, ping.

    Args:
        mission: Mission of the vehicle.
        velocity: shape (pings, 22, 2) [m/s], as measured, true east and north; NaN where bad.
        noise: Standard deviation of each component [m/s], which the pings state.
    """
    dive_ending = {end: number for number, end in enumerate(mission.dives[:, 1].tolist())}
    ordinal, pings = 0, enumerate(velocity)
    for row, time_ns in enumerate(mission.time_ns.tolist()):
        reckoned, (lon, lat, depth) = bool(mission.dead_reckoned[row]), mission.logged[row]
        fix = location_fix(time_ns, lon, lat, depth, reckoned, math.nan)
        found = [("/vehicle/position" if reckoned else "/vehicle/fix", FIX, fix)]
        if row in dive_ending:
            found.append(("/dac", DIVE_MEAN, _depth_averaged_current(mission, dive_ending[row])))
        if mission.pinged[row]:
            found.append(("/adcp", PING, _adcp_ping(mission, row, *next(pings), noise)))
        for topic, schema, payload in found:
            yield Message(time_ns, topic, schema, payload, 0, ordinal)
            ordinal += 1


def _depth_averaged_current(mission: Mission, dive: int) -> dict[str, Any]:
    rows = mission.dives[dive]
    start, end = (
        {"time": stamp(int(mission.time_ns[row])), "lon": float(lon), "lat": float(lat)}
        for row, (lon, lat, _) in zip(rows, mission.logged[rows], strict=True)
    )
    east, north = mission.current[dive].round(6).tolist()
    return {
        "stamp": end["time"],
        "dive": dive + 1,
        "dac_eastward": east,
        "dac_northward": north,
        "error": None,
        "start_fix": start,
        "end_fix": end,
        "duration": float(np.ptp(mission.time_ns[rows])) / 1e9,
        "dac_kind": "dead_reckoning",
    }


def _adcp_ping(
    mission: Mission, row: int, ordinal: int, velocity: Array, noise: float
) -> dict[str, Any]:
    depth, latitude = float(mission.place[row, 2]), mission.logged[row, 1]
    # a tenth of the millimetre per second that instruments resolve, so that the numbers stay short
    cells = np.column_stack([velocity.round(4), np.full(len(velocity), np.nan)])
    return {
        "stamp": stamp(int(mission.time_ns[row])),
        "frame_id": "adcp",
        "ping": ordinal,
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        **_CELLS,
        "transducer_depth": 0.0,
        "beam_unit_vectors": None,
        "velocity": numbers(cells),
        # a noise-free instrument states no error: zero would be a weight without bound
        "velocity_std": noise or None,
        "amplitude": None,
        "correlation": None,
        "percent_good": None,
        "sound_speed": 1500.0,
        "temperature": None,
        "pressure": round(float(gsw.p_from_z(-depth, latitude)), 3) if depth > 0.0 else 0.0,
        "heading": round(float(mission.heading_deg[row]), 2),
        "pitch": float(mission.pitch_deg[row]),
        "roll": 0.0,
        "magnetic_declination": None,
        "declination_applied": True,
        "bottom_track": None,
    }
