"""Simulated ADCP: measurements below each ping, a mission's messages, and profiles at random positions or all grid points."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import Observation
from replay_kit.logs.payloads import DIVE_MEAN, FIX, PING, location_fix, number, stamp
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import EPOCH_NS, NS_PER_S, Dive, Mission, Pings, random_places

#: A down-looking instrument: number of bins, their size and the distance from the transducer to the centre of the first [m].
N_CELLS, CELL_SIZE, BIN0_DISTANCE = 22, 32.0, 16.0
_BELOW: Array = BIN0_DISTANCE + CELL_SIZE * np.arange(N_CELLS, dtype=np.float64)


def measure(field: Field, pings: Pings, noise: float, rng: np.random.Generator) -> Array:
    """Return the measured velocity of each bin of each ping, shape (n_pings, n_cells, 2) [m/s], true east and north.

    NaN below the truth's last level, on land and outside its grid.

    Args:
        field: Truth.
        pings: Positions of the instrument.
        noise: Standard deviation of each component of each bin [m/s].
        rng: Generator of the noise; dry bins draw too, so that noise does not depend on other bins' water.
    """
    velocity = field.velocity(
        pings.east[:, None],
        pings.north[:, None],
        pings.depth[:, None] + _BELOW,
        pings.time_ns[:, None],
    )
    longitude, latitude = to_geographic(field.grid.projection, pings.east, pings.north)
    east, north = rotate_to_geographic(
        field.grid.projection,
        longitude[:, None],
        latitude[:, None],
        velocity[..., 0],
        velocity[..., 1],
    )
    return np.stack([east, north], axis=-1) + noise * rng.standard_normal(velocity.shape)


# Error stated by an instrument without noise: the paper's in ideal conditions [m/s].
IDEAL_ERROR_STD = 0.01
_INTERVAL_NS = 60_000_000_000


def random_observations(
    field: Field, pings: int, noise: float, seed: int
) -> tuple[Observation, ...]:
    """Return profiles, 22 bins of 32 m from 16 m, at positions uniformly random over the truth's wet surface.

    Args:
        field: Truth.
        pings: Number of profiles.
        noise: Standard deviation of each component of each bin [m/s], stated as error.
        seed: Seed of positions and noise.

    Raises:
        ForecastError: The truth's surface is almost all dry.
    """
    rng = np.random.default_rng(seed)
    places = random_places(field, pings, rng)
    time_ns = EPOCH_NS + _INTERVAL_NS * np.arange(pings)
    nothing = np.zeros(pings)
    velocity = measure(
        field, Pings(time_ns, places[:, 0], places[:, 1], nothing, nothing, nothing), noise, rng
    )
    longitude, latitude = to_geographic(field.grid.projection, places[:, 0], places[:, 1])
    error_std = noise if noise > 0.0 else IDEAL_ERROR_STD
    return _observations((longitude, latitude), _BELOW, velocity, error_std)


def grid_observations(truth: Ensemble) -> tuple[Observation, ...]:
    """Return the paper's ideal measurements: each wet grid point once, without noise, one profile per grid column.

    Args:
        truth: Ensemble of one; bins are at its levels.
    """
    grid = truth.grid
    j, i = np.nonzero(grid.wet[0])
    longitude, latitude = grid.longitude[j, i], grid.latitude[j, i]
    u, v = truth.velocity[0][:, :, j, i]
    velocity = np.stack(rotate_to_geographic(grid.projection, longitude, latitude, u, v), axis=-1)
    return _observations(
        (longitude, latitude), grid.levels, np.moveaxis(velocity, 1, 0), IDEAL_ERROR_STD
    )


def _observations(
    places: tuple[Array, Array], depth: Array, velocity: Array, error_std: float
) -> tuple[Observation, ...]:
    """Return profiles, one a minute, at longitudes and latitudes, from velocities of shape (n, depths, 2), NaN where missing."""
    return tuple(
        Observation.profile(
            EPOCH_NS + _INTERVAL_NS * k, lon, lat, depth, each[:, 0], each[:, 1], error_std
        )
        for k, (lon, lat, each) in enumerate(zip(*places, velocity, strict=True))
    )


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
