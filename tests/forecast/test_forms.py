"""One known field as each model writes it, on a turned grid with land: it comes back on true axes, with land where it was."""

import numpy as np
import pyproj
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig
from replay_kit.forecast.describe import describe_ensemble
from tests.forecast import forms
from tests.forecast.forms import LEVELS, N_MEMBERS, assert_comes_back, noted, read_with, save, saved

SHAPE = (10, 12)
ROWS, COLUMNS = map(np.arange, SHAPE)
TURNED = forms.rotated(shape=SHAPE, cell=0.01)
# The known field is turned by angles on a sphere: on the ellipsoid they differ by 0.8 mrad, of 0.3 m/s; TOPAZ' are known half a cell away.
ANGLE_ERROR, EDGE_ERROR = 3e-4, 2e-3
DEPTH = {"units": "meters", "positive": "down"}
ALONG = [{"standard_name": f"sea_water_{axis}_velocity", "units": "m s-1"} for axis in "xy"]
TIMES = np.array(["2020-01-01", "2020-01-06", "2020-01-11"], "M8[ns]")


# Quarters of a degree round the globe, with a seam at 73 E as in ORCA grids.
ROUND, SEAM = 1440, 73.0


def separable(j, i):
    return 10.0 + 0.02 * np.asarray(i), 40.0 + 0.02 * np.asarray(j)


def globe(j, i):
    return SEAM + 0.25 * np.asarray(i), 40.0 + 0.25 * np.asarray(j)


def wrapped(longitude):
    return (longitude + 180.0) % 360.0 - 180.0


def plane(at, dj=0.0, di=0.0, columns=COLUMNS):
    """Longitude and latitude at an offset from the centres, shape (J, I)."""
    return at(*np.meshgrid(ROWS + dj, columns + di, indexing="ij"))


def water(rows, columns):
    """Whether there is water, shape (Z, J, I), at cells; or at faces between two of them."""
    found = np.ones((LEVELS.size, len(rows), len(columns)), bool)
    for side in (np.floor, np.ceil):
        j, i = np.meshgrid(side(rows), side(columns) % ROUND, indexing="ij")
        found &= ~((j < 3) & (i < 4))
        found[3] &= (i < 9) | (i > SHAPE[1])
    return found


def component(k, at, dj, di, land=0.0, more=0, length=SHAPE[1]):
    """A component of all members along the grid, at an offset from the centres, and its water; with more faces along its axis."""
    rows, columns = (
        np.arange(size + more * (axis == k)) + offset
        for axis, size, offset in ((1, SHAPE[0], dj), (0, length, di))
    )
    j, i = np.meshgrid(rows, columns, indexing="ij")
    wet = water(rows, columns)
    each = [forms.along_grid(at, j, i, LEVELS[:, None, None], m)[k] for m in range(N_MEMBERS)]
    return np.where(wet, np.stack(each), land), wet


def nemo(mesh, at=TURNED, length=SHAPE[1]):
    """Files of u, v and the mesh, in which names of dimensions and coordinates are the same for u and v."""
    files, columns = {}, np.arange(length)
    for k, (name, dj, di) in enumerate((("uo", 0.0, 0.5), ("vo", 0.5, 0.0))):
        depth, (x, y) = f"depth{'uv'[k]}", plane(at, dj, di, columns)
        values = component(k, at, dj, di, length=length)[0]
        files[f"x_{name}.nc"] = xr.Dataset(
            {name: (("time_counter", depth, "y", "x"), values, {"units": "m/s"})},
            {
                depth: (depth, LEVELS, DEPTH),
                "nav_lon": (("y", "x"), wrapped(x), {"standard_name": "longitude"}),
                "nav_lat": (("y", "x"), y, {"standard_name": "latitude"}),
                "time_counter": TIMES,
            },
        )
    if mesh:
        dims, (x, y) = ("time", "y", "x"), plane(at, columns=columns)
        own = {"glamt": (dims, wrapped(x)[None]), "gphit": (dims, y[None])}
        own["tmask"] = (("time", "z", "y", "x"), water(ROWS, columns)[None] * 1.0)
        files["mesh.nc"] = xr.Dataset(own)
    return files


def mitgcm(flat, at=separable, length=SHAPE[1], more=0):
    """Faces west and south of the centres, each with its mask; with coordinates of one or two dimensions, and maybe faces in the east."""
    (u, west), (v, south) = (
        component(k, at, -0.5 * k, -0.5 * (1 - k), more=more * (1 - k), length=length)
        for k in (0, 1)
    )
    x, y = plane(at, columns=np.arange(length))
    faces = at(0, np.arange(length + more) - 0.5)[0], at(ROWS - 0.5, 0)[1]
    ds = xr.Dataset(
        {
            "UVEL": (("member", "Z", "YC", "XG"), u, {"units": "m/s"}),
            "VVEL": (("member", "Z", "YG", "XC"), v, {"units": "m/s"}),
            "hFacC": (("Z", "YC", "XC"), water(ROWS, np.arange(length)) * 1.0),
            "hFacW": (("Z", "YC", "XG"), west * 1.0),
            "hFacS": (("Z", "YG", "XC"), south * 1.0),
        },
        {"Z": ("Z", -LEVELS, {"units": "m"}), "XG": faces[0], "YG": faces[1]},
    )
    if flat:
        return {"e.nc": ds.assign_coords(XC=x[0], YC=y[:, 0])}
    return {"e.nc": ds.rename(XC="i", YC="j").assign(XC=(("j", "i"), x), YC=(("j", "i"), y))}


def mom6(symmetric):
    """Currents on the faces of a C-grid, with those west and south of the first cells or without, and the static file."""
    offset = -0.5 if symmetric else 0.5
    (u, wet_u), (v, wet_v) = (
        component(k, TURNED, offset * k, offset * (1 - k), np.nan, int(symmetric)) for k in (0, 1)
    )
    ds = xr.Dataset(
        {
            "uo": (("time", "z_l", "yh", "xq"), u, ALONG[0]),
            "vo": (("time", "z_l", "yq", "xh"), v, ALONG[1]),
        },
        {
            "z_l": ("z_l", LEVELS, DEPTH),
            "time": TIMES,
            # nominal: no places of a turned grid
            "xh": COLUMNS + 0.5,
            "yh": ROWS + 0.5,
            "xq": np.arange(u.shape[-1]) + offset + 0.5,
            "yq": np.arange(v.shape[-2]) + offset + 0.5,
        },
    )
    x, y = plane(TURNED)
    static = {"geolon": x, "geolat": y, "wet": water(ROWS, COLUMNS)[0] * 1.0, "cos_rot": 0.0 * x}
    own = {name: (("yh", "xh"), values) for name, values in static.items()}
    own |= {"wet_u": (("yh", "xq"), wet_u[0] * 1.0), "wet_v": (("yq", "xh"), wet_v[0] * 1.0)}
    return {"ocean.nc": ds, "ocean_static.nc": xr.Dataset(own)}


def at_corners(names, dims, depth, more):
    """Both components at the north-eastern corners of the cells of a B-grid."""
    values = [component(k, TURNED, 0.5, 0.5, np.nan)[0] for k in (0, 1)]
    places = {
        name: (dims[2:], of) for name, of in zip(names[2:], plane(TURNED, 0.5, 0.5), strict=True)
    }
    currents = zip(names[:2], values, ALONG, strict=True)
    ds = xr.Dataset({name: (dims, part, about) for name, part, about in currents} | places)
    return {"ocean.nc": ds.assign_coords({dims[0]: TIMES, **depth}).assign(more)}


def mom5():
    dims = ("time", "st_ocean", "yu_ocean", "xu_ocean")
    depth = {"st_ocean": ("st_ocean", LEVELS, DEPTH), "xu_ocean": COLUMNS, "yu_ocean": ROWS}
    return at_corners(("u", "v", "geolon_c", "geolat_c"), dims, depth, {})


def pop():
    """With interfaces instead of levels."""
    edges = {"w_dep": ("w_dep", np.array([0.0, 10.0, 110.0, 190.0, 410.0]))}
    dims = ("time", "k", "nlat", "nlon")
    return at_corners(("UVEL", "VVEL", "ULON", "ULAT"), dims, {}, edges)


def topaz(projected):
    """On polar stereographic axes, with longitudes and latitudes or the projection alone."""
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

    about = {key: value for key, value in crs.to_cf().items() if key != "crs_wkt"}
    ds = xr.Dataset(
        {
            name: (("time", "depth", "y", "x"), component(k, at, 0, 0, np.nan)[0], ALONG[k])
            for k, name in enumerate(("vxo", "vyo"))
        },
        {
            "time": TIMES,
            "depth": ("depth", LEVELS, {"units": "m"}),
            "x": ("x", 12.5 * (COLUMNS + 20.0), {"units": "km"}),
            "y": ("y", 12.5 * (ROWS - 90.0), {"units": "km"}),
        },
    ).assign(stereographic=((), 0, about))
    if not projected:
        # unknown on land
        x, y = (np.where(water(ROWS, COLUMNS)[0], axis, np.nan) for axis in plane(at))
        ds = ds.assign_coords(longitude=(("y", "x"), x), latitude=(("y", "x"), y))
    return {"e.nc": ds}


#: Files, what a member is, arrangement, offset of the points, those that are read, error away from land and edges, and a note.
MODELS = [
    (nemo(True), "dim:time_counter", "NEMO", 0.0, np.s_[1:, 1:], ANGLE_ERROR, ""),
    (nemo(False), "dim:time_counter", "NEMO", 0.0, np.s_[1:, 1:], ANGLE_ERROR, "midway between"),
    # between faces 0.02 degrees apart the mean misses by (0.9 x 0.01)^2 / 2 of 0.3 m/s
    (mitgcm(True), None, "MITgcm", 0.0, np.s_[:-1, :-1], 5e-5, ""),
    (mitgcm(False), None, "MITgcm", 0.0, np.s_[:-1, :-1], 5e-5, ""),
    (mom6(True), "dim:time", "MOM6", 0.0, np.s_[:, :], ANGLE_ERROR, ""),
    (mom6(False), "dim:time", "MOM6", 0.0, np.s_[1:, 1:], ANGLE_ERROR, ""),
    (mom5(), "dim:time", "MOM5", 0.5, np.s_[:, :], ANGLE_ERROR, ""),
    (pop(), "dim:time", "POP", 0.5, np.s_[:, :], ANGLE_ERROR, "levels of k assumed midway between"),
    (topaz(True), "dim:time", "CF", None, np.s_[:, :], EDGE_ERROR, ""),
    (topaz(False), "dim:time", "CF", None, np.s_[:, :], EDGE_ERROR, "12 points without coordin"),
]


@pytest.mark.parametrize(("files", "members", "name", "offset", "part", "error", "note"), MODELS)
def test_a_known_field_comes_back_from_a_model(
    tmp_path, files, members, name, offset, part, error, note
):
    found = describe_ensemble(saved(files, tmp_path), ForecastConfig(members=members))
    read = found.ensemble
    assert found.arrangement.startswith(name)
    assert found.check.axes == "grid"
    assert_array_equal(read.grid.levels, LEVELS)
    corner = 0.5 if offset == 0.5 else 0.0
    wet = water(ROWS + corner, COLUMNS + corner)[:, *part]
    assert_array_equal(read.grid.wet, wet)
    if offset is not None:
        at = separable if name == "MITgcm" else TURNED
        longitude, latitude = plane(at, offset, offset)
        tolerance = 1e-3 if note.startswith("midway") else 1e-9
        assert_allclose(read.grid.longitude, longitude[part], atol=tolerance)
        assert_allclose(read.grid.latitude, latitude[part], atol=tolerance)
    # next to land one face stands for two
    assert_comes_back(read, error, at=np.s_[:3, 4:, 5:8])
    assert not note or noted(read, note)


@pytest.mark.parametrize(
    ("files", "members"),
    [
        *((nemo(True, globe, ROUND + repeated), "dim:time_counter") for repeated in (2, 0)),
        *((mitgcm(True, globe, ROUND, more), None) for more in (0, 1)),
    ],
)
def test_a_grid_round_the_globe_over_its_seam_and_over_the_antimeridian(tmp_path, files, members):
    saved(files, tmp_path)
    for middle in (SEAM, 180.0):
        west, east = (float(wrapped(middle + side)) for side in (-1.05, 2.3))
        read = read_with(tmp_path, members=members, region=(west, 40.3, east, 42.05))
        columns = round(4.0 * (middle - SEAM)) + np.arange(-4, 10)
        longitude, latitude = plane(globe, columns=columns)
        assert_allclose(wrapped(read.grid.longitude), wrapped(longitude[2:9]), atol=1e-9)
        assert_allclose(read.grid.latitude, latitude[2:9], atol=1e-9)
        assert_array_equal(read.grid.wet, water(ROWS, columns)[:, 2:9])
        # between faces a quarter of a degree apart the mean misses by (0.9 x 0.125)^2 / 2 of 0.3 m/s; not next to land
        assert_comes_back(read, 3e-3, at=np.s_[:3, 2:-1, 1:-1])
    whole = read_with(tmp_path, members=members).grid.longitude
    assert whole.shape[1] == ROUND


def test_enkf_c_a_file_for_each_member_and_variable_with_the_grid_apart(tmp_path):
    longitude, latitude = forms.lonlat()
    u, v = forms.regular(longitude, latitude)
    counts = np.full(u.shape[-2:], 4)
    counts[2, 3], counts[0, 0] = 2, 0
    grid = {"lon": ("i", longitude), "lat": ("j", latitude), "zt": ("k", LEVELS, DEPTH)}
    save(xr.Dataset(grid | {"num_levels": (("j", "i"), counts)}), tmp_path / "grid_spec.nc")
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


@pytest.mark.parametrize(("share", "note"), [(1.0, "added to the background"), (0.0, "not used")])
def test_anomalies_are_added_to_the_background_and_states_are_not(tmp_path, share, note):
    ds = forms.known()
    mean = {name: part.mean("member") for name, part in ds.data_vars.items()}
    about = {name: part.attrs for name, part in ds.data_vars.items()}
    files = {
        f"mem{k}.nc": ds.isel(member=k).assign(
            {
                name: (ds[name].isel(member=k) - share * mean[name]).assign_attrs(about[name])
                for name in mean
            }
        )
        for k in range(N_MEMBERS)
    }
    files["bg_uv.nc"] = ds.isel(member=0).assign(
        {name: part.assign_attrs(about[name]) for name, part in mean.items()}
    )
    read = read_with(saved(files, tmp_path))
    assert_comes_back(read, 1e-12)
    assert not note or noted(read, note)


def test_grep_members_by_suffix_without_their_mean(tmp_path):
    ds, labels = forms.known(), ("glor", "oras", "cglo")
    parts = {
        f"{name}_{label}": ds[name].isel(member=k)
        for name in ("uo", "vo")
        for k, label in enumerate(labels)
    }
    parts |= {f"{name}_{of}": 5.0 * ds[name][0] for name in ("uo", "vo") for of in ("mean", "std")}
    path = save(xr.Dataset(parts), tmp_path / "grep.nc")
    for rule in (None, "suffix"):
        read = read_with(path, members=rule)
        assert_comes_back(read, 1e-12)
        assert read.members == tuple(f"grep.nc {label}" for label in labels)
