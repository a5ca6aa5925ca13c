"""Settings of the measurements from the region of a run: speeds, extent and resolution of its ensemble."""

import math

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.grid import Ensemble

_MEMBERS, _COLUMNS = 4, 500


def for_region(config: RunConfig, ensemble: Ensemble) -> RunConfig:
    """Return the settings of a run completed by its ensemble: speed of the currents, extent and resolution."""
    measurements, grid = config.measurements, ensemble.grid
    # some columns of some members tell as much as all of them, and a region without a CTD is not read for it
    every = 1 + math.isqrt(grid.east.size // _COLUMNS)
    squares = np.square(ensemble.velocity[:_MEMBERS, ..., ::every, ::every]).sum(axis=1)
    speed = float(np.sqrt(np.mean(squares, where=np.isfinite(squares))))
    steps = [grid.steps(axis) for axis in (0, 1)]
    longitude = unwrap_longitude(grid.longitude, grid.projection.longitude)
    found = {
        "regional_speed": speed or None,
        "surface_spacing": max(
            (2.0 * float(np.median(step)) for step in steps if step.size), default=None
        ),
        "surface_box": tuple(
            float(end(each)) for end in (np.min, np.max) for each in (longitude, grid.latitude)
        ),
    }
    lacks = {name: value for name, value in found.items() if getattr(measurements, name) is None}
    return config.model_copy(update={"measurements": measurements.model_copy(update=lacks)})
