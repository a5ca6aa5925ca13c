"""Small ensembles and observations that many tests share; all seeded."""

from pathlib import Path

import numpy as np
import xarray as xr

from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation, Source
from replay_kit.forecast.grids.horizontal import local_grid, turn_to_local, turned_velocity

LEVELS = np.array([5.0, 60.0, 150.0, 300.0])


def dataset(
    seed=0, n_members=8, shape=(5, 6), levels=LEVELS, west=152.0, south=-40.0, step=0.1
) -> xr.Dataset:
    """A smooth random ensemble on a longitude-latitude grid, decaying with depth."""
    rng = np.random.default_rng(seed)
    rows, columns = shape
    longitude, latitude = west + step * np.arange(columns), south + step * np.arange(rows)
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    fields = np.zeros((2, n_members, levels.size, rows, columns))
    for member in range(n_members):
        for _ in range(5):
            kx = rng.normal(0, 0.7)
            ky = rng.normal(0, 0.7)
            phase = rng.uniform(0, 2 * np.pi)
            decay = rng.uniform(100.0, 500.0)
            psi_x = kx * np.cos(kx * x + ky * y + phase)
            psi_y = ky * np.cos(kx * x + ky * y + phase)
            # a cell is shorter along longitude: without this the flow would not be divergence-free
            psi_y = psi_y * np.cos(np.deg2rad(south))
            fields[:, member] += (
                0.15 * np.stack([psi_y, -psi_x])[:, None] * np.exp(-levels / decay)[:, None, None]
            )
    return as_forecast(fields, levels, latitude, longitude)


def as_forecast(velocity, levels, latitude, longitude, first=0) -> xr.Dataset:
    """A forecast's file of true components, shape (2, E, Z, J, I) [m/s]; its members are numbered from the first."""
    dims = ("member", "depth", "lat", "lon")
    return xr.Dataset(
        {
            name: (dims, part, {"standard_name": f"{way}ward_sea_water_velocity", "units": "m s-1"})
            for name, way, part in zip(("uo", "vo"), ("east", "north"), velocity, strict=True)
        },
        {
            "member": (
                "member",
                first + np.arange(len(velocity[0])),
                {"standard_name": "realization"},
            ),
            "depth": (
                "depth",
                levels,
                {"standard_name": "depth", "positive": "down", "units": "m"},
            ),
            "lat": ("lat", latitude, {"standard_name": "latitude", "units": "degrees_north"}),
            "lon": ("lon", longitude, {"standard_name": "longitude", "units": "degrees_east"}),
        },
    )


def write_ocean(folder: Path, n_members: int, shape=(6, 7)) -> None:
    """Write an ensemble, and a truth that is withheld from it, into a folder."""
    ds = dataset(seed=4, n_members=n_members + 1, shape=shape)
    ds.isel(member=slice(n_members)).to_netcdf(folder / "ensemble.nc", engine="scipy")
    ds.isel(member=n_members, drop=True).to_netcdf(folder / "truth.nc", engine="scipy")


def ensemble(seed=0, **options) -> Ensemble:
    """``dataset`` as the value that the forecast reader makes of it."""
    ds = dataset(seed, **options)
    return as_read(ds)


def as_read(ds) -> Ensemble:
    """A file of members as the value that the forecast reader makes of it."""
    axes, velocity = (ds["lon"].values, ds["lat"].values), [ds["uo"].values, ds["vo"].values]
    return in_local_frame(axes, ds["depth"].values, np.stack(velocity, axis=1))


def in_local_frame(axes, levels, velocity) -> Ensemble:
    """Members in water everywhere of true components, shape (E, 2, Z, J, I) [m/s], at longitudes and latitudes."""
    longitude, latitude = np.meshgrid(*axes)
    grid = local_grid(longitude, latitude, levels, np.ones(velocity.shape[2:], bool), None)
    turn = turn_to_local(grid.projection, longitude, latitude, "true")
    return Ensemble(grid, turned_velocity(velocity, turn), None, "synthetic")


def profile(grid, east, north, depth, velocity, std=0.05, time_ns=0, dive=0) -> Observation:
    """An observation of local velocities, shape (n, 2), under a local point."""
    longitude, latitude = to_geographic(grid.projection, east, north)
    u, v = rotate_to_geographic(
        grid.projection, longitude, latitude, velocity[:, 0], velocity[:, 1]
    )
    n = depth.size
    good, none = np.ones(n, np.int8), np.zeros(n, np.int32)
    source = Source(0, "/adcp", time_ns, time_ns)
    return Observation(
        time_ns,
        float(longitude),
        float(latitude),
        depth,
        np.column_stack([u, v]),
        np.full(n, std),
        "earth",
        good,
        none,
        dive,
        source,
    )


def random_profiles(grid, n, seed=0, std=0.05, speed=0.2) -> list[Observation]:
    """Profiles of pure noise at random points: what the update makes of them is linear algebra all the same."""
    rng = np.random.default_rng(seed)
    depth = 10.0 + 25.0 * np.arange(11)
    out = []
    for k in range(n):
        east = rng.uniform(0.8 * grid.east.min(), 0.8 * grid.east.max())
        north = rng.uniform(0.8 * grid.north.min(), 0.8 * grid.north.max())
        out.append(
            profile(
                grid,
                east,
                north,
                depth,
                speed * rng.standard_normal((depth.size, 2)),
                std,
                time_ns=k,
            )
        )
    return out
