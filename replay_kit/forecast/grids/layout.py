"""Horizontal layout of velocities: dimensions, cell centres, staggering and axes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.region import Region
from replay_kit.core.words.text import count_text
from replay_kit.forecast.grids.horizontal import Index, columns_round, region_block
from replay_kit.forecast.names import (
    ANGLES,
    Axes,
    Coordinates,
    Current,
    find_coordinates,
    find_depth,
    find_lead,
    find_member,
    find_time,
)

#: Names of the two components in the datasets that are made of an ensemble's files.
U, V = "replay_kit_u", "replay_kit_v"
#: Name of the direction there of a current that is stated as speed and direction: the speed is then both components.
DIRECTION = "replay_kit_direction"
#: Attribute of such a dataset: the files of u and v state different coordinates under the same name.
STAGGERED = "replay_kit_staggered"


#: Points of a variable that are neither of these: cell centres.
CENTRE = "centre"


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Horizontal layout of a file.

    Attributes:
        kind: Kind of grid.
        longitude: Degrees east, shape (J, I) or (I,).
        latitude: Degrees north, shape (J, I) or (J,).
        dims: Dimensions (y, x) of ``U``, ``V`` and ``CENTRE``.
        first_face: Face before centre 0 along y (v), x (u), if any.
        rows: Rows used.
        columns: Columns used, in spatial order.
        period: Columns round the globe, if any.
        axes: Axes of u and v.
        why: Reason for axes.
        notes: Assumptions.
        levels: Dimension and positions of levels, by points.
    """

    kind: Coordinates
    longitude: Array
    latitude: Array
    dims: Mapping[str, tuple[str, str]]
    first_face: tuple[int, int] | None
    rows: Index
    columns: Index
    period: int | None
    axes: Axes
    why: str
    notes: tuple[str, ...] = ()
    levels: Mapping[str, tuple[str, Index]] = field(default_factory=dict)

    @property
    def places(self) -> tuple[Array, Array]:
        """Longitude and latitude of the centres used [degrees], shaped as in the file."""
        if self.longitude.ndim == 1:
            return self.longitude[self.columns], self.latitude[self.rows]
        used = np.ix_(self.rows, self.columns)
        return self.longitude[used], self.latitude[used]

    @property
    def points(self) -> tuple[Array, Array]:
        """Longitude and latitude of all centres used [degrees], shape (J, I)."""
        x, y = self.places
        if x.ndim == 1:
            x, y = np.meshgrid(x, y, copy=False)
        return x, y

    def taken(self, name: str) -> tuple[Index, Index]:
        """Return the rows and columns used of ``U``, ``V`` or ``CENTRE``; of a C-grid with the faces on both sides of the centres."""
        rows, columns = self.rows, self.columns
        if self.first_face is not None and name == V:
            rows = np.append(rows, rows[-1] + 1) + self.first_face[0]
        if self.first_face is not None and name == U:
            columns = np.append(columns, columns[-1] + 1) + self.first_face[1]
            columns = columns if self.period is None else columns % self.period
        return rows, columns

    def within(self, region: Region | None, where: str) -> "Layout":
        """Return the layout of the smallest block with all points inside a region; unchanged without a region.

        Raises:
            ForecastError: No point lies inside.
        """
        if region is None:
            return self
        x, y = self.places
        block = region_block(x, y, region)
        if block is None:
            raise ForecastError(
                f"{where}: no grid point inside the region {region} (west, south, east, north); the forecast covers "
                f"{x.min():.3f}..{x.max():.3f} E, {y.min():.3f}..{y.max():.3f} N"
            )
        return replace(self, rows=self.rows[block[0]], columns=self.columns[block[1]])

    @property
    def name(self) -> str:
        """Layout as text."""
        grid = "longitude-latitude grid" if self.longitude.ndim == 1 else "curvilinear grid"
        staggered = (
            "velocities on cell faces (C-grid), averaged to centres"
            if self.first_face
            else "both components at the same points"
        )
        return f"{self.kind.dialect} names, {grid}, {staggered}"


def lay_out(ds: xr.Dataset, current: Current, where: str) -> Layout:
    """Return the horizontal layout of a dataset with the components ``U`` and ``V`` and variables of grid files.

    Raises:
        ForecastError: Coordinates are missing, or do not belong to the components.
    """
    u_dims, v_dims = _horizontal(ds, U, current.u, where), _horizontal(ds, V, current.v, where)
    if not any(
        "lon" in str(name).lower() or ds[name].attrs.get("standard_name") == "longitude"
        for name in ds.variables
    ):
        ds = _projected(ds, u_dims)
    x_name, y_name, kind = find_coordinates(
        ds, [dim for dim in ds[U].dims if dim in ds[V].dims], where
    )
    longitude, latitude = (
        _without_times(ds[name], (*u_dims, *v_dims)) for name in (x_name, y_name)
    )
    if longitude.ndim != latitude.ndim:
        raise ForecastError(
            f"{where}: longitude has {longitude.ndim} dimensions and latitude {latitude.ndim}; both must have 1 or both 2"
        )
    flat = longitude.ndim == 1
    centre = (str(latitude.dims[0]), str((longitude if flat else latitude).dims[-1]))
    u_dims, v_dims = (_ordered(dims, centre) for dims in (u_dims, v_dims))
    x, y = (
        axis.values.astype(np.float64)
        if flat
        else axis.transpose(*centre).values.astype(np.float64)
        for axis in (longitude, latitude)
    )
    notes: tuple[str, ...] = ()
    face = _first_faces(ds, kind, (u_dims, v_dims), centre)
    if not flat:
        x, y, filled = _filled(x, y)
        notes = (
            (f"treated as land: {count_text(filled, 'point')} without coordinates",)
            if filled
            else ()
        )
    if face is not None and kind.dialect == "NEMO" and x_name.startswith("nav_lon"):
        x, y = _before(x), _before(y)
        notes += (
            "cell centres assumed midway between the points of u, as no grid file (glamt, gphit) was given",
        )
    _check_places(x, y, (x_name, y_name), where)
    ny, nx = y.shape[0], x.shape[-1]
    period = columns_round(x)
    rows, columns = np.arange(ny), np.arange(period or nx)
    if face is not None:
        b, a = face
        rows = np.arange(max(0, -b), min(ny, ds.sizes[v_dims[0]] - b - 1, ds.sizes[u_dims[0]]))
        if period is None:
            last = min(nx, ds.sizes[u_dims[1]] - a - 1, ds.sizes[v_dims[1]])
            columns = np.arange(max(0, -a), last)
    axes, why = _axes(ds, current, face is not None)
    dims_of = {U: u_dims, V: v_dims, CENTRE: centre}
    return Layout(kind, x, y, dims_of, face, rows, columns, period, axes, why, notes)


def _check_places(x: Array, y: Array, names: tuple[str, str], where: str) -> None:
    """Raise ForecastError for implausible longitudes or latitudes."""
    if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.abs(y) <= 90.0).all()):
        raise ForecastError(
            f"{where}: longitude or latitude holds missing values or latitudes beyond 90 degrees; swapped or damaged coordinates?"
        )
    for name, values in zip(names, (x, y), strict=True):
        if min(y.shape[0], x.shape[-1]) > 1 and np.ptp(values) == 0.0:
            raise ForecastError(
                f"{where}: {name} is {values.flat[0]:g} at every point; were the coordinates written? give the file of the grid with "
                "--ensemble"
            )


def _without_times(coordinate: xr.DataArray, dims: tuple[str, ...]) -> xr.DataArray:
    """Return a coordinate without length-one dimensions that the components lack, such as the time of a mesh file."""
    single = [dim for dim in coordinate.dims if coordinate.sizes[dim] == 1 and dim not in dims]
    return coordinate.isel(dict.fromkeys(single, 0)) if coordinate.ndim > 1 else coordinate


def _horizontal(ds: xr.Dataset, component: str, name: str | None, where: str) -> tuple[str, str]:
    """Return the two horizontal dimensions of a component: neither members, times nor levels."""
    dims = ds[component].dims
    others = {find(ds, dims) for find in (find_member, find_time, find_lead, find_depth)}
    # members under a name of their own, chosen by dim:NAME, come before the grid
    left = [str(dim) for dim in dims if dim not in others][-2:]
    if len(left) != 2:
        raise ForecastError(
            f"{where}: {name} has dimensions {', '.join(map(str, dims))}; expected two horizontal ones among them"
        )
    return left[0], left[1]


def _ordered(dims: tuple[str, str], centre: tuple[str, str]) -> tuple[str, str]:
    """Return two dimensions as (y, x), by the one shared with the centres."""
    return dims[::-1] if dims[0] == centre[1] or dims[1] == centre[0] else dims


def _first_faces(
    ds: xr.Dataset,
    kind: Coordinates,
    dims: tuple[tuple[str, str], tuple[str, str]],
    centre: tuple[str, str],
) -> tuple[int, int] | None:
    """Return the positions along y and x of the faces before the first centre; None without staggering."""
    (_, ux), (vy, _) = dims
    depths = {find_depth(ds, ds[name].dims) for name in (U, V)}
    nemo = kind.dialect == "NEMO" and (
        bool(depths & {"depthu", "depthv"}) or bool(ds.attrs.get(STAGGERED))
    )
    if dims[0] == dims[1] and not nemo:
        return None
    found = []
    for face, middle in ((vy, centre[0]), (ux, centre[1])):
        more = ds.sizes[face] - ds.sizes[middle]
        known = more == 0 and face != middle
        first, other = (_first(ds, dim) if known else np.nan for dim in (face, middle))
        before = more < 0 or kind.face == 1 or first >= other
        found.append(-1 if more < 1 and before and not first < other else 0)
    return found[0], found[1]


def _first(ds: xr.Dataset, dim: str) -> float:
    """Return the first value of a dimension's coordinate; NaN without one."""
    has = dim in ds.coords and ds.sizes[dim] and ds[dim].dtype.kind in "fiu"
    return float(ds[dim].values[0]) if has else np.nan


def _before(values: Array) -> Array:
    """Return the means of neighbours along x, the first column extrapolated; longitudes may jump by 360 degrees."""
    step = (np.diff(values, axis=1) + 180.0) % 360.0 - 180.0
    step = np.concatenate([step[:, :1], step], axis=1)
    return np.asarray(values - 0.5 * step)


def _filled(x: Array, y: Array) -> tuple[Array, Array, int]:
    """Return coordinates with missing ones, NaN or (0, 0), extrapolated from rows and columns, and the number of these."""
    missing = ~(np.isfinite(x) & np.isfinite(y)) | ((x == 0.0) & (y == 0.0))
    count = int(missing.sum())
    if count < 2 or missing.all():
        return x, y, 0
    middle = float(np.median(x[~missing]))
    x = (x - middle + 180.0) % 360.0 - 180.0 + middle
    filled = []
    for values in (x, y):
        axis = xr.DataArray(values, dims=("y", "x")).where(~missing)
        for dim in ("x", "y"):
            known = axis.where(axis.notnull().sum(dim) > 1)
            axis = axis.fillna(known.interpolate_na(dim, fill_value="extrapolate"))
        filled.append(axis.values)
    return filled[0], filled[1], count


def _mapping(ds: xr.Dataset) -> dict[str, Any]:
    """Return the attributes of a map projection; empty without one."""
    each = (variable.attrs for variable in ds.variables.values())
    return next((about for about in each if "grid_mapping_name" in about), {})


def _projected(ds: xr.Dataset, dims: tuple[str, str]) -> xr.Dataset:
    """Return a dataset with longitude and latitude computed from its map projection, if it states one."""
    y, x = dims
    if not (about := _mapping(ds)) or x not in ds.coords or y not in ds.coords:
        return ds
    # loads slowly, and few files state a projection alone
    import pyproj

    scale = [1e3 if ds[dim].attrs.get("units") == "km" else 1.0 for dim in (x, y)]
    crs = pyproj.CRS.from_cf(about)
    east, north = np.meshgrid(ds[x].values * scale[0], ds[y].values * scale[1])
    longitude, latitude = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(
        east, north
    )
    return ds.assign(longitude=(dims, longitude), latitude=(dims, latitude))


def _axes(ds: xr.Dataset, current: Current, staggered: bool) -> tuple[Axes, str]:
    """Return the axes of the components and the reason: standard name, then name, then angle, then grid."""
    if current.axes is not None:
        return current.axes, current.why
    long_name = str(ds[U].attrs.get("long_name", "")).lower()
    if any(
        mark in long_name for mark in ("x_velocity", "x-velocity", "i-current", "along x", "xi-")
    ):
        return "grid", f"long name '{ds[U].attrs['long_name']}'"
    if staggered:
        return "grid", "velocities on cell faces"
    angle = next((name for name in ANGLES if name in ds.variables), None)
    if angle is not None:
        return "grid", f"the file holds the grid's angle ({angle})"
    mapping = _mapping(ds).get("grid_mapping_name")
    if mapping not in (None, "latitude_longitude"):
        return "grid", f"the map projection {mapping}"
    return "true", "no sign of other axes"
