"""Each producer's form of one known field: it comes back on true axes, to the precision of its packing, with land where it was."""

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from tests.forecast import forms
from tests.forecast.forms import (
    LEVELS,
    N_MEMBERS,
    assert_comes_back,
    noted,
    read_with,
    refused,
    save,
)


def test_grep_members_by_suffix_without_their_mean(tmp_path):
    longitude, latitude = forms.lonlat()
    u, v = forms.regular(longitude, latitude)
    ds = xr.Dataset(
        coords={
            "depth": ("depth", LEVELS, {"units": "m"}),
            "latitude": latitude,
            "longitude": longitude,
        }
    )
    for k, name in enumerate(("glor", "oras", "cglo")):
        for prefix, part, attrs in (("uo", u, forms._CMEMS[0]), ("vo", v, forms._CMEMS[1])):
            ds[f"{prefix}_{name}"] = (
                ("depth", "latitude", "longitude"),
                part[k],
                {"units": "m s-1", **attrs},
            )
    for name in ("mean", "std"):
        ds[f"uo_{name}"], ds[f"vo_{name}"] = 5.0 * ds["uo_glor"], 5.0 * ds["vo_glor"]
    path = save(ds, tmp_path / "grep.nc")
    for rule in (None, "suffix"):
        read = read_with(path, members=rule)
        assert_comes_back(read, 1e-12)
        assert read.members == ("grep.nc glor", "grep.nc oras", "grep.nc cglo")


def test_topaz_on_polar_stereographic_axes(tmp_path):
    import pyproj

    crs = pyproj.CRS.from_cf(
        {
            "grid_mapping_name": "polar_stereographic",
            "latitude_of_projection_origin": 90.0,
            "straight_vertical_longitude_from_pole": -45.0,
            "standard_parallel": 90.0,
        }
    )
    back = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)

    def at(j, i):
        return back.transform(12.5e3 * (np.asarray(i) + 20.0), 12.5e3 * (np.asarray(j) - 90.0))

    j, i = np.meshgrid(np.arange(12.0), np.arange(14.0), indexing="ij")
    longitude, latitude = at(j, i)
    fields = [
        forms.along_grid(at, j, i, LEVELS[:, None, None], member) for member in range(N_MEMBERS)
    ]
    dims, space = ("member", "depth", "y", "x"), ("y", "x")
    ds = xr.Dataset(
        {
            "vxo": (
                dims,
                np.stack([field[0] for field in fields]),
                {"standard_name": "sea_water_x_velocity", "units": "m s-1"},
            ),
            "vyo": (
                dims,
                np.stack([field[1] for field in fields]),
                {"standard_name": "sea_water_y_velocity", "units": "m s-1"},
            ),
            "stereographic": (
                (),
                0,
                {key: value for key, value in crs.to_cf().items() if key != "crs_wkt"},
            ),
        },
        {
            "depth": ("depth", LEVELS, {"units": "m"}),
            "x": ("x", 12.5 * (np.arange(14) + 20.0), {"units": "km"}),
            "y": ("y", 12.5 * (np.arange(12) - 90.0), {"units": "km"}),
        },
    )
    with_coordinates = ds.assign_coords(longitude=(space, longitude), latitude=(space, latitude))
    for k, form in enumerate((with_coordinates, ds)):
        # the axis of a cell at the edge is known half a cell away
        assert_comes_back(read_with(save(form, tmp_path / f"{k}.nc")), 2e-3)


@pytest.mark.parametrize("one_dimension", [True, False])
def test_mitgcm_faces_west_and_south_of_centres(tmp_path, one_dimension):
    step, shape = 0.02, (9, 11)
    longitude, latitude = forms.lonlat(10.0, 40.0, shape, step)
    u, _ = forms.regular(longitude - step / 2, latitude)
    _, v = forms.regular(longitude, latitude - step / 2)
    wet = np.ones((LEVELS.size, *shape))
    wet[:, :3, :4] = 0.0
    wet[3, :, -3:] = 0.0
    west, south = wet.copy(), wet.copy()
    west[:, :, 1:] *= wet[:, :, :-1]
    south[:, 1:] *= wet[:, :-1]
    ds = xr.Dataset(
        {
            "UVEL": (("member", "Z", "YC", "XG"), u * west, {"units": "m/s"}),
            "VVEL": (("member", "Z", "YG", "XC"), v * south, {"units": "m/s"}),
            "hFacC": (("Z", "YC", "XC"), wet),
            "hFacW": (("Z", "YC", "XG"), west),
            "hFacS": (("Z", "YG", "XC"), south),
        },
        {
            "Z": ("Z", -LEVELS, {"units": "m"}),
            "XG": longitude - step / 2,
            "YG": latitude - step / 2,
        },
    )
    x, y = np.meshgrid(longitude, latitude)
    if one_dimension:
        ds = ds.assign_coords(XC=longitude, YC=latitude)
    else:
        ds = ds.rename(XC="i", YC="j").assign(XC=(("j", "i"), x), YC=(("j", "i"), y))
    read = read_with(save(ds, tmp_path / "e.nc"))
    # between faces 0.02 degrees apart the mean misses by (0.9 x 0.01)^2 / 2 of 0.3 m/s; next to land by one side's slope
    assert_array_equal(read.grid.wet, wet[:, :-1, :-1] > 0.0)
    assert_comes_back(read, 5e-5, at=np.s_[:3, 4:, 5:7])


def nemo(shape=(10, 12), mask=True):
    """Files of u, v and the grid of NEMO, at 44 degrees, in which names of dimensions and coordinates are the same for u and v."""
    at = forms.rotated(shape=shape, cell=0.01)
    j, i = np.meshgrid(np.arange(float(shape[0])), np.arange(float(shape[1])), indexing="ij")
    wet = np.ones(shape)
    wet[:3, :4] = 0.0
    files = []
    for k, (name, dj, di, face) in enumerate(
        (("uo", 0.0, 0.5, wet[:, 1:] * wet[:, :-1]), ("vo", 0.5, 0.0, wet[1:] * wet[:-1]))
    ):
        fields = [
            forms.along_grid(at, j + dj, i + di, LEVELS[:, None, None], member)[k]
            for member in range(N_MEMBERS)
        ]
        faces = np.pad(
            face, ((0, shape[0] - face.shape[0]), (0, shape[1] - face.shape[1])), mode="edge"
        )
        longitude, latitude = at(j + dj, i + di)
        depth = f"depth{'uv'[k]}"
        files.append(
            xr.Dataset(
                {
                    name: (
                        ("time_counter", depth, "y", "x"),
                        np.stack(fields) * faces,
                        {"units": "m/s"},
                    )
                },
                {
                    depth: (depth, LEVELS, {"units": "m", "positive": "down"}),
                    "nav_lon": (("y", "x"), longitude, {"standard_name": "longitude"}),
                    "nav_lat": (("y", "x"), latitude, {"standard_name": "latitude"}),
                    "time_counter": np.array(["2020-01-01", "2020-01-06", "2020-01-11"], "M8[ns]"),
                },
            )
        )
    longitude, latitude = at(j, i)
    grid = xr.Dataset(
        {
            "glamt": (("time", "y", "x"), longitude[None]),
            "gphit": (("time", "y", "x"), latitude[None]),
        }
    )
    if mask:
        grid["tmask"] = (
            ("time", "z", "y", "x"),
            np.broadcast_to(wet, (1, LEVELS.size, *shape)).copy(),
        )
    return files, grid, wet


@pytest.mark.parametrize("grid_file", [True, False])
def test_nemo_in_files_of_u_and_v_and_the_grid(tmp_path, grid_file):
    (u, v), grid, wet = nemo()
    paths = [save(u, tmp_path / "x_U.nc"), save(v, tmp_path / "x_V.nc")] + (
        [save(grid, tmp_path / "mesh.nc")] if grid_file else []
    )
    read = read_with(paths, members="dim:time_counter")
    assert_array_equal(read.grid.wet[0], wet[1:, 1:] > 0.0)
    # turned by angles on a sphere, which differ by 0.8 mrad from those on the ellipsoid, of 0.3 m/s
    assert_comes_back(read, 3e-4, at=np.s_[:, 3:, 4:])
    told = noted(read, "midway between the points of u")
    assert told is not grid_file


def test_enkf_c_a_file_for_each_member_and_variable_with_the_grid_apart(tmp_path):
    longitude, latitude = forms.lonlat()
    u, v = forms.regular(longitude, latitude)
    counts = np.full(u.shape[-2:], 4)
    counts[2, 3], counts[0, 0] = 2, 0
    grid = xr.Dataset(
        {
            "lon": ("i", longitude),
            "lat": ("j", latitude),
            "zt": ("k", LEVELS, {"units": "meters", "positive": "down"}),
        }
        | {"num_levels": (("j", "i"), counts), "depth_t": (("j", "i"), 100.0 * counts)}
    )
    save(grid, tmp_path / "grid_spec.nc")
    for member in range(N_MEMBERS):
        for name, part in (("u", u), ("v", v)):
            variable = xr.Dataset({name: (("k", "j", "i"), part[member], {"units": "m/s"})})
            save(variable, tmp_path / f"mem{member + 1:03d}_{name}.nc")
            save(variable * 9.0, tmp_path / f"mem{member + 1:03d}_{name}.nc.analysis")
    read = read_with(tmp_path)
    assert_comes_back(read, 1e-12)
    assert read.members == tuple(f"mem{k:03d}_u.nc + mem{k:03d}_v.nc" for k in (1, 2, 3))
    assert_array_equal(read.grid.wet[:, 2, 3], [True, True, False, False])
    assert_array_equal(read.grid.wet[:, 0, 0], [False] * 4)
    assert read.grid.wet.sum() == u[0].size - 6
    assert noted(read, "6 analysis files excluded")


def test_anomalies_are_added_to_the_background_and_states_are_not(tmp_path):
    longitude, latitude = forms.lonlat()
    u, v = forms.regular(longitude, latitude)
    mean_u, mean_v = u.mean(axis=0), v.mean(axis=0)
    for folder, base_u, base_v in (("anomalies", mean_u, mean_v), ("states", 0.0, 0.0)):
        (tmp_path / folder).mkdir()
        for member in range(N_MEMBERS):
            ds = forms.standard(u - base_u, v - base_v, longitude, latitude).isel(member=member)
            save(ds, tmp_path / folder / f"mem{member}.nc")
        save(
            forms.standard(mean_u[None], mean_v[None], longitude, latitude).isel(member=0),
            tmp_path / folder / "bg_uv.nc",
        )
        read = read_with(tmp_path / folder)
        assert_comes_back(read, 1e-12)
        assert noted(read, "added to the background" if folder == "anomalies" else "was not used")
    (tmp_path / "anomalies" / "bg_uv.nc").unlink()


def test_pop_levels_between_interfaces(tmp_path):
    longitude, latitude = forms.lonlat()
    edges = np.array([0.0, 10.0, 110.0, 190.0, 410.0])
    ds = forms.standard(
        *forms.regular(longitude, latitude), longitude, latitude, ("UVEL", "VVEL"), ({}, {})
    )
    ds = ds.drop_vars("depth").rename(depth="k").assign(w_dep=("w_dep", edges))
    read = read_with(save(ds, tmp_path / "e.nc"), axes="true")
    assert_array_equal(read.grid.levels, LEVELS)
    assert "levels of k assumed midway between the interfaces w_dep" in read.notes
    assert_comes_back(read, 1e-12)
    refused(
        "dimension k has no coordinate values; add a depth coordinate in metres, or give the file",
        save(ds.drop_vars("w_dep"), tmp_path / "none.nc"),
    )


def test_a_file_of_another_grid_beside_a_forecast_is_refused(tmp_path):
    longitude, latitude = forms.lonlat()
    u, v = forms.regular(longitude, latitude)
    current = xr.Dataset(
        {
            name: (("member", "depth", "y", "x"), part, {"units": "m s-1"})
            for name, part in (("uo", u), ("vo", v))
        }
    )
    files = [save(current.assign_coords(depth=("depth", LEVELS)), tmp_path / "current.nc")]
    x, y = np.meshgrid(*forms.lonlat(shape=(9, 14)))
    grid = xr.Dataset(
        {
            name: (("eta_rho", "xi_rho"), part)
            for name, part in (("lon_rho", x), ("lat_rho", y), ("mask_rho", np.ones(x.shape)))
        }
    )
    files.append(save(grid, tmp_path / "grid.nc"))
    refused(
        r"current.nc: the currents have 7 x 8 points, the coordinates 9 x 14; give each forecast alone",
        files,
    )
