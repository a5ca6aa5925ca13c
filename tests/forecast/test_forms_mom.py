"""One known field as MOM6 and MOM5 write it, with their files of the grid, which is turned by 44 degrees."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast.describe import describe_ensemble
from tests.forecast import forms
from tests.forecast.forms import (
    LEVELS,
    N_MEMBERS,
    assert_comes_back,
    read_with,
    save,
)

SHAPE = (10, 12)
AT = forms.rotated(shape=SHAPE, cell=0.01)
ROW, COLUMN = np.meshgrid(np.arange(float(SHAPE[0])), np.arange(float(SHAPE[1])), indexing="ij")
WET = np.ones((LEVELS.size, *SHAPE))
WET[:, :3, :4] = 0.0
WET[3, :, -3:] = 0.0
# The known field is turned by angles on a sphere: on the ellipsoid they differ by 0.8 mrad, of 0.3 m/s.
ANGLE_ERROR = 3e-4
ATTRS = (
    {"standard_name": "sea_water_x_velocity", "units": "m s-1"},
    {"standard_name": "sea_water_y_velocity", "units": "m s-1"},
)
TIMES = np.array(["2020-01-01", "2020-01-06", "2020-01-11"], "M8[ns]")


def component(k, j, i, wet):
    """A component along the grid at fractional indices, of all members, missing on land."""
    fields = [
        forms.along_grid(AT, j, i, LEVELS[:, None, None], member)[k] for member in range(N_MEMBERS)
    ]
    return np.where(wet > 0.0, np.stack(fields), np.nan)


def shores():
    """Wet faces of u and of v, west and south of the first cell too, where the land of the first cell goes on."""
    u, v = (
        np.pad(WET, ((0, 0), (0, 0), (1, 1)), mode="edge"),
        np.pad(WET, ((0, 0), (1, 1), (0, 0)), mode="edge"),
    )
    return u[..., 1:] * u[..., :-1], v[:, 1:] * v[:, :-1]


def mom6(symmetric):
    """Currents on the faces of a C-grid: with those west and south of the first cells, or without."""
    from_first = 0 if symmetric else 1
    at_u = [np.pad(axis, ((0, 0), (1, 0)), mode="edge") for axis in (ROW, COLUMN)]
    at_u[1] = np.arange(-0.5, SHAPE[1]) + 0.0 * at_u[0]
    at_v = [
        np.arange(-0.5, SHAPE[0])[:, None] + np.zeros((1, SHAPE[1])),
        np.pad(COLUMN, ((1, 0), (0, 0)), mode="edge"),
    ]
    wet_u, wet_v = shores()
    u, v = (
        component(0, *at_u, wet_u)[..., from_first:],
        component(1, *at_v, wet_v)[:, :, from_first:],
    )
    coordinates = {
        "z_l": ("z_l", LEVELS, {"units": "meters", "positive": "down"}),
        "time": TIMES,
        # nominal, of the grid's middle: no places of a turned grid
        "xh": np.arange(SHAPE[1]) + 0.5,
        "yh": np.arange(SHAPE[0]) + 0.5,
        "xq": np.arange(from_first, SHAPE[1] + 1.0),
        "yq": np.arange(from_first, SHAPE[0] + 1.0),
    }
    current = {
        "uo": (("time", "z_l", "yh", "xq"), u, ATTRS[0]),
        "vo": (("time", "z_l", "yq", "xh"), v, ATTRS[1]),
    }
    ds = xr.Dataset(current, coordinates)
    wets = {
        "wet": (("yh", "xh"), WET[0]),
        "wet_u": (("yh", "xq"), wet_u[0][:, from_first:]),
        "wet_v": (("yq", "xh"), wet_v[0][from_first:]),
    }
    return ds, xr.Dataset(wets)


def supergrid():
    """``ocean_hgrid.nc``: corners, faces and centres of the cells in one array."""
    j, i = np.meshgrid(
        np.arange(-0.5, SHAPE[0], 0.5), np.arange(-0.5, SHAPE[1], 0.5), indexing="ij"
    )
    x, y = AT(j, i)
    angle = np.full(x.shape, 44.0)
    return xr.Dataset(
        {
            name: (("nyp", "nxp"), values)
            for name, values in (("x", x), ("y", y), ("angle_dx", angle))
        }
    )


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("grid", ["static", "supergrid"])
def test_mom6_in_a_file_of_currents_and_one_of_the_grid(tmp_path, grid, symmetric):
    ds, masks = mom6(symmetric)
    longitude, latitude = AT(ROW, COLUMN)
    static = masks.assign(
        geolon=(("yh", "xh"), longitude),
        geolat=(("yh", "xh"), latitude),
        cos_rot=(("yh", "xh"), np.cos(0.7 + 0.0 * ROW)),
    )
    fill = {"_FillValue": 1e20}
    paths = [save(ds, tmp_path / "ocean_daily.nc", uo=fill, vo=fill)]
    paths += [
        save(
            static if grid == "static" else supergrid(),
            tmp_path / f"ocean_{'static' if grid == 'static' else 'hgrid'}.nc",
        )
    ]
    found = describe_ensemble(paths, ForecastConfig(members="dim:time"))
    assert found.names == ("uo", "vo")
    assert [path.name for path in found.grids] == [paths[1].name]
    assert found.check.axes == "grid"
    read = found.ensemble
    first = 0 if symmetric else 1
    # a cell is water where one of its faces is; cells of land have none
    wet = WET[:, first:, first:] > 0.0
    assert_allclose(read.grid.longitude, longitude[first:, first:], atol=1e-12)
    assert_allclose(read.grid.latitude, latitude[first:, first:], atol=1e-12)
    assert_array_equal(read.grid.wet, wet)
    # away from land, where one face stands for two
    assert_comes_back(read, ANGLE_ERROR, at=np.s_[:3, 4:, 5:-1])


def test_mom5_at_the_corners_that_the_supergrid_has(tmp_path):
    """On a B-grid both components lie at the north-eastern corner of their cell."""
    ds = xr.Dataset(
        {
            "u": (
                ("time", "st_ocean", "yu_ocean", "xu_ocean"),
                component(0, ROW + 0.5, COLUMN + 0.5, WET),
                ATTRS[0],
            ),
            "v": (
                ("time", "st_ocean", "yu_ocean", "xu_ocean"),
                component(1, ROW + 0.5, COLUMN + 0.5, WET),
                ATTRS[1],
            ),
        },
        {
            "st_ocean": ("st_ocean", LEVELS, {"units": "meters", "positive": "down"}),
            "time": TIMES,
            "xu_ocean": np.arange(SHAPE[1]) + 1.0,
            "yu_ocean": np.arange(SHAPE[0]) + 1.0,
        },
    )
    paths = [save(ds, tmp_path / "ocean.nc"), save(supergrid(), tmp_path / "ocean_hgrid.nc")]
    read = read_with(paths, members="dim:time")
    longitude, latitude = AT(ROW + 0.5, COLUMN + 0.5)
    assert_allclose(read.grid.longitude, longitude, atol=1e-12)
    assert_allclose(read.grid.latitude, latitude, atol=1e-12)
    assert_array_equal(read.grid.wet, WET > 0.0)
    assert_comes_back(read, ANGLE_ERROR)
