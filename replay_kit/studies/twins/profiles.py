"""Simulated profiles of a truth: at random places of its surface, or at each of its grid points once."""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Flag, Observation, Reason, Source
from replay_kit.studies.twins.adcp import AdcpSettings, measure
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import EPOCH_NS, Pings, random_places

# Error stated by an instrument without noise: the paper's in ideal conditions [m/s].
IDEAL_ERROR_STD = 0.01
_INTERVAL_NS = 60_000_000_000


def random_observations(
    field: Field, pings: int, noise: float, seed: int
) -> tuple[Observation, ...]:
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
    velocity = measure(
        field, Pings(time_ns, places[:, 0], places[:, 1], nothing, nothing, nothing), settings, rng
    )
    depth = settings.bin0_distance + settings.cell_size * np.arange(
        settings.n_cells, dtype=np.float64
    )
    longitude, latitude = to_geographic(field.grid.projection, places[:, 0], places[:, 1])
    error_std = noise if noise > 0.0 else IDEAL_ERROR_STD
    return _observations((longitude, latitude), depth, velocity, error_std)


def grid_observations(truth: Ensemble) -> tuple[Observation, ...]:
    """Return the paper's ideal measurements: each wet grid point once, without noise, a profile for each column of grid points.

    Args:
        truth: An ensemble of one; the bins are at its levels.
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
    """Return profiles, one a minute, at longitudes and latitudes, of velocities of shape (n, depths, 2) that are NaN where missing."""
    missing = np.asarray(~np.isfinite(velocity).all(axis=2))
    return tuple(
        Observation(
            time_ns=EPOCH_NS + _INTERVAL_NS * k,
            longitude=float(longitude),
            latitude=float(latitude),
            depth=depth,
            velocity=velocity[k],
            error_std=np.full(depth.size, error_std),
            reference="earth",
            flags=np.where(missing[k], Flag.MISSING, Flag.GOOD).astype(np.int8),
            reasons=np.where(missing[k], Reason.MISSING, Reason.NONE).astype(np.int32),
            dive=0,
            source=Source(0, "/adcp", k, EPOCH_NS + _INTERVAL_NS * k),
        )
        for k, (longitude, latitude) in enumerate(zip(*places, strict=True))
    )
