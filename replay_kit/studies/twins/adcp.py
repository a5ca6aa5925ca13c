"""Simulated ADCP: measurements below each ping, and profiles at random positions or all grid points."""

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import EPOCH_NS, Pings, random_places

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
