"""Unstructured meshes (FVCOM, SCHISM, FESOM, Delft3D FM, UGRID), interpolated linearly to a regular grid of their mean spacing.

Values at faces are first averaged to their corners by area. There is no extrapolation across the coast or beyond the mesh: a point in no
triangle is dry. Values are read when used. Layers that follow the bottom become those of ``s_levels``.
"""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import csr_matrix
from xarray.backends import BackendArray
from xarray.core import indexing

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.region import DEGREE
from replay_kit.forecast.names import MESH, SHARE

# Velocities without standard names, and heights of layers at each node.
_NAMED = {
    "eastward_sea_water_velocity": ("horizontalVelX", "unod"),
    "northward_sea_water_velocity": ("horizontalVelY", "vnod"),
}
_HEIGHTS = ("zCoordinates", "zcor")
_SIGMA = "ocean_sigma_coordinate"
# of which the error is stated
_COMPONENTS = ("u", "ua", "unod", "horizontalVelX", "mesh2d_ucx", "uo")


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangular mesh and weights to a regular grid.

    Attributes:
        longitude: Longitude of the grid, shape (I,) [degrees].
        latitude: Latitude of the grid, shape (J,) [degrees].
        dry: Points in no triangle, shape (J, I).
        weights: Weights of values on the mesh, shape (J * I, n), by dimension of the mesh.
        places: Longitude and latitude of the values, shape (n, 2), by dimension of the mesh.
        note: What was interpolated.
    """

    longitude: Array
    latitude: Array
    dry: NDArray[np.bool_]
    weights: dict[Hashable, csr_matrix]
    places: dict[Hashable, Array]
    note: str

    def on_grid(
        self, variable: xr.Variable, dim: Hashable, scale: Array | float = 1.0
    ) -> xr.Variable:
        """Return a variable along a dimension of the mesh, times a scale, on the regular grid; it is read when used."""
        others = [name for name in variable.dims if name != dim]
        weights = csr_matrix(self.weights[dim].multiply(scale))
        array = _OnGrid(variable.transpose(*others, dim), weights, self.dry)
        lazy = indexing.LazilyIndexedArray(array)
        return xr.Variable((*others, "lat", "lon"), lazy, variable.attrs)


def on_grid(ds: xr.Dataset, names: tuple[str, str, str], where: str) -> xr.Dataset:
    """Return the dataset of a mesh, interpolated to a regular grid.

    Args:
        ds: Dataset on the mesh.
        names: See ``find_mesh``.
        where: Name of the file, for messages.

    Raises:
        ForecastError: The mesh is not in degrees, or its layers have no sea bed.
    """
    corners, x, y = names
    mesh = _mesh(ds, corners, x, y, where)
    variables: dict[Hashable, xr.Variable] = {}
    layered, scale = _with_share(ds, ds[x].dims[0], where)
    for name, variable in layered.variables.items():
        dims = set(variable.dims) & set(mesh.weights)
        if not dims:
            variables[name] = variable
        elif len(dims) == 1 and variable.dtype.kind == "f" and name not in (x, y):
            by = scale if name == SHARE else 1.0
            variables[name] = mesh.on_grid(variable, dims.pop(), by)
    for standard_name, some in _NAMED.items():
        for name in some:
            if name in variables:
                variables[name].attrs["standard_name"] = standard_name
    axes = {
        "lon": ("lon", mesh.longitude, {"standard_name": "longitude", "units": "degrees_east"}),
        "lat": ("lat", mesh.latitude, {"standard_name": "latitude", "units": "degrees_north"}),
    }
    note = mesh.note + _error(ds, mesh)
    return xr.Dataset(variables, attrs={**ds.attrs, MESH: note}).assign_coords(axes)


def _mesh(ds: xr.Dataset, corners: str, x: str, y: str, where: str) -> Mesh:
    places = np.column_stack([np.asarray(ds[name].values, np.float64) for name in (x, y)])
    if np.abs(places[:, 0]).max() > 360.0 or np.abs(places[:, 1]).max() > 90.0 or not places.any():
        raise ForecastError(
            f"{where}: an unstructured mesh whose nodes are not in degrees ({x}, {y}); give their longitude and latitude"
        )
    face = max(ds[corners].dims, key=lambda dim: ds.sizes[dim])
    of_face = _corners(ds[corners].transpose(face, ...), len(places))
    whole = (of_face[:, :3] >= 0).all(axis=1)
    # one with four corners is two triangles
    quads = whole & (of_face[:, 3:] >= 0).any(axis=1)
    three = np.concatenate([of_face[whole, :3], of_face[quads][:, [0, 2, -1]]])
    faces = np.concatenate([np.flatnonzero(whole), np.flatnonzero(quads)])
    scale = DEGREE * np.array([np.cos(np.deg2rad(places[:, 1].mean())), 1.0])
    a, b, c = (places[three] * scale).swapaxes(0, 1)
    area = 0.5 * np.abs(_cross(b - a, c - a))
    if not three.size or not area.any():
        raise ForecastError(f"{where}: an unstructured mesh without triangles")
    spacing = float(np.sqrt(2.0 * area.mean()))
    low, high, step = places.min(axis=0), places.max(axis=0), spacing / scale
    axes = [np.arange(low[k], high[k] + 0.5 * step[k], step[k]) for k in (0, 1)]
    points = np.stack(np.meshgrid(*axes), axis=-1)
    weights, dry = _linear(places, three, points.reshape(-1, 2))
    share = np.repeat(area, 3)
    total = np.bincount(three.ravel(), share, len(places))[three.ravel()]
    to_nodes = csr_matrix(
        (share / np.where(total > 0.0, total, 1.0), (three.ravel(), np.repeat(faces, 3))),
        (len(places), len(of_face)),
    )
    middles = np.nanmean(np.where(of_face[..., None] >= 0, places[of_face], np.nan), axis=1)
    node = ds[x].dims[0]
    note = f"unstructured mesh of {len(three):,} triangles interpolated to a grid of {spacing / 1e3:.3g} km, its mean spacing"
    return Mesh(
        axes[0],
        axes[1],
        dry.reshape(points.shape[:2]),
        {node: weights, face: csr_matrix(weights @ to_nodes)},
        {node: places, face: middles},
        note,
    )


def _corners(corners: xr.DataArray, n: int) -> NDArray[np.int64]:
    """Return the corners of each face, shape (F, 3 or 4), padded with -1."""
    values = np.asarray(corners.values, np.float64)
    known = np.isfinite(values) & (values >= 0) & (values <= n)
    first = corners.attrs.get("start_index", values[known].min())
    return np.where(known, values - float(first), -1).astype(np.int64)


def _linear(
    places: Array, three: NDArray[np.int64], points: Array
) -> tuple[csr_matrix, NDArray[np.bool_]]:
    """Return the weights of linear interpolation from nodes to points, shape (P, N), and whether points lie in no triangle."""
    tree = shapely.STRtree(shapely.points(points))
    ring = shapely.polygons(places[three][:, [0, 1, 2, 0]])
    # a point on an edge is in two
    at, first = np.unique((found := tree.query(ring, predicate="intersects"))[1], return_index=True)
    inside = found[0][first]
    (a, b, c), p = places[three[inside]].swapaxes(0, 1), points[at]
    shares = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    shares /= _cross(b - a, c - a)[:, None]
    cells = np.repeat(at, 3), three[inside].ravel()
    return (
        csr_matrix((shares.ravel(), cells), (len(points), len(places))),
        ~np.isin(np.arange(len(points)), at),
    )


def _cross(a: Array, b: Array) -> Array:
    found: Array = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return found


class _OnGrid(BackendArray):
    """Variable of a mesh, with the mesh along its last dimension, interpolated to the regular grid when read."""

    def __init__(self, variable: xr.Variable, weights: csr_matrix, dry: NDArray[np.bool_]) -> None:
        self._variable, self._weights, self._dry = variable, weights, dry
        self.shape, self.dtype = (*variable.shape[:-1], *dry.shape), np.dtype(variable.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._read
        )

    def _read(self, key: tuple[int | slice, ...]) -> Any:
        *others, rows, columns = key
        values = self._variable[(*others, slice(None))].values
        points = self._weights @ values.reshape(-1, values.shape[-1]).astype(np.float64).T
        points = points.T.reshape(*values.shape[:-1], *self._dry.shape)
        return np.where(self._dry, np.nan, points).astype(self.dtype)[..., rows, columns]


def _with_share(ds: xr.Dataset, node: Hashable, where: str) -> tuple[xr.Dataset, Array | float]:
    """Return a dataset with the depth of the bottom and the share of the water above its layers, if these follow it, and the share's scale.

    Raises:
        ForecastError: The depth of the bottom is absent.
    """
    scale: Array | float = 1.0
    if (heights := next((name for name in _HEIGHTS if name in ds.variables), None)) is not None:
        of_heights = ds[heights]
        layer = next(dim for dim in of_heights.dims[::-1] if dim != node)
        first = dict.fromkeys(set(of_heights.dims) - {layer, node}, 0)
        bed, share = -of_heights.isel(first).min(str(layer)), of_heights
        scale = 1.0 / np.maximum(bed.values.astype(np.float64), 1e-3)
    else:
        sigmas = [name for name in ds.variables if ds[name].attrs.get("standard_name") == _SIGMA]
        if not sigmas:
            return ds, scale
        share, layer = ds[sigmas[0]].astype(np.float64), ds[sigmas[0]].dims[0]
        words = str(share.attrs.get("formula_terms", "")).split()
        depth = dict(zip(words[::2], words[1::2], strict=False)).get("depth:", "h")
        if depth not in ds.variables:
            raise ForecastError(
                f"{where}: the layers {sigmas[0]} need the depth of the bottom ({depth}), which is not in the file"
            )
        bed = abs(ds[depth])
        if node not in share.dims:
            share = share.broadcast_like(bed)
        ds = ds.drop_vars(sigmas)
    made = {"h": bed.variable, SHARE: share.variable}
    return ds.assign(made).rename({layer: "s_rho"}), scale


def _error(ds: xr.Dataset, mesh: Mesh) -> str:
    """Return a clause on the RMS difference of a component after interpolation back to the mesh."""
    name = next((name for name in _COMPONENTS if name in ds.variables), None)
    if name is None:
        return ""
    variable = ds.variables[name]
    (dim,) = set(variable.dims) & set(mesh.weights)
    known = variable[{other: 0 for other in variable.dims if other != dim}].values
    points = (mesh.weights[dim] @ known.astype(np.float64)).reshape(mesh.dry.shape)
    back = RegularGridInterpolator(
        (mesh.latitude, mesh.longitude), np.where(mesh.dry, np.nan, points), bounds_error=False
    )(mesh.places[dim][:, ::-1])
    error = np.sqrt(np.nanmean((back - known) ** 2))
    return f"; taken back, {name} of its first field differs by {100.0 * error:.2g} cm/s RMS"
