"""Simulated profiles of a truth at random places of its surface, in random order."""

import numpy as np

from replay_kit.geodesy import to_geographic
from replay_kit.twin.adcp import AdcpSettings, measure
from replay_kit.twin.field import Field
from replay_kit.twin.vehicle import EPOCH_NS, Pings, random_places
from replay_kit.types import Array, Flag, Observation, Reason, Source

# Error stated by an instrument without noise: the paper's in ideal conditions [m/s].
IDEAL_ERROR_STD = 0.01
_INTERVAL_NS = 60_000_000_000


def random_observations(field: Field, pings: int, noise: float, seed: int) -> tuple[Observation, ...]:
    """Return profiles, 22 bins of 32 m from 16 m each, at places uniformly random over the truth's wet surface.

    Args:
        field: The truth.
        pings: Number of profiles.
        noise: Standard deviation of each component of each bin [m/s]; the profiles state it as their error.
        seed: Of the places and of the noise.

    Raises:
        ForecastError: Hardly any of the truth's surface is wet.
    """
    rng = np.random.default_rng(seed)
    places = random_places(field, pings, rng)
    settings = AdcpSettings(noise=noise)
    time_ns = EPOCH_NS + _INTERVAL_NS * np.arange(pings)
    nothing = np.zeros(pings)
    velocity = measure(field, Pings(time_ns, places[:, 0], places[:, 1], nothing, nothing, nothing), settings, rng)
    depth = settings.bin0_distance + settings.cell_size * np.arange(settings.n_cells, dtype=np.float64)
    longitude, latitude = to_geographic(field.grid.projection, places[:, 0], places[:, 1])
    error_std = noise if noise > 0.0 else IDEAL_ERROR_STD
    return tuple(
        _observation(int(t), float(x), float(y), depth, profile, error_std, k)
        for k, (t, x, y, profile) in enumerate(zip(time_ns, longitude, latitude, velocity, strict=True))
    )


def _observation(
    time_ns: int, longitude: float, latitude: float, depth: Array, velocity: Array, error_std: float, position: int
) -> Observation:
    missing = ~np.isfinite(velocity).all(axis=1)
    return Observation(
        time_ns=time_ns,
        longitude=longitude,
        latitude=latitude,
        depth=depth,
        velocity=velocity,
        error_std=np.full(depth.size, error_std),
        reference="earth",
        flags=np.where(missing, Flag.MISSING, Flag.GOOD).astype(np.int8),
        reasons=np.where(missing, Reason.MISSING, Reason.NONE).astype(np.int32),
        dive=0,
        source=Source(0, "/adcp", position, time_ns),
    )
