"""A simulated ADCP: what it measures of a truth below each ping."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import Pings


@dataclass(frozen=True, slots=True)
class AdcpSettings:
    """A down-looking instrument.

    Attributes:
        n_cells: Number of bins.
        cell_size: [m].
        bin0_distance: Transducer to the centre of the first bin [m].
        noise: Standard deviation of each component [m/s].
    """

    n_cells: int = 22
    cell_size: float = 32.0
    bin0_distance: float = 16.0
    noise: float = 0.09


def measure(field: Field, pings: Pings, settings: AdcpSettings, rng: np.random.Generator) -> Array:
    """Return what each bin of each ping measures, shape (n_pings, n_cells, 2) [m/s], true east and true north.

    NaN where the truth has no water: below its last level, on land, outside its grid.

    Args:
        field: The truth.
        pings: Where the instrument is.
        settings: The instrument.
        rng: Source of the noise; each bin takes its draws whether it is wet or not, so that one bin's noise does not depend on
            another's water.
    """
    below = settings.bin0_distance + settings.cell_size * np.arange(settings.n_cells)
    velocity = field.velocity(pings.east[:, None], pings.north[:, None], pings.depth[:, None] + below, pings.time_ns[:, None])
    longitude, latitude = to_geographic(field.grid.projection, pings.east, pings.north)
    east, north = rotate_to_geographic(field.grid.projection, longitude[:, None], latitude[:, None], velocity[..., 0], velocity[..., 1])
    noise = rng.standard_normal(velocity.shape)
    return np.stack([east, north], axis=-1) + settings.noise * noise
