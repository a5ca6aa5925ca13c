"""Reading an ensemble of one file a member, cropped to a window: only the window is read."""

import tempfile
from pathlib import Path

import numpy as np
import xarray as xr

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast import read_ensemble
from tests.benchmarks.measure import Row, alone, row, seconds

_STEP = 0.05


def rows(tiny: bool) -> list[Row]:
    """One row: 50 members x 30 levels x 120 x 120 from 50 files, cropped to 60 x 60."""
    members, levels, size = (4, 3, 12) if tiny else (50, 30, 120)
    with tempfile.TemporaryDirectory() as folder:
        last = _write(Path(folder), members, levels, size)
        start, end = 10.0 + _STEP * (size // 4), 10.0 + _STEP * (size // 4 + size // 2 - 1)
        config = ForecastConfig(region=(start, start + 30.0, end, end + 30.0))
        expected = last[:, size // 4 : size // 4 + size // 2, size // 4 : size // 4 + size // 2]

        name = f"read {members} files of {levels} x {size} x {size}, cropped to {size // 2} x {size // 2}; asked 10 s, 1 GB"

        def work() -> Row:
            taken, ensemble = seconds(lambda: read_ensemble(Path(folder), config))
            assert ensemble.velocity.shape == (members, 2, levels, size // 2, size // 2)
            # a turn of the axes changes no speed
            speed = np.hypot(ensemble.velocity[-1, 0], ensemble.velocity[-1, 1])
            off = float(np.abs(speed - np.sqrt(2.0) * np.abs(expected)).max())
            return row(name, taken, error={"velocity": off})

        return [alone(work)]


def _write(folder: Path, members: int, levels: int, size: int) -> np.ndarray:
    """Write the files; return the last member's components, which are equal."""
    base = np.random.default_rng(0).normal(0.0, 0.1, (levels, size, size))
    dims = ("depth", "latitude", "longitude")
    axes = {
        "depth": 5.0 + 10.0 * np.arange(levels),
        "latitude": 40.0 + _STEP * np.arange(size),
        "longitude": 10.0 + _STEP * np.arange(size),
    }
    for member in range(members):
        field = base * (1.0 + 0.01 * member)
        ds = xr.Dataset({name: (dims, field, {"units": "m s-1"}) for name in ("uo", "vo")}, axes)
        ds.to_netcdf(folder / f"mem{member:03d}.nc", engine="h5netcdf")
    return field
