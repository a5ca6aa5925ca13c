"""A synthetic ocean about the fixes of real dives."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from replay_kit.logs import merge, open_logs
from tests import synthetic

_LEVELS = np.array([5.0, 50.0, 150.0, 300.0, 500.0, 750.0, 1000.0])


def ocean_about(files: Sequence[Path], path: Path) -> tuple[Path, str]:
    """Write an ensemble of 20 members about the fixes of dives, and return its path and a goal in it as LON,LAT,DEPTH."""
    places = [
        (message.payload["longitude"], message.payload["latitude"])
        for message in merge(open_logs(files), 1.0)
        if "longitude" in message.payload and "latitude" in message.payload
    ]
    longitude, latitude = np.nanmean(np.array(places, dtype=np.float64), axis=0)
    rows, columns, step = 9, 11, 0.1
    west, south = longitude - 0.5 * step * (columns - 1), latitude - 0.5 * step * (rows - 1)
    ds = synthetic.dataset(
        seed=11,
        n_members=20,
        shape=(rows, columns),
        levels=_LEVELS,
        west=west,
        south=south,
        step=step,
    )
    ds.to_netcdf(path, engine="h5netcdf")
    return path, f"{longitude + 0.2:.3f},{latitude + 0.2:.3f},300"
