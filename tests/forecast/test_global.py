"""Grids that go round the globe: windows over the seam and over the antimeridian, on A- and C-grids, with and without repeated columns."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.forecast.grids.horizontal import columns_round
from tests.forecast.forms import read_with, save, true_components

LEVELS = np.array([5.0, 100.0])
LATITUDE = np.arange(40.0, 47.0)
# the seam lies at 73 E, as in ORCA grids
SEAM = 73.0
MEMBERS = 2


def current(longitude, latitude, member, middle):
    """East and north component [m/s], linear about a meridian, so that the mean of two faces is the value between them."""
    x = (np.asarray(longitude) - middle + 180.0) % 360.0 - 180.0
    return 0.1 + 0.01 * x + 0.002 * (latitude - 43.0) + 0.02 * member, -0.1 + 0.005 * x - 0.003 * (
        latitude - 43.0
    ) - 0.01 * member


def fields(component, longitude, latitude, middle, wet):
    """A component of all members at all levels, zero on land, shape (E, Z, J, I)."""
    return np.stack(
        [
            np.broadcast_to(
                current(longitude, latitude, k, middle)[component] * wet, (2, *wet.shape)
            )
            for k in range(MEMBERS)
        ]
    )


def orca(folder, middle, repeated=2):
    """Files of u, v and the mesh of a NEMO grid of one degree round the globe, whose first columns are repeated at its end."""
    i = np.arange(360 + repeated) % 360
    longitude, latitude = np.meshgrid((SEAM + i + 180.0) % 360.0 - 180.0, LATITUDE)
    wet = np.ones(longitude.shape)
    # land two columns after the seam
    wet[3, i == 2] = 0.0
    times = np.array(["2020-01-01", "2020-01-06"], "M8[ns]")
    paths = []
    for k, (name, di, dj) in enumerate((("uo", 0.5, 0.0), ("vo", 0.0, 0.5))):
        shore = wet * (np.roll(wet, -1, axis=1) if k == 0 else np.vstack([wet[1:], wet[-1:]]))
        # the last columns' neighbours are those after the repeated ones
        shore[:, 360:] = shore[:, :repeated]
        place = np.stack([longitude + di, latitude + dj])
        paths.append(
            save(
                xr.Dataset(
                    {
                        name: (
                            ("time_counter", f"depth{'uv'[k]}", "y", "x"),
                            fields(k, *place, middle, shore),
                            {"units": "m/s"},
                        )
                    },
                    {
                        f"depth{'uv'[k]}": (
                            f"depth{'uv'[k]}",
                            LEVELS,
                            {"units": "m", "positive": "down"},
                        ),
                        "nav_lon": (("y", "x"), (place[0] + 180.0) % 360.0 - 180.0),
                        "nav_lat": (("y", "x"), place[1]),
                        "time_counter": times,
                    },
                ),
                folder / f"x_{'UV'[k]}.nc",
            )
        )
    mesh = {"glamt": longitude, "gphit": latitude, "tmask": wet}
    return [
        *paths,
        save(
            xr.Dataset({name: (("y", "x"), values) for name, values in mesh.items()}),
            folder / "mesh.nc",
        ),
    ]


def assert_known(read, middle):
    """Away from the edge, where the axes are known by differences to both sides, the current is the known one."""
    u, v = true_components(read)
    inner = np.s_[..., 1:-1, 1:-1]
    for member in range(MEMBERS):
        east, north = current(read.grid.longitude, read.grid.latitude, member, middle)
        wet = np.broadcast_to(read.grid.wet, u[member].shape)[inner]
        assert_allclose(
            u[member][inner][wet], np.broadcast_to(east, u[member].shape)[inner][wet], atol=6e-4
        )
        assert_allclose(
            v[member][inner][wet], np.broadcast_to(north, v[member].shape)[inner][wet], atol=6e-4
        )


@pytest.mark.parametrize("repeated", [2, 0])
@pytest.mark.parametrize("middle", [SEAM, 180.0])
def test_a_c_grid_over_the_seam_and_over_the_antimeridian(tmp_path, middle, repeated):
    files = orca(tmp_path, middle, repeated)
    west, east = ((middle + side + 180.0) % 360.0 - 180.0 for side in (-4.2, 5.2))
    read = read_with(files, members="dim:time_counter", region=(west, 40.8, east, 45.2))
    assert_allclose(
        (read.grid.longitude[0] - middle + 180.0) % 360.0 - 180.0, np.arange(-4.0, 6.0), atol=1e-9
    )
    assert_allclose(read.grid.latitude[:, 0], np.arange(41.0, 46.0))
    wet = np.ones((5, 10), bool)
    # 43 N, 75 E; beside it one face stands for two
    wet[2, 6] = middle != SEAM
    assert_array_equal(read.grid.wet, np.stack([wet, wet]))
    u, _ = true_components(read)
    if middle == SEAM:
        # west of the land: u is that of the western face alone, half a cell away
        east = current(middle + 0.5, 43.0, 0, middle)[0]
        assert u[0, 0, 2, 5] == pytest.approx(east, abs=6e-4)
        read.grid.wet[:, :, 5:8] &= np.arange(5)[:, None] != 2
        read.grid.wet[:, [1, 3], 6] = False
    assert_known(read, middle)


def test_without_a_region_each_column_is_read_once_and_has_both_faces(tmp_path):
    read = read_with(orca(tmp_path, 0.0), members="dim:time_counter")
    assert read.grid.longitude.shape == (6, 360)
    speed = np.hypot(read.velocity[0, 0], read.velocity[0, 1])
    first = np.hypot(*current(SEAM, LATITUDE[1:], 0, 0.0))
    # of the first column, whose western face is the last column's
    assert_allclose(speed[0, :2, 0], first[:2], atol=3e-3)


@pytest.mark.parametrize("faces", ["west", "west and east"])
def test_faces_west_of_the_centres(tmp_path, faces):
    """MITgcm has as many faces as centres, the first of them the last one's eastern face; symmetric MOM6 has it twice."""
    i, more = np.arange(360), faces == "west and east"
    at_u = SEAM - 0.5 + np.arange(361 if more else 360)
    wet = np.ones((LATITUDE.size, 360))
    shape = np.ones((LATITUDE.size, at_u.size))
    at_v = LATITUDE - 0.5
    ds = xr.Dataset(
        {
            "UVEL": (
                ("member", "Z", "YC", "XG"),
                fields(0, at_u, LATITUDE[:, None], SEAM, shape),
                {"units": "m/s"},
            ),
            "VVEL": (
                ("member", "Z", "YG", "XC"),
                fields(1, SEAM + i, at_v[:, None], SEAM, wet),
                {"units": "m/s"},
            ),
        },
        {
            "Z": ("Z", -LEVELS, {"units": "m"}),
            "XC": SEAM + i,
            "YC": LATITUDE,
            "XG": at_u,
            "YG": at_v,
        },
    )
    region = (SEAM - 3.2, 40.8, SEAM + 2.2, 45.2)
    read = read_with(save(ds, tmp_path / "e.nc"), region=region)
    assert_allclose(read.grid.longitude[0], SEAM + np.arange(-3.0, 3.0))
    assert_known(read, SEAM)


@pytest.mark.parametrize(
    ("longitude", "count"),
    [
        (np.arange(0.0, 360.0, 5.0), 72),
        (np.arange(0.0, 366.0, 5.0) % 360.0, 72),
        (np.arange(180.0, -180.0, -5.0), 72),
        (np.arange(0.0, 354.0, 5.0), None),
        (np.array([10.0, 10.1, 10.2]), None),
        (np.tile(np.arange(0.0, 361.0, 5.0), (3, 1)), 72),
    ],
)
def test_how_many_columns_go_round(longitude, count):
    assert columns_round(longitude) == count
