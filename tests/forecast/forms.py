"""One known field in the forms in which producers write theirs; a form is a dataset, or several files' datasets."""

import numpy as np
import pytest
import xarray as xr
import zarr
from numpy.testing import assert_allclose

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.forecast import read_ensemble

LEVELS = np.array([5.0, 60.0, 150.0, 300.0])
N_MEMBERS = 3
_CMEMS = (
    {"standard_name": "eastward_sea_water_velocity"},
    {"standard_name": "northward_sea_water_velocity"},
)


def truth(longitude, latitude, depth, member=0):
    """East and north component [m/s] at points, smooth round the globe and different for each member."""
    x, y = np.deg2rad(52.0 * np.asarray(longitude)), 0.9 * np.asarray(latitude)
    decay = np.exp(-np.asarray(depth) / (200.0 + 60.0 * member))
    east = (0.25 * np.sin(x + 0.4 * member) * np.cos(y) + 0.05) * decay
    north = (0.2 * np.cos(x - y + 0.7 * member) - 0.03 * member) * decay
    return east, north


def regular(longitude, latitude, levels=LEVELS):
    """Components of all members on a separable grid, shape (E, Z, J, I)."""
    x, y = np.meshgrid(longitude, latitude)
    fields = [truth(x, y, levels[:, None, None], member) for member in range(N_MEMBERS)]
    return np.stack([field[0] for field in fields]), np.stack([field[1] for field in fields])


def lonlat(west=10.0, south=40.0, shape=(7, 8), step=0.1):
    return west + step * np.arange(shape[1]), south + step * np.arange(shape[0])


def standard(u, v, longitude, latitude, levels=LEVELS):
    """A file with members, depth, latitude and longitude."""
    dims = ("member", "depth", "latitude", "longitude")
    parts = zip(("uo", "vo"), (u, v), _CMEMS, strict=True)
    return xr.Dataset(
        {name: (dims, part, {"units": "m s-1", **own}) for name, part, own in parts},
        {
            "depth": ("depth", levels, {"units": "m", "positive": "down"}),
            "latitude": latitude,
            "longitude": longitude,
        },
    )


def known(at=None, levels=LEVELS):
    """The file of the known field on a separable grid."""
    at = lonlat() if at is None else at
    return standard(*regular(*at, levels), *at, levels=levels)


def in_turn(parts, times, dim="time", **attrs):
    """Return files of a CMEMS form, which arithmetic has robbed of their attributes, one after the other in time."""
    ds = xr.concat(
        parts, dim, data_vars="all", coords="minimal", compat="override", join="override"
    )
    for name, own in zip(("uo", "vo"), _CMEMS, strict=True):
        ds[name].attrs = {"units": "m s-1", **own}
    return ds.assign_coords({dim: (dim, times, attrs)})


def rotated(angle_deg=44.0, shape=(14, 16), cell=0.05):
    """Longitude and latitude at fractional indices of a grid turned against true east, and its angle there [radians]."""
    turn = np.exp(1j * np.deg2rad(angle_deg))

    def at(j, i):
        place = ((i - shape[1] / 2) + 1j * (j - shape[0] / 2)) * cell * turn
        latitude = 60.0 + place.imag
        return 5.0 + place.real / np.cos(np.deg2rad(latitude)), latitude

    return at


def along_grid(at, j, i, depth, member):
    """Components along the axes of a grid, which are found by differences over a thousandth of a cell, and true ones."""
    longitude, latitude = at(j, i)
    ahead = at(j, i + 1e-3)
    angle = np.arctan2(ahead[1] - latitude, (ahead[0] - longitude) * np.cos(np.deg2rad(latitude)))
    east, north = truth(longitude, latitude, depth, member)
    turned = (east + 1j * north) * np.exp(-1j * angle)
    return turned.real, turned.imag


_SPEED = {"units": "meter second-1"}


def roms(at, shape, member, transform=2, packed=False):
    """A ROMS file at one time: C-grid, terrain-following levels, mask, land in a corner; packed without a fill value if asked."""
    s = (np.arange(40) + 0.5) / 40 - 1.0
    c, hc = (1.0 - np.cosh(3.0 * s)) / (np.cosh(3.0) - 1.0), 20.0

    def bed(j, i):
        return 400.0 + 10.0 * i, 0.3 * np.sin(0.3 * j + member)

    def depths(j, i):
        (h, zeta), (s_, c_) = bed(j, i), (axis[:, None, None] for axis in (s, c))
        if transform == 1:
            z0 = hc * (s_ - c_) + c_ * h
            return -(z0 + zeta * (1.0 + z0 / h))
        return -(zeta + (zeta + h) * (hc * s_ + c_ * h) / (hc + h))

    j, i = np.mgrid[: float(shape[0]), : float(shape[1])]
    mask = np.ones(shape)
    mask[:4, :5] = 0.0
    faces = {"u": (np.s_[:, 1:], np.s_[:, :-1], 0.0, 0.5), "v": (np.s_[1:], np.s_[:-1], 0.5, 0.0)}
    (longitude, latitude), (h, zeta) = at(j, i), bed(j, i)
    rho, time = ("eta_rho", "xi_rho"), "ocean_time"
    held = {"zeta": ((time, *rho), zeta[None]), "Cs_r": ("s_rho", c), "hc": hc}
    centres = {"h": h, "mask_rho": mask, "lon_rho": longitude, "lat_rho": latitude}
    held |= {name: (rho, values) for name, values in centres.items()}
    held |= {"angle": (rho, np.full(shape, 0.5)), "Vtransform": transform}
    for k, (name, (here, before, dj, di)) in enumerate(faces.items()):
        places, plane = (j[here] - dj, i[here] - di), (f"eta_{name}", f"xi_{name}")
        along = along_grid(at, *places, depths(*places), member)[k]
        wet = mask[here] * mask[before]
        held[name] = (time, "s_rho", *plane), (along * wet)[None], _SPEED
        held[f"mask_{name}"] = plane, wet
        # some writers give these the standard names too, and some leave them 0
        for axis in ("longitude", "latitude"):
            held[f"{axis[:3]}_{name}"] = plane, 0.0 * wet, {"standard_name": axis}
    stamps = np.array(["2020-01-01"], "M8[ns]")
    ds = xr.Dataset(held, {"s_rho": ("s_rho", s), time: (time, stamps)})
    for name in faces if packed else ():
        # as NCO packs with a fill value that 16 bits cannot hold: land is 0, which stands for the offset
        values = ds[name].values
        numbers = np.where(values == 0.0, 0, np.round((values - 0.125) / 2e-5)).astype("i2")
        packing = {"scale_factor": 2e-5, "add_offset": 0.125}
        ds[name] = xr.Variable(ds[name].dims, numbers, _SPEED | packing)
    return ds.drop_vars([name for name in ds if "mask" in name]) if packed else ds, mask


_OF_NEMO = ("time_counter", "deptht", "y", "x")


def _store(path, **arrays):
    """A Zarr store of arrays by name: dimensions, shape and values; None for values that were never written and are read as 0."""
    group = zarr.open_group(path, mode="w", zarr_format=3)
    for name, (dims, shape, values) in arrays.items():
        chunks = tuple(min(size, 512) for size in shape)
        array = group.create_array(
            name, shape=shape, chunks=chunks, dtype="f4", fill_value=0.0, dimension_names=dims
        )
        array.attrs["units"] = (
            "m" if name == "deptht" else "m s-1" if name.startswith("vo") else "degrees"
        )
        if values is not None:
            array[...] = values
    return path


def unwritten_stores(folder, shape, longitude=None, latitude=None):
    """Stores of u, of v and of the mesh of NEMO without a value of any current: of some levels, rows and columns."""
    plane = _OF_NEMO[2:], shape[1:]
    levels = ("deptht",), shape[:1], 10.0 * np.arange(1.0, 1.0 + shape[0])
    own = {"deptht": levels, "nav_lon": (*plane, longitude), "nav_lat": (*plane, latitude)}
    currents = {"U": "vozocrtx", "V": "vomecrty"}
    stores = [
        _store(folder / f"{part}.zarr", **{name: (_OF_NEMO, (1, *shape), None)}, **own)
        for part, name in currents.items()
    ]
    return [*stores, _store(folder / "mesh.zarr", glamt=own["nav_lon"], gphit=own["nav_lat"])]


def read_with(paths, near_ns=None, **settings):
    """Return the ensemble read with some settings of ``[forecast]``."""
    return read_ensemble(paths, ForecastConfig(**settings), near_ns=near_ns)


def refused(message, paths, **settings):
    """Assert that files are refused with a message."""
    with pytest.raises(ForecastError, match=message):
        read_with(paths, **settings)


def noted(read, words):
    """Return whether any note of an ensemble has some words."""
    return any(words in note for note in read.notes)


def true_components(read):
    return rotate_to_geographic(
        read.grid.projection,
        read.grid.longitude,
        read.grid.latitude,
        read.velocity[:, 0],
        read.velocity[:, 1],
    )


def assert_comes_back(read, atol, n_members=N_MEMBERS, at=np.s_[:]):
    """Every wet node of every member, or some of them, has the known field, true east and north."""
    assert read.n_members == n_members
    found, wet = true_components(read), read.grid.wet[at]
    assert wet.any()
    for member in range(n_members):
        depth = read.grid.levels[:, None, None]
        known = truth(read.grid.longitude, read.grid.latitude, depth, member)
        for component, expected in zip(found, known, strict=True):
            assert_allclose(component[member][at][wet], expected[at][wet], atol=atol)


def save(ds, path, **encoding):
    """Write NetCDF-3, as models do: it opens many times sooner than NetCDF-4, which `test_reads_every_container_alike` has."""
    ds.to_netcdf(path, engine="scipy", encoding=encoding or None)
    return path


def saved(files, folder):
    """Write datasets by name, or one alone, into a folder, and return it."""
    for name, ds in {"e.nc": files}.items() if isinstance(files, xr.Dataset) else files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        save(ds, folder / name)
    return folder


def row(files, words, **settings):
    """Return files, words that are said of them, and settings as parameters of a test."""
    return files, words, settings


def dated(ds, times):
    """Return a dataset at some times."""
    return ds.expand_dims(time=np.array(times, "M8[ns]"))
