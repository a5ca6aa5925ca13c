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


def currents(names, dims, at, offsets, about=ALONG, **of):
    """Both components as variables, each on its dimensions and at its offset from the centres, and their water."""
    both = [component(k, at, *offset, **of) for k, offset in enumerate(offsets)]
    parts = zip(names, dims, both, about, strict=True)
    return {n: (own, part, attrs) for n, own, (part, _), attrs in parts}, [wet for _, wet in both]


def nemo(mesh, at=TURNED, length=SHAPE[1]):
    """Files of u, v and the mesh, in which names of dimensions and coordinates are the same for u and v."""
    files, columns, offsets = {}, np.arange(length), ((0.0, 0.5), (0.5, 0.0))
    dims = [("time_counter", f"depth{name}", "y", "x") for name in "uv"]
    held, _ = currents(("uo", "vo"), dims, at, offsets, [{"units": "m/s"}] * 2, length=length)
    for (name, variable), offset in zip(held.items(), offsets, strict=True):
        depth, (x, y) = variable[0][1], plane(at, *offset, columns)
        places = {
            "nav_lon": (("y", "x"), wrapped(x), {"standard_name": "longitude"}),
            "nav_lat": (("y", "x"), y, {"standard_name": "latitude"}),
        }
        axes = {depth: (depth, LEVELS, DEPTH), "time_counter": TIMES}
        files[f"x_{name}.nc"] = xr.Dataset({name: variable}, places | axes)
    if mesh:
        dims, (x, y) = ("time", "y", "x"), plane(at, columns=columns)
        own = {"glamt": (dims, wrapped(x)[None]), "gphit": (dims, y[None])}
        own["tmask"] = (("time", "z", "y", "x"), water(ROWS, columns)[None] * 1.0)
        files["mesh.nc"] = xr.Dataset(own)
    return files


def mitgcm(flat, at=separable, length=SHAPE[1], more=0):
    """Faces west and south of the centres, each with its mask; with coordinates of one or two dimensions, and maybe faces in the east."""
    columns, dims = np.arange(length), [("member", "Z", "YC", "XG"), ("member", "Z", "YG", "XC")]
    held = {"hFacC": (("Z", "YC", "XC"), water(ROWS, columns) * 1.0)}
    for k, (name, mask) in enumerate((("UVEL", "hFacW"), ("VVEL", "hFacS"))):
        offset = -0.5 * k, -0.5 * (1 - k)
        part, wet = component(k, at, *offset, more=more * (1 - k), length=length)
        held |= {name: (dims[k], part, {"units": "m/s"}), mask: (dims[k][1:], wet * 1.0)}
    faces = {"XG": at(0, np.arange(length + more) - 0.5)[0], "YG": at(ROWS - 0.5, 0)[1]}
    ds = xr.Dataset(held, {"Z": ("Z", -LEVELS, {"units": "m"}), **faces})
    x, y = plane(at, columns=columns)
    if flat:
        return {"e.nc": ds.assign_coords(XC=x[0], YC=y[:, 0])}
    return {"e.nc": ds.rename(XC="i", YC="j").assign(XC=(("j", "i"), x), YC=(("j", "i"), y))}


def mom6(symmetric):
    """Currents on the faces of a C-grid, with those west and south of the first cells or without, and the static file."""
    offset = -0.5 if symmetric else 0.5
    dims = [("time", "z_l", "yh", "xq"), ("time", "z_l", "yq", "xh")]
    offsets, of = ((0.0, offset), (offset, 0.0)), {"land": np.nan, "more": int(symmetric)}
    held, (wet_u, wet_v) = currents(("uo", "vo"), dims, TURNED, offsets, **of)
    # nominal: no places of a turned grid
    sizes = {"xh": COLUMNS.size, "yh": ROWS.size, "xq": wet_u.shape[2], "yq": wet_v.shape[1]}
    nominal = {name: np.arange(size) + 0.5 + offset * ("q" in name) for name, size in sizes.items()}
    ds = xr.Dataset(held, {"z_l": ("z_l", LEVELS, DEPTH), "time": TIMES, **nominal})
    x, y = plane(TURNED)
    static = {"geolon": x, "geolat": y, "wet": water(ROWS, COLUMNS)[0] * 1.0, "cos_rot": 0.0 * x}
    own = {name: (("yh", "xh"), values) for name, values in static.items()}
    own |= {"wet_u": (dims[0][2:], wet_u[0] * 1.0), "wet_v": (dims[1][2:], wet_v[0] * 1.0)}
    return {"ocean.nc": ds, "ocean_static.nc": xr.Dataset(own)}


def at_corners(names, dims, depth, more):
    """Both components at the north-eastern corners of the cells of a B-grid."""
    held, _ = currents(names[:2], [dims] * 2, TURNED, [(0.5, 0.5)] * 2, land=np.nan)
    places = zip(names[2:], plane(TURNED, 0.5, 0.5), strict=True)
    held |= {name: (dims[2:], of) for name, of in places} | more
    return {"ocean.nc": xr.Dataset(held, {dims[0]: TIMES, **depth})}


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
    about = {
        "grid_mapping_name": "polar_stereographic",
        "latitude_of_projection_origin": 90.0,
        "straight_vertical_longitude_from_pole": -45.0,
        "standard_parallel": 90.0,
    }
    crs = pyproj.CRS.from_cf(about)
    back = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)

    def at(j, i):
        return back.transform(12.5e3 * (np.asarray(i) + 20.0), 12.5e3 * (np.asarray(j) - 90.0))

    dims = [("time", "depth", "y", "x")] * 2
    held, _ = currents(("vxo", "vyo"), dims, at, [(0, 0)] * 2, land=np.nan)
    own = {key: value for key, value in crs.to_cf().items() if key != "crs_wkt"}
    axes = {"x": 12.5 * (COLUMNS + 20.0), "y": 12.5 * (ROWS - 90.0)}
    coords = {name: (name, values, {"units": "km"}) for name, values in axes.items()}
    coords |= {"time": TIMES, "depth": ("depth", LEVELS, {"units": "m"})}
    if not projected:
        # unknown on land
        wet = water(ROWS, COLUMNS)[0]
        places = zip(("longitude", "latitude"), plane(at), strict=True)
        coords |= {name: (("y", "x"), np.where(wet, of, np.nan)) for name, of in places}
    return {"e.nc": xr.Dataset(held | {"stereographic": ((), 0, own)}, coords)}


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
    both = dict(zip("uv", forms.regular(longitude, latitude), strict=True))
    counts = np.full(both["u"].shape[-2:], 4)
    counts[2, 3], counts[0, 0] = 2, 0
    grid = {"lon": ("i", longitude), "lat": ("j", latitude), "zt": ("k", LEVELS, DEPTH)}
    files = {"grid_spec.nc": xr.Dataset(grid | {"num_levels": (("j", "i"), counts)})}
    for member, name in np.ndindex(N_MEMBERS, 2):
        name, at = "uv"[name], f"mem{member + 1:03d}_{'uv'[name]}.nc"
        part = xr.Dataset({name: (("k", "j", "i"), both[name][member], {"units": "m/s"})})
        files |= {at: part, f"{at}.analysis": part * 9.0}
    read = read_with(saved(files, tmp_path))
    assert_comes_back(read, 1e-12)
    assert read.members == tuple(f"mem{k:03d}_u.nc + mem{k:03d}_v.nc" for k in (1, 2, 3))
    depths = np.arange(4)[:, None, None]
    assert_array_equal(read.grid.wet, depths < counts)
    assert noted(read, "6 analysis files excluded")


@pytest.mark.parametrize(("share", "note"), [(1.0, "added to the background"), (0.0, "not used")])
def test_anomalies_are_added_to_the_background_and_states_are_not(tmp_path, share, note):
    ds, members = forms.known(), {}
    with xr.set_options(keep_attrs=True):
        mean = ds.mean("member")
        for k in range(N_MEMBERS):
            members[f"mem{k}.nc"] = ds.isel(member=k) - share * mean
    read = read_with(saved(members | {"bg_uv.nc": mean}, tmp_path))
    assert_comes_back(read, 1e-12)
    assert noted(read, note)


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
