"""A flow as a CF dataset for people and programs, and as a lossless NetCDF-4 file that gives the same flow back.

The CF dataset has velocities towards true east and true north. The lossless file keeps the arrays that the flow is made of,
bit for bit; it is what ``--save-estimate`` writes and what a result MCAP carries as the attachment ``estimate.nc``.
"""

import io
import os
import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from replay_kit import __version__
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError, EstimatorError, ForecastError
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import velocity_kernel
from replay_kit.core.flow.lossless import CF_TIME, CONVENTIONS, FORMAT, READ_VERSIONS, from_lossless, history, to_lossless
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Grid

# Points evaluated at once: bounds the kernel matrix to some tens of MB.
_CHUNK = 512

_COMPONENTS = (("u", "eastward_sea_water_velocity"), ("v", "northward_sea_water_velocity"))


def to_dataset(
    flow: FlowEstimate, longitude: ArrayLike | None = None, latitude: ArrayLike | None = None, depth: ArrayLike | None = None
) -> xr.Dataset:
    """Return velocity and standard error towards true east and north as a CF dataset, NaN where dry and below the last level.

    Below the last level nothing is known: ``FlowEstimate.velocity`` continues the last level's flow there, a grid does not show it.

    Args:
        flow: The flow.
        longitude: shape (I,) [degrees east] of a product grid; None, with the other two, for the flow's own grid and levels.
        latitude: shape (J,) [degrees north].
        depth: shape (D,) [m], positive down.

    Returns:
        Dataset with ``u``, ``v`` and, when the flow has an uncertainty, ``u_standard_error``, ``v_standard_error``, on dimensions
        (depth, latitude, longitude), or (depth, y, x) with two-dimensional longitude and latitude on a curvilinear grid.

    Raises:
        EstimatorError: Only some of the three axes are given, or one is not one-dimensional.
    """
    lon, lat, levels = _target(flow, longitude, latitude, depth)
    east, north = to_local(flow.grid.projection, lon, lat)
    velocity, variance = _on_columns(flow, lon.ravel(), lat.ravel(), np.column_stack([east.ravel(), north.ravel()]), levels)
    wet = flow.grid.wet if longitude is None else wet_at(flow.grid, east, north, levels[:, None, None])
    dims, coords = _coordinates(flow, lon, lat, levels)
    attrs = {
        "Conventions": CONVENTIONS,
        "title": "Ocean current estimate",
        "source": f"replay-kit {__version__}",
        "history": history("to_dataset", flow),
    }
    dataset = xr.Dataset(coords=coords, attrs=attrs)
    for component, (name, standard_name) in enumerate(_COMPONENTS):
        words = standard_name.replace("_", " ")
        described = {"standard_name": standard_name, "long_name": words, "units": "m s-1"}
        if variance is not None:
            described["ancillary_variables"] = f"{name}_standard_error"
            about = {"standard_name": f"{standard_name} standard_error", "long_name": f"standard error of {words}", "units": "m s-1"}
            error = np.sqrt(np.maximum(variance[component], 0.0)).reshape(wet.shape)
            dataset[f"{name}_standard_error"] = (dims, np.where(wet, error, np.nan), about)
        dataset[name] = (dims, np.where(wet, velocity[component].reshape(wet.shape), np.nan), described)
    return dataset


def wet_at(grid: Grid, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> NDArray[np.bool_]:
    """Return True where the grid's nearest point at the nearest level is wet and the point lies in the box of the grid and its levels.

    A point farther than half a cell's diagonal from every grid point is off the grid, hence not wet. Depths above the first level
    take the first level; below the last one the forecast has no water.

    Args:
        grid: The grid.
        east: [m], local frame; the three broadcast together.
        north: [m], local frame.
        depth: [m], positive down.
    """
    east, north = np.broadcast_arrays(np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64))
    depth = np.asarray(depth, dtype=np.float64)
    distance, nearest = cKDTree(np.column_stack([grid.east.ravel(), grid.north.ravel()])).query(np.stack([east, north], axis=-1))
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    # A hair more than the half diagonal, so that the corners shared by four cells belong to one.
    on_grid = distance <= 0.5 * np.hypot(_spacing(grid, 0), _spacing(grid, 1)) * (1.0 + 1e-6)
    return np.asarray(grid.wet.reshape(grid.levels.size, -1)[level, nearest] & on_grid & (depth <= grid.levels[-1]))


def write_grid(flow: FlowEstimate, path: Path) -> None:
    """Write the flow on its own grid as CF NetCDF; the file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    dataset = to_dataset(flow)
    encoding: dict[str, dict[str, object]] = {str(name): {"_FillValue": None} for name in dataset.coords}
    encoding |= {str(name): {"zlib": True, "complevel": 4, "_FillValue": np.nan} for name in dataset.data_vars}
    if "time" in dataset.coords:
        # CF-1.8 has no 64-bit integers; the lossless file keeps the nanoseconds.
        encoding["time"] |= {**CF_TIME, "dtype": "float64"}
    _write(dataset, Path(path), encoding)


def save(flow: FlowEstimate, path: Path) -> None:
    """Write the flow without loss; ``load`` gives equal arrays, bit for bit. The file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    dataset = to_lossless(flow)
    _write(dataset, Path(path), {str(name): {"_FillValue": None} for name in dataset.variables})


def save_bytes(flow: FlowEstimate) -> bytes:
    """Return the bytes of the file that ``save`` writes; the same flow and libraries give the same bytes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "estimate.nc"
        save(flow, path)
        return path.read_bytes()


def load(path: Path) -> FlowEstimate:
    """Return the flow that ``save`` wrote.

    Raises:
        ForecastError: The file is missing, damaged, not such a file, or of another format version.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the flow: {error.strerror}") from error
    return load_bytes(data, str(path))


def load_bytes(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of a saved file's bytes, such as the attachment ``estimate.nc`` of a result MCAP.

    Args:
        data: The bytes.
        name: What to call them in errors.

    Raises:
        ForecastError: As for ``load``.
    """
    try:
        with xr.open_dataset(io.BytesIO(data), engine="h5netcdf", decode_cf=False) as dataset:
            kind, version = dataset.attrs.get("replay_kit_format"), dataset.attrs.get("replay_kit_format_version")
            if kind == FORMAT and version in READ_VERSIONS:
                return from_lossless(dataset.load())
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise ForecastError(f"{name}: expected a flow saved by replay-kit (NetCDF-4), but it is none or is damaged: {error}") from error
    if kind != FORMAT:
        raise ForecastError(f"{name}: a NetCDF file, but not a flow saved by replay-kit (no attribute replay_kit_format = {FORMAT})")
    known = " and ".join(map(str, READ_VERSIONS))
    raise ForecastError(f"{name}: flow format version {version}, but this replay-kit reads versions {known}; write it again")


def _target(
    flow: FlowEstimate, longitude: ArrayLike | None, latitude: ArrayLike | None, depth: ArrayLike | None
) -> tuple[Array, Array, Array]:
    """Return longitude and latitude, both (J, I), and depth (D,)."""
    if longitude is None and latitude is None and depth is None:
        return flow.grid.longitude, flow.grid.latitude, flow.levels
    if longitude is None or latitude is None or depth is None:
        raise EstimatorError("to_dataset needs longitude, latitude and depth together, or none of them for the flow's own grid")
    axes = [np.asarray(axis, dtype=np.float64) for axis in (longitude, latitude, depth)]
    if any(axis.ndim != 1 or axis.size == 0 for axis in axes):
        raise EstimatorError(f"to_dataset needs one-dimensional axes with values, but got shapes {[axis.shape for axis in axes]}")
    lon, lat = np.meshgrid(axes[0], axes[1])
    return lon, lat, axes[2]


def _on_columns(flow: FlowEstimate, longitude: Array, latitude: Array, points: Array, depth: Array) -> tuple[Array, Array | None]:
    """Return velocity and its variance, each (2, D, P) towards true east and north, at every depth over every point.

    The kernel is evaluated once per point and the rows of latent flow and modes are turned to true axes together, so that the
    variance of a turned component is the same quadratic form and needs no covariance between components.
    """
    levels = flow.levels.size
    by_depth = depth_weights(flow.depth_functions, depth, flow.levels)
    covariances = [_weight_cov_at(flow, row) for row in by_depth] if flow.n_modes else []
    velocity = np.empty((2, depth.size, len(points)))
    variance = np.empty_like(velocity) if flow.n_modes else None
    columns = np.hstack([flow.latent, flow.modes])
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        local = (velocity_kernel(flow.kernel, points[part], flow.nodes) @ columns).reshape(2, -1, columns.shape[1])
        for component, rows in enumerate(rotate_to_geographic(flow.grid.projection, longitude[part, None], latitude[part, None], *local)):
            velocity[component, :, part] = by_depth @ rows[:, :levels].T
            if variance is not None:
                modes = rows[:, levels:]
                variance[component, :, part] = [np.einsum("pr,pr->p", modes @ covariance, modes) for covariance in covariances]
    return velocity, variance


def _weight_cov_at(flow: FlowEstimate, by_level: Array) -> Array:
    """Return the covariance (r, r) of the mode amplitudes at a depth whose depth functions are ``by_level``."""
    levels = np.flatnonzero(by_level)
    blocks = flow.weight_cov.reshape(flow.levels.size, flow.n_modes, flow.levels.size, flow.n_modes)
    return np.asarray(np.einsum("j,jrks,k->rs", by_level[levels], blocks[levels][:, :, levels], by_level[levels], optimize=True))


def _coordinates(flow: FlowEstimate, lon: Array, lat: Array, depth: Array) -> tuple[tuple[str, ...], dict[str, xr.Variable]]:
    lon_attrs = {"standard_name": "longitude", "long_name": "longitude", "units": "degrees_east"}
    lat_attrs = {"standard_name": "latitude", "long_name": "latitude", "units": "degrees_north"}
    depth_attrs = {"standard_name": "depth", "long_name": "depth below the surface", "units": "m", "positive": "down", "axis": "Z"}
    coords = {"depth": xr.Variable("depth", depth, depth_attrs)}
    if flow.time_ns is not None:
        coords["time"] = xr.Variable((), np.datetime64(flow.time_ns, "ns"), {"standard_name": "time", "long_name": "time", "axis": "T"})
    if np.all(lon == lon[0]) and np.all(lat == lat[:, :1]):
        coords["latitude"] = xr.Variable("latitude", lat[:, 0], lat_attrs | {"axis": "Y"})
        coords["longitude"] = xr.Variable("longitude", lon[0], lon_attrs | {"axis": "X"})
        return ("depth", "latitude", "longitude"), coords
    coords["latitude"] = xr.Variable(("y", "x"), lat, lat_attrs)
    coords["longitude"] = xr.Variable(("y", "x"), lon, lon_attrs)
    return ("depth", "y", "x"), coords


def _spacing(grid: Grid, axis: int) -> float:
    """Return the largest distance [m] between neighbours along an axis of the horizontal grid; 0 for a single row."""
    return float(np.max(np.hypot(np.diff(grid.east, axis=axis), np.diff(grid.north, axis=axis)), initial=0.0))


def _write(dataset: xr.Dataset, path: Path, encoding: dict[str, dict[str, object]]) -> None:
    """Write under a temporary name in the same folder, then rename, so that no reader ever sees half a file."""
    part = path.with_name(path.name + ".part")
    try:
        dataset.to_netcdf(part, engine="h5netcdf", encoding=encoding)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot write: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)
