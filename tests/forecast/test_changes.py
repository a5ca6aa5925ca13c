"""One known field comes back whatever its file's form: forty changes of dimensions, names, units and container, several at once."""

import gsw
import numpy as np
import pytest
from numpy.testing import assert_allclose

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast import read_series
from tests.forecast import forms
from tests.forecast.forms import LEVELS, assert_comes_back, noted

SPACE = ("latitude", "longitude")
START = np.datetime64("2020-01-03", "ns")
# Of these a user is told.
TOLD = {
    "no unit": "states no unit, metres assumed",
    "pressures": "is in dbar: converted to metres with TEOS-10",
    "seconds since, of 365 days": "calendar NOLEAP",
    "not declared": "beyond 1000 m/s",
    "a direction": "components computed of speed and angle",
}
# m/s, of values of some 0.3 m/s
ROUNDING = {"double": 1e-12, "single": 1e-7, "packed": 3e-5}


def scaled(axis, factor, **attrs):
    """Return the change of an axis to another unit."""

    def change(ds):
        values = ds[axis].values * (
            factor if np.ndim(factor) == 0 or ds[axis][0] == LEVELS[0] else factor[::-1]
        )
        return ds.assign_coords({axis: (axis, values, {**ds[axis].attrs, **attrs})})

    return change


def in_pressure(sign, **attrs):
    """Return the change of depths to pressures in the middle of the grid."""
    return scaled("depth", sign * gsw.p_from_z(-LEVELS, 40.3) / LEVELS, **attrs)


def flipped(axis):
    return lambda ds: ds.isel({axis: slice(None, None, -1)})


def moved(turns):
    return lambda ds: ds.assign_coords(longitude=ds["longitude"] + 360.0 * turns)


def renamed(u, v, keeps_standard_names=False):
    """Return the change of the components' names."""

    def change(ds):
        ds = ds.rename(uo=u, vo=v)
        if not keeps_standard_names:
            for name in (u, v):
                del ds[name].attrs["standard_name"]
        return ds

    return change


def in_unit(unit, of_one):
    """Return the change of the components' unit."""

    def change(ds):
        return ds.assign(
            {name: (of_one * ds[name]).assign_attrs(ds[name].attrs, units=unit) for name in _uv(ds)}
        )

    return change


def _uv(ds):
    return [name for name in ds.data_vars if ds[name].ndim > 3]


def on_planes(longitude, latitude):
    """Return the change to coordinates of two dimensions."""

    def change(ds):
        x, y = np.meshgrid(ds["longitude"].values, ds["latitude"].values)
        ds = ds.drop_vars(SPACE).rename(latitude="y", longitude="x")
        return ds.assign_coords({longitude: (("y", "x"), x), latitude: (("y", "x"), y)})

    return change


def as_speed(way, turn):
    """Return the change to a speed and a direction."""

    def change(ds):
        u, v = (ds[name] for name in _uv(ds))
        speed = {"standard_name": "sea_water_speed", "units": u.attrs["units"]}
        angle = {"standard_name": f"sea_water_velocity_{way}_direction"}
        return ds.drop_vars(_uv(ds)).assign(
            speed=np.hypot(u, v).assign_attrs(speed),
            angle=(np.rad2deg(np.arctan2(u, v)) + turn).assign_attrs(angle),
        )

    return change


def dated(unit, length, **attrs):
    """Return the change to one time, stated in a unit since two days before."""

    def change(ds):
        about = {"units": f"{unit} since 2020-01-01", **attrs}
        return ds.expand_dims(time=1, axis=1).assign_coords(time=("time", [2.0 * length], about))

    return change


def at_lead(unit, length):
    """Return the change to one lead after a stated reference time."""

    def change(ds):
        about = {"standard_name": "forecast_period", "units": unit}
        start = {"standard_name": "forecast_reference_time", "units": "hours since 2020-01-01"}
        ds = ds.expand_dims(lead=1, axis=0).assign_coords(lead=("lead", [2.0 * length], about))
        return ds.assign_coords(reference=((), 0.0, start))

    return change


def members_of(name, **attrs):
    """Return the change of the members' dimension."""

    def change(ds):
        ds = ds.rename(member=name)
        return ds.assign_coords({name: (name, np.arange(forms.N_MEMBERS), attrs)} if attrs else {})

    return change


UNCHANGED = {"as it is": lambda ds: ds}
# One of each is taken.
CHANGES = [
    UNCHANGED
    | {
        "cm/s": in_unit("cm s-1", 100.0),
        "centimeter/s": in_unit("centimeter/s", 100.0),
        "knots": in_unit("knots", 3600.0 / 1852.0),
    },
    UNCHANGED
    | {
        "water_u": renamed("water_u", "water_v"),
        "u": renamed("u", "v"),
        "ucur": renamed("ucur", "vcur"),
        "standard names alone": renamed("odd", "names", True),
        "standard names against short ones": renamed("v", "u", True),
        "a direction": as_speed("to", 0.0),
        "a direction from": as_speed("from", 180.0),
    },
    UNCHANGED | {"the deepest first": flipped("depth")},
    UNCHANGED | {"from the north": flipped("latitude")},
    UNCHANGED
    | {
        "kilometres": scaled("depth", 1e-3, units="Kilometre"),
        "feet": scaled("depth", 1.0 / 0.3048, units="feet"),
        "upwards": scaled("depth", -1.0, units=" m ", positive="up"),
        "heights": scaled("depth", -1.0, units="m", standard_name="height"),
        "no unit": scaled("depth", 1.0, units=""),
        "pressures": in_pressure(1.0, units="dbar", positive="down"),
        "pressures upwards": in_pressure(-1.0, units="decibars", positive="up"),
        "elevation": lambda ds: scaled("depth", -1.0, standard_name="elevation")(ds).rename(
            depth="elevation"
        ),
        "st_ocean": lambda ds: ds.rename(depth="st_ocean"),
    },
    UNCHANGED | {"a turn on": moved(1), "a turn back": moved(-1)},
    UNCHANGED
    | {
        "NEMO": on_planes("nav_lon", "nav_lat"),
        "POP": on_planes("ULON", "ULAT"),
        "longitude on a plane": on_planes("longitude", "latitude"),
        "lon": lambda ds: ds.rename(latitude="lat", longitude="lon"),
    },
    UNCHANGED
    | {
        "days since": dated("days", 1.0),
        "hours since": dated("hours", 24.0),
        "seconds since, of 365 days": dated("seconds", 86400.0, calendar="NOLEAP"),
        "a lead in days": at_lead("days", 1.0),
        "a lead in minutes": at_lead("minutes", 1440.0),
    },
    UNCHANGED
    | {
        "ens": members_of("ens"),
        "number": members_of("number"),
        "Ensemble": members_of("Ensemble"),
        "axis E": members_of("runs", axis="E"),
        "realization": members_of("of", standard_name="realization"),
    },
    UNCHANGED
    | {
        "members last": lambda ds: ds.transpose(
            ..., _uv(ds)[0] and next(iter(ds[_uv(ds)[0]].dims))
        ),
        "turned round": lambda ds: ds.transpose(*ds[_uv(ds)[0]].dims[::-1]),
    },
]
CONTAINERS = (
    "NetCDF-3",
    "NetCDF-4",
    "NetCDF-4 in chunks",
    "Zarr 2",
    "Zarr 3",
    "a file a member",
    "u and v apart",
)


def written(ds, container, precision, folder):
    """Write a dataset in one of the containers; return what is read."""
    dtype = {"packed": "int16", "single": "float32"}.get(precision, "float64")
    encoding = {name: {"dtype": dtype} for name in _uv(ds)}
    for name in _uv(ds) if precision == "packed" else ():
        scale = float(abs(ds[name]).max()) / 32_000
        encoding[name] |= {"scale_factor": scale, "add_offset": 0.0, "_FillValue": -32767}
    if container.startswith("Zarr"):
        ds.to_zarr(
            folder / "e.zarr", zarr_format=int(container[-1]), encoding=encoding, consolidated=False
        )
        return folder / "e.zarr"
    if container == "NetCDF-4 in chunks":
        for name in _uv(ds):
            chunks = tuple(max(1, size // 2) for size in ds[name].shape)
            encoding[name] |= {"zlib": True, "complevel": 1, "chunksizes": chunks}
    engine = "h5netcdf" if "4" in container else "scipy"
    parts = {"e.nc": ds}
    if container == "a file a member":
        (member,) = (dim for dim in ds.dims if ds.sizes[dim] == forms.N_MEMBERS)
        parts = {f"mem{k:03d}.nc": ds.isel({member: k}, drop=True) for k in range(forms.N_MEMBERS)}
    elif container == "u and v apart" and "angle" not in ds:
        u, v = _uv(ds)
        parts = {"x_U.nc": ds.drop_vars(v), "x_V.nc": ds.drop_vars(u)}
    for name, part in parts.items():
        own = {key: value for key, value in encoding.items() if key in part}
        part.to_netcdf(folder / name, engine=engine, encoding=own)
    return folder


# What stands for it in a corner of the grid.
LAND = {"none": None, "missing": np.nan, "zero": 0.0, "not declared": 1e30}


# Of each change every choice, each with others in each row; also over the antimeridian and that of Greenwich.
ROWS = [
    (
        tuple(
            sorted(some)[(number + step * (number // len(some))) % len(some)]
            for step, some in enumerate(CHANGES)
        ),
        CONTAINERS[number % len(CONTAINERS)],
        sorted(ROUNDING)[number % 3],
        sorted(LAND)[number // 3 % 4],
        (10.0, 179.75, 359.65)[number // 2 % 3],
    )
    for number in range(40)
]


@pytest.mark.parametrize(("chosen", "container", "precision", "land", "west"), ROWS)
def test_a_known_field_comes_back_from_any_form(tmp_path, chosen, container, precision, land, west):
    if precision == "packed" and land == "not declared":
        land = "missing"
    longitude, latitude = forms.lonlat(west)
    at = (longitude + 180.0) % 360.0 - 180.0, latitude
    ds = forms.known(at).assign_coords(longitude=longitude)
    if land != "none":
        for name in ("uo", "vo"):
            ds[name][..., :2, :3] = LAND[land]
    for choices, name in zip(CHANGES, chosen, strict=True):
        ds = choices[name](ds)
    path = written(ds, container, precision, tmp_path)
    (read,) = read_series(path, ForecastConfig(axes="true"))
    assert_comes_back(read, ROUNDING[precision])
    assert_allclose(read.grid.levels, LEVELS, rtol=1e-9)
    assert read.grid.wet.sum() == LEVELS.size * (56 - 6 * (land != "none"))
    if any(" since" in name or "lead" in name for name in chosen):
        assert read.time_ns == START.astype(np.int64)
    for name, words in TOLD.items():
        assert noted(read, words) or name not in (*chosen, land)
