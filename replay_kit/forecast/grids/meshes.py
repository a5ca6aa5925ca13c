"""Unstructured meshes (FVCOM, SCHISM, FESOM, Delft3D FM, UGRID), interpolated linearly to a regular grid of their mean spacing.

Values at faces are first averaged to their corners by area. There is no extrapolation across the coast or beyond the mesh: a point in no
triangle is dry. Values are read when used. Terrain-following layers become the s-levels of ``s_levels``. Layers with heights stated
at each node are interpolated to the depths of the deepest node.
"""

from collections.abc import Mapping
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

from replay_kit.core.arrays import Array, Values
from replay_kit.core.errors import ForecastError
from replay_kit.core.region import DEGREE
from replay_kit.forecast.grids.depths import at_depths
from replay_kit.forecast.names import MESH

# Velocities without standard names, and heights of layers at each node.
_EAST, _NORTH = ("horizontalVelX", "unod"), ("horizontalVelY", "vnod")
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
        from_nodes: Weights of values at nodes, shape (J * I, N).
        from_faces: Weights of values at faces, shape (J * I, F).
        dry: Points in no triangle, shape (J, I).
        nodes: Longitude and latitude of the nodes, shape (N, 2).
        faces: Longitude and latitude of the faces' centres, shape (F, 2).
        triangles: Number of triangles.
        spacing: Spacing of the grid [m].
    """

    longitude: Array
    latitude: Array
    from_nodes: csr_matrix
    from_faces: csr_matrix
    dry: NDArray[np.bool_]
    nodes: Array
    faces: Array
    triangles: int
    spacing: float


@dataclass(frozen=True, slots=True, eq=False)
class _Layers:
    """Layers with heights stated at each node.

    Attributes:
        heights: Heights of the layers [m].
        dim: Dimension of the layers.
        depths: Depths after interpolation [m], shape (Z,).
    """

    heights: xr.Variable
    dim: Any
    depths: Array


def on_grid(ds: xr.Dataset, names: tuple[str, str, str], where: str) -> xr.Dataset:
    """Return the dataset of a mesh, interpolated to a regular grid.

    Args:
        ds: Dataset on the mesh.
        names: See ``find_mesh``.
        where: Name of the file, for messages.

    Raises:
        ForecastError: The mesh is not in degrees, or its layers vary from node to node without stated heights.
    """
    corners, x, y = names
    node, face = ds[x].dims[0], _face_dim(ds[corners])
    mesh = _mesh(_degrees(ds, x, y, where), _corners(ds[corners], ds.sizes[node]), where)
    heights = next((name for name in _HEIGHTS if name in ds.variables), None)
    layers = None if heights is None else _layers(ds.variables[heights], node)
    variables: dict[Any, xr.Variable] = {}
    for name, variable in ds.variables.items():
        dims = set(variable.dims) & {node, face}
        if not dims:
            variables[name] = variable
        elif len(dims) == 1 and variable.dtype.kind == "f" and name not in (x, y, heights):
            (dim,) = dims
            weights = mesh.from_nodes if dim == node else mesh.from_faces
            at = layers if layers and set(layers.heights.dims) <= set(variable.dims) else None
            variables[name] = _gridded(variable, dim, weights, mesh, at)
    found = xr.Dataset(variables, attrs=ds.attrs).assign_coords(
        lon=("lon", mesh.longitude, {"standard_name": "longitude", "units": "degrees_east"}),
        lat=("lat", mesh.latitude, {"standard_name": "latitude", "units": "degrees_north"}),
    )
    if layers:
        depth = ("depth", layers.depths, {"positive": "down", "units": "m"})
        found = found.assign_coords(depth=depth)
    found = _named(_sigma(ds, found, where))
    return found.assign_attrs({MESH: _note(ds, node, face, mesh)})


def _face_dim(corners: xr.DataArray) -> Any:
    return max(corners.dims, key=lambda dim: corners.sizes[dim])


def _degrees(ds: xr.Dataset, x: str, y: str, where: str) -> Array:
    places = np.column_stack([np.asarray(ds[name].values, np.float64) for name in (x, y)])
    if np.abs(places[:, 0]).max() > 360.0 or np.abs(places[:, 1]).max() > 90.0 or not places.any():
        raise ForecastError(
            f"{where}: an unstructured mesh whose nodes are not in degrees ({x}, {y}); give their longitude and latitude"
        )
    return places


def _corners(corners: xr.DataArray, n: int) -> NDArray[np.int64]:
    """Return the corners of each face, shape (F, 3 or 4), padded with -1."""
    values = np.asarray(corners.transpose(_face_dim(corners), ...).values, np.float64)
    known = np.isfinite(values) & (values >= 0) & (values <= n)
    first = corners.attrs.get("start_index", values[known].min())
    return np.where(known, values - float(first), -1).astype(np.int64)


def _mesh(places: Array, corners: NDArray[np.int64], where: str) -> Mesh:
    whole = (corners[:, :3] >= 0).all(axis=1)
    triangles, of = [corners[whole, :3]], [np.flatnonzero(whole)]
    if corners.shape[1] > 3:
        quads = whole & (corners[:, 3] >= 0)
        triangles.append(corners[quads][:, [0, 2, 3]])
        of.append(np.flatnonzero(quads))
    three, face = np.concatenate(triangles), np.concatenate(of)
    middle = places.mean(axis=0)
    scale = DEGREE * np.array([np.cos(np.deg2rad(middle[1])), 1.0])
    edges = (places[three] - places[three][:, :1]) * scale
    area = 0.5 * np.abs(edges[:, 1, 0] * edges[:, 2, 1] - edges[:, 1, 1] * edges[:, 2, 0])
    if not three.size or not area.any():
        raise ForecastError(f"{where}: an unstructured mesh without triangles")
    spacing = float(np.sqrt(2.0 * area.mean()))
    axes = [
        np.arange(low, high + 0.5 * step, step)
        for low, high, step in zip(
            places.min(axis=0), places.max(axis=0), spacing / scale, strict=True
        )
    ]
    x, y = np.meshgrid(*axes)
    from_nodes, dry = _linear(places, three, np.column_stack([x.ravel(), y.ravel()]))
    to_nodes = csr_matrix(
        (np.repeat(area, 3), (three.ravel(), np.repeat(face, 3))), (len(places), len(corners))
    )
    total = np.asarray(to_nodes.sum(axis=1)).ravel()
    to_nodes = csr_matrix(to_nodes.multiply(1.0 / np.where(total > 0.0, total, 1.0)[:, None]))
    middles = np.where(corners[..., None] >= 0, places[corners], np.nan)
    return Mesh(
        axes[0],
        axes[1],
        from_nodes,
        csr_matrix(from_nodes @ to_nodes),
        dry.reshape(x.shape),
        places,
        np.nanmean(middles, axis=1),
        len(three),
        spacing,
    )


def _linear(
    places: Array, three: NDArray[np.int64], points: Array
) -> tuple[csr_matrix, NDArray[np.bool_]]:
    """Return the weights of linear interpolation from nodes to points, shape (P, N), and whether points lie in no triangle."""
    ring = places[three][:, [0, 1, 2, 0]]
    inside, at = shapely.STRtree(shapely.points(points)).query(
        shapely.polygons(ring), predicate="intersects"
    )
    # a point on an edge is in two
    at, first = np.unique(at, return_index=True)
    inside = inside[first]
    (a, b, c), p = places[three[inside]].swapaxes(0, 1), points[at]
    shares = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    shares /= _cross(b - a, c - a)[:, None]
    shape = len(points), len(places)
    weights = csr_matrix((shares.ravel(), (np.repeat(at, 3), three[inside].ravel())), shape)
    dry = np.ones(len(points), bool)
    dry[at] = False
    return weights, dry


def _cross(a: Array, b: Array) -> Array:
    found: Array = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return found


def _layers(heights: xr.Variable, node: Any) -> _Layers:
    """Return the layers of a mesh, with their depths at the deepest node at the first time."""
    layer = next(name for name in heights.dims[::-1] if name != node)
    first = heights.isel({name: 0 for name in heights.dims if name not in (layer, node)})
    depth = -np.asarray(first.transpose(node, layer).values, np.float64)
    deepest: Array = np.unique(depth[np.nanargmax(np.nanmax(depth, axis=1))])
    return _Layers(heights, layer, np.clip(deepest, 0.0, None))


def _gridded(
    variable: xr.Variable,
    dim: Any,
    weights: csr_matrix,
    mesh: Mesh,
    layers: _Layers | None,
) -> xr.Variable:
    others = [name for name in variable.dims if name != dim]
    sizes = [variable.sizes[name] for name in others]
    if layers:
        at = others.index(layers.dim)
        sizes[at], others[at] = layers.depths.size, "depth"
    array = _OnGrid(variable, dim, weights, mesh, (*sizes, *mesh.dry.shape), layers)
    return xr.Variable((*others, "lat", "lon"), indexing.LazilyIndexedArray(array), variable.attrs)


class _OnGrid(BackendArray):
    """Variable of a mesh, interpolated to the regular grid when read."""

    def __init__(
        self,
        variable: xr.Variable,
        dim: Any,
        weights: csr_matrix,
        mesh: Mesh,
        shape: tuple[int, ...],
        layers: _Layers | None,
    ) -> None:
        self._variable, self._dim, self._weights, self._dry = variable, dim, weights, mesh.dry
        self._layers = layers
        self.shape, self.dtype = shape, np.dtype(variable.dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._read
        )

    def _read(self, key: tuple[int | slice, ...]) -> Any:
        *others, rows, columns = key
        values = self._values(tuple(others))
        flat = values.reshape(-1, values.shape[-1]).astype(np.float64)
        points = (self._weights @ flat.T).T.reshape(*values.shape[:-1], *self._dry.shape)
        return np.where(self._dry, np.nan, points).astype(self.dtype)[..., rows, columns]

    def _values(self, key: tuple[int | slice, ...]) -> Values:
        """Return values with nodes along the last axis."""
        names = [name for name in self._variable.dims if name != self._dim]
        at = dict(zip(names, key, strict=True))
        if self._layers is None:
            return self._variable[at].transpose(..., self._dim).values
        layer, heights = self._layers.dim, self._layers.heights
        levels = self._layers.depths[at.pop(layer)]
        kept = [name for name in names if name != layer and not isinstance(at[name], int)]
        order = [*kept, self._dim, layer]
        values = self._variable[at].transpose(*order).values
        height = heights[{name: part for name, part in at.items() if name in heights.dims}]
        height = height.transpose(*(name for name in order if name in height.dims))
        depth = np.broadcast_to(-height.values, values.shape)
        found = _at_depths(values, depth, np.atleast_1d(levels))
        before = sum(not isinstance(at[name], int) for name in names[: names.index(layer)])
        return np.moveaxis(found, 0, before) if np.ndim(levels) else found[0]


def _at_depths(values: Values, depth: Values, levels: Array) -> Values:
    """Return values of layers (last axis) at fixed depths (first axis); NaN below the deepest layer."""
    if np.nanmean(depth[..., 0]) > np.nanmean(depth[..., -1]):
        values, depth = values[..., ::-1], depth[..., ::-1]
    layered, deep = (np.moveaxis(of, -1, 0).reshape(of.shape[-1], 1, -1) for of in (values, depth))
    within = np.array(-np.inf), np.nanmax(deep, axis=0)
    return at_depths(layered, deep, within, levels).reshape(-1, *values.shape[:-1])


def _sigma(ds: xr.Dataset, found: xr.Dataset, where: str) -> xr.Dataset:
    """Return bottom-following layers as s-levels of the second transform, with the coordinate itself as stretching."""
    sigmas = [name for name in ds.variables if ds[name].attrs.get("standard_name") == _SIGMA]
    sigma = next((name for name in sigmas if set(ds[name].dims[:1]) & set(found.dims)), None)
    if sigma is None:
        return found
    values = np.asarray(ds[sigma].values, np.float64)
    layer = ds[sigma].dims[0]
    if values.ndim == 2:
        if np.ptp(values, axis=1).max() > 1e-3:
            raise ForecastError(
                f"{where}: layers {sigma} that differ from node to node; give a file whose layers are at fixed depths or one sigma"
            )
        values = values.mean(axis=1)
    words = str(ds[sigma].attrs.get("formula_terms", "eta: zeta depth: h")).split()
    terms: Mapping[str, str] = dict(
        zip((word.rstrip(":") for word in words[::2]), words[1::2], strict=False)
    )
    bed, surface = terms.get("depth", "h"), terms.get("eta", "zeta")
    if bed not in found.variables:
        raise ForecastError(
            f"{where}: the layers {sigma} need the depth of the bottom ({bed}), which is not in the file"
        )
    made: dict[str, Any] = {"h": abs(found[bed])}
    if surface in found.variables:
        made["zeta"] = found[surface]
    left = found.drop_vars([name for name in (bed, surface, sigma) if name in found.variables])
    if layer != "s_rho":
        left = left.rename({layer: "s_rho"})
    return left.assign(made).assign(
        s_rho=("s_rho", values), Cs_r=("s_rho", values), hc=0.0, Vtransform=2
    )


def _named(found: xr.Dataset) -> xr.Dataset:
    """Return velocities with the standard names that their models omit."""
    for names, towards in ((_EAST, "eastward"), (_NORTH, "northward")):
        for name in names:
            if name in found.variables:
                found[name].attrs["standard_name"] = f"{towards}_sea_water_velocity"
    return found


def _note(ds: xr.Dataset, node: Any, face: Any, mesh: Mesh) -> str:
    """Return a note on the interpolation, with the RMS difference after interpolation back to the mesh."""
    done = f"unstructured mesh of {mesh.triangles:,} triangles interpolated to a grid of {mesh.spacing / 1e3:.3g} km, its mean spacing"
    name = next((name for name in _COMPONENTS if name in ds.variables), None)
    if name is None:
        return done
    variable = ds.variables[name]
    there = variable[{dim: 0 for dim in variable.dims if dim not in (node, face)}]
    at_nodes = node in there.dims
    points = (mesh.from_nodes if at_nodes else mesh.from_faces) @ there.values.astype(np.float64)
    back = RegularGridInterpolator(
        (mesh.latitude, mesh.longitude),
        np.where(mesh.dry, np.nan, points.reshape(mesh.dry.shape)),
        bounds_error=False,
    )((mesh.nodes if at_nodes else mesh.faces)[:, ::-1])
    error = np.sqrt(np.nanmean((back - there.values) ** 2))
    return f"{done}; taken back, {name} of its first field differs by {100.0 * error:.2g} cm/s RMS"
