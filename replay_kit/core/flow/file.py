"""Forms of a flow in files: its arrays by one table, in NetCDF without loss, and compact in a result.

CF-1.8, whose metadata the lossless form has, knows no 64-bit integers, and float64 seconds since 1970 do not resolve nanoseconds. Times are
in such seconds, and exact in the attribute ``nanoseconds_since_1970``, as decimal digits. The file ends with the SHA-256 of all bytes
before it (the seal), which other readers of NetCDF ignore.

The compact form has the modes and the unknowns' patterns in float32, and of the covariance P the directions V of all variances M that
differ from the prior's 1 by more than 1e-6:

    P = I - V (I - M) V',    V' V = I,    M diagonal.

A pattern that is a product of a depth function and modes is stored as its factors. All other arrays are unchanged, and the velocity at the
estimate's time is exact.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.atomic import sealed, unsealed
from replay_kit.core.files.inputs import (
    claim_text,
    exceeds_claim,
    is_dimension,
    open_input,
    plain_attribute,
)
from replay_kit.core.files.paths import as_path
from replay_kit.core.flow.dataset import CF_TIME, LEAP_SECONDS, described_dataset, netcdf_bytes
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalFunctions,
    HorizontalKernel,
    NodeKernel,
    StreamFunctionLattice,
)
from replay_kit.core.flow.local import LocalCurrent, Oscillation, SurfaceCurrent
from replay_kit.core.flow.process import Process, Unknowns
from replay_kit.core.grid import Grid, Projection

if TYPE_CHECKING:
    import h5py
    import xarray as xr

FORMAT, FORMAT_VERSION = "replay_kit.FlowEstimate", 7
# a flow without uncertainty has the same form there
_EARLIER = 6
_EXACT_TIME = "nanoseconds_since_1970"
_KINDS = {"node kernel": NodeKernel, "stream function lattice": StreamFunctionLattice}

#: Variables: name, what of the flow it holds, dimensions, unit and meaning; and attributes: numbers, texts, and times as decimal digits.
#: Those that a flow has not, or that are empty, are left out.
FIELDS = [
    row.split(" | ")
    for row in (
        "depth | grid.levels | depth | m, levels, positive down",
        "longitude | grid.longitude | y x | degrees east",
        "latitude | grid.latitude | y x | degrees north",
        "east | grid.east | y x | m, local east",
        "north | grid.north | y x | m, local north",
        # CF wants dimensions that are no axes, as a curvilinear grid's, before the depth
        "wet | grid.wet | y x depth | 1 where the forecast has a velocity",
        "latent | latent | function depth | latent values, one per horizontal function",
        "potential | potential | function depth | latent values of the part with divergence",
        "modes | modes | function mode | latent values of the modes",
        "node_east | horizontal.nodes.T.0 | node | m, local, of the nodes of the kernel",
        "node_north | horizontal.nodes.T.1 | node | m, local, of the nodes of the kernel",
        "offset | unknowns.offset | function depth | latent values where all weights are 0",
        "unknowns | unknowns.x | unknown | mean of the unknowns",
        "unknowns_covariance | unknowns.p | pair | covariance of the unknowns; its lower half, row by row",
        "error | unknowns.error | level wet_node | m/s, representation error",
        "measured | unknowns.measured | level | 1 for levels among those whose depths were measured",
        "mean | unknowns.process.mean | forecast level mode | mean of the weights",
        "moving | unknowns.process.moving | forecast moving_unknown vertical mode | weights of one unit of each unknown that moves",
        "fixed | unknowns.process.fixed | fixed_unknown vertical mode | weights of one unit of each other unknown",
        "spread | unknowns.process.spread | forecast | growth of these",
        "functions | unknowns.process.functions | vertical level | vertical functions",
        "tau | unknowns.process.tau | unknown | s, decorrelation time of each unknown",
        "forecast_time | unknowns.process.times_ns | forecast | times of the forecast",
        "time | time_ns |  | time of the estimate",
        "oscillation_omega | unknowns.oscillation.omega | oscillation | rad/s, angular velocity",
        "oscillation_cosine | unknowns.oscillation.cosine | oscillation component depth | m/s, local, of its cosine",
        "oscillation_sine | unknowns.oscillation.sine | oscillation component depth | m/s, local, of its sine",
        "local_probability | local.probability | local | probability of each process of the local correction",
        "local_std | local.std | local | m/s, stationary, of a component",
        "local_scale | local.scale | local | s, decorrelation time",
        "local_mean | local.mean | local component | m/s, local east and north, after the last dive",
        "local_cov | local.cov | local component component_2 | m2/s2, its covariance",
        "surface_east | surface.east | surface_x | m, local east, of the surface correction",
        "surface_north | surface.north | surface_y | m, local north",
        "surface_velocity | surface.velocity | surface_y surface_x component | m/s, local east and north",
        "surface_error | surface.error | surface_y surface_x | m/s, its standard error",
        "depth_function_kind | depth_functions.kind | attribute",
        "projection_longitude | grid.projection.longitude | attribute",
        "projection_latitude | grid.projection.latitude | attribute",
        "depth_function_length | depth_functions.length | attribute",
        "kernel_length_east | horizontal.kernel.length_east | attribute",
        "kernel_length_north | horizontal.kernel.length_north | attribute",
        "kernel_speed | horizontal.kernel.speed | attribute",
        "lattice_origin_east | horizontal.origin.0 | attribute",
        "lattice_origin_north | horizontal.origin.1 | attribute",
        "lattice_spacing_east | horizontal.spacing.0 | attribute",
        "lattice_spacing_north | horizontal.spacing.1 | attribute",
        "lattice_shape_east | horizontal.shape.0 | attribute",
        "lattice_shape_north | horizontal.shape.1 | attribute",
        "scale | unknowns.scale | attribute",
        "unknowns_time | unknowns.time_ns | attribute",
        "oscillation_scale | unknowns.oscillation.scale | attribute",
        "oscillation_time | unknowns.oscillation.time_ns | attribute",
        "local_time | local.time_ns | attribute",
        "surface_std | surface.std | attribute",
        "surface_depth | surface.depth | attribute",
        "surface_time | surface.time_ns | attribute",
    )
]
_STANDARD = {
    "depth": {"standard_name": "depth", "units": "m", "positive": "down", "axis": "Z"},
    "east": {"units": "m"},
    "north": {"units": "m"},
    "time": {"standard_name": "time", **CF_TIME, **LEAP_SECONDS},
    "forecast_time": {"units": CF_TIME["units"]},
}


def _symmetric(half: Array) -> Array:
    """Return a symmetric matrix from its lower triangle, row by row."""
    size = int(np.sqrt(2 * half.size))
    p, lower = np.empty((size, size)), np.tril_indices(size)
    p[lower] = p.T[lower] = half
    return p


# Values that the file has in another form: to it, and from it.
_CODED: dict[str, tuple[Callable[[Any], Array], Callable[[Any], Any]]] = {
    "wet": (
        lambda wet: np.moveaxis(wet, 0, -1).astype(np.int8),
        lambda wet: np.ascontiguousarray(np.moveaxis(wet, -1, 0).astype(bool)),
    ),
    "measured": (lambda seen: seen.astype(np.int8), lambda seen: seen.astype(bool)),
    "unknowns_covariance": (lambda p: p[np.tril_indices(len(p))], _symmetric),
}


def part_at(flow: FlowEstimate, names: str) -> Any:
    """Return a part of a flow by a dotted path of attributes and indices; None if absent."""
    part: Any = flow
    for name in names.split("."):
        part = part[int(name)] if name.isdigit() and part is not None else getattr(part, name, None)
    return part


def kind_of(flow: FlowEstimate) -> str:
    """Return the name of the kind of a flow's horizontal functions."""
    return next(name for name, kind in _KINDS.items() if isinstance(flow.horizontal, kind))


def to_lossless(flow: FlowEstimate) -> xr.Dataset:
    """Return the lossless dataset of a flow, the input of ``load``."""
    import xarray as xr  # loads slowly, and who reads a saved flow needs it not

    variables: dict[str, xr.Variable] = {}
    attrs: dict[str, Any] = {
        "replay_kit_format": FORMAT,
        "replay_kit_format_version": np.int32(FORMAT_VERSION),
        "horizontal_functions": kind_of(flow),
    }
    for name, names, dims, *words in FIELDS:
        values, is_time = part_at(flow, names), names.endswith("_ns")
        # NetCDF has no dimension of length zero that is not unlimited
        if values is None or not np.size(values):
            continue
        if not words:
            attrs[name] = str(values) if is_time or isinstance(values, str) else np.float64(values)
            continue
        about = {"long_name": words[0], **_STANDARD.get(name, {})}
        if is_time:
            about[_EXACT_TIME] = " ".join(map(str, np.ravel(values).tolist()))
            values = np.asarray(values) / 1e9
        to_file, _ = _CODED.get(name, (np.asarray, None))
        variables[name] = xr.Variable(dims.split(), to_file(values), about)
    if flow.span_ns is not None:
        attrs["data_span"] = "{} {}".format(*flow.span_ns)
    if flow.about:
        attrs["replay_kit_about"] = json.dumps(dict(flow.about))
    dataset = xr.Dataset(variables, attrs=attrs)
    return described_dataset(dataset, "Ocean current estimate without loss", "save", flow.about)


def save_bytes(flow: FlowEstimate) -> bytes:
    """Return the sealed bytes of a saved flow; equal flows and libraries give equal bytes."""
    return sealed(netcdf_bytes(to_lossless(flow)))


def load(path: str | Path) -> FlowEstimate:
    """Return the flow that ``FlowEstimate.save`` wrote.

    Raises:
        ForecastError: The file is missing, damaged, not such a file, or of another format version.
    """
    path = as_path(path, "estimate")
    try:
        if why := exceeds_claim(path, path.stat().st_size):
            raise ForecastError(f"{path}: cannot read the flow: {why}; is it complete?")
        with open_input(path) as file:
            return load_bytes(file.read(), str(path))
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the flow: {error.strerror}") from error


def load_bytes(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of a saved file's bytes.

    Args:
        data: Bytes of the file.
        name: Name of the data in errors.

    Raises:
        ForecastError: See ``load``.
    """
    # here, because the estimate in a result needs none
    import h5py

    try:
        content = unsealed(data)
        # by the HDF5 library alone: xarray takes longer to load than a mission to plan
        with h5py.File(io.BytesIO(data if content is None else content)) as file:
            attrs = _attributes(file)
            kind, version = (attrs.get(f"replay_kit_format{part}") for part in ("", "_version"))
            earlier = version == _EARLIER and "modes" not in file
            if kind == FORMAT and (version == FORMAT_VERSION or earlier):
                if content is None:
                    raise ValueError(
                        "its checksum is missing: it was cut, or written by another program"
                    )
                return flow_of(attrs, _values(file, len(data)))
    # what the HDF5 library and the values of a damaged file lead to has no end
    except Exception as error:
        raise ForecastError(
            f"{name}: expected a file of --save-estimate (NetCDF-4), but it is not one, or is damaged: {error}; "
            "copy it again from where it was written, or save it again"
        ) from error
    if kind != FORMAT:
        raise ForecastError(
            f"{name}: expected a file of --save-estimate, got another NetCDF file (no attribute replay_kit_format = {FORMAT})"
        )
    raise ForecastError(
        f"{name}: an estimate written by replay-kit 0.3 or earlier (format version {version}), but this version reads format "
        f"{FORMAT_VERSION}: export it with 0.3, or replay the log again"
    )


def _values(file: h5py.File, size: int) -> dict[str, Any]:
    """Return the values of a file's variables and attributes by their place in the flow.

    Raises:
        ValueError: The values claim more bytes than a file of this size can hold.
    """
    # a dimension without a variable is an array of NetCDF-4 too, and takes its name from another
    arrays = {
        name.removeprefix("_nc4_non_coord_"): array
        for name, array in file.items()
        if not is_dimension(array)
    }
    if why := claim_text(sum(array.nbytes for array in arrays.values()), size):
        raise ValueError(why)
    found, attrs = dict[str, Any](), _attributes(file)
    for name, names, dims, *words in FIELDS:
        is_time = names.endswith("_ns")
        if not words and name in attrs:
            found[names] = int(attrs[name]) if is_time else attrs[name]
        elif name in arrays and is_time:
            times = np.array(_attributes(arrays[name])[_EXACT_TIME].split(), dtype=np.int64)
            found[names] = times if dims else int(times[0])
        elif name in arrays:
            _, from_file = _CODED.get(name, (None, np.asarray))
            found[names] = from_file(arrays[name][()])
    return found


def _attributes(item: h5py.HLObject) -> dict[str, Any]:
    """Return the attributes of a file or dataset of HDF5."""
    return {name: plain_attribute(value) for name, value in item.attrs.items()}


def flow_of(attrs: Mapping[str, Any], found: dict[str, Any]) -> FlowEstimate:
    """Return the flow from a file's attributes and its values by their place in the flow.

    Raises:
        KeyError, TypeError: A part is missing.
        ValueError: The parts are inconsistent.
    """

    def part_of(part: str) -> dict[str, Any]:
        """Return the components of a part of the flow, given by a dotted path."""
        named = (key.rpartition(".") for key in found)
        return {name: found[f"{whole}{dot}{name}"] for whole, dot, name in named if whole == part}

    horizontal, unknowns = _horizontal(attrs["horizontal_functions"], part_of), None
    latent, kind = found["latent"], found["depth_functions.kind"]
    if kind not in ("hat", "gaussian") or latent.shape[0] != horizontal.size:
        raise ValueError(
            f"depth functions {kind!r} and {latent.shape[0]} latent rows do not fit {horizontal.size} horizontal functions"
        )
    if "unknowns.x" in found:
        parts, mean = part_of("unknowns.process"), found["unknowns.process.mean"]
        shape = len(parts["functions"]), mean.shape[2]
        nothing = {"moving": np.empty((len(mean), 0, *shape)), "fixed": np.empty((0, *shape))}
        turning, held = part_of("unknowns.oscillation"), {"time_ns": None, **part_of("unknowns")}
        unknowns = Unknowns(
            process=Process(**nothing | parts),
            oscillation=Oscillation(**turning) if turning else None,
            scaled=held.pop("scale"),
            **held,
        )
    first, last = map(int, attrs.get("data_span", "0 0").split())
    return FlowEstimate(
        grid=Grid(Projection(**part_of("grid.projection")), **part_of("grid")),
        horizontal=horizontal,
        depth_functions=DepthFunctions(**part_of("depth_functions")),
        unknowns=unknowns,
        local=LocalCurrent(**part_of("local")) if part_of("local") else None,
        surface=SurfaceCurrent(**part_of("surface")) if part_of("surface") else None,
        about=json.loads(attrs.get("replay_kit_about", "{}")),
        span_ns=(first, last) if "data_span" in attrs else None,
        **{"modes": np.empty((latent.shape[0], 0)), "time_ns": None} | part_of(""),
    )


def _horizontal(kind: str, parts_of: Callable[[str], dict[str, Any]]) -> HorizontalFunctions:
    """Return horizontal functions from their kind and parts."""
    if kind not in _KINDS:
        raise ValueError(
            f"horizontal functions {kind!r}; expected {' or '.join(map(repr, _KINDS))}"
        )
    kernel = HorizontalKernel(**parts_of("horizontal.kernel"))
    if _KINDS[kind] is NodeKernel:
        return NodeKernel(kernel, np.column_stack(list(parts_of("horizontal.nodes.T").values())))
    origin, spacing, shape = (
        tuple(parts_of(f"horizontal.{part}").values()) for part in ("origin", "spacing", "shape")
    )
    return StreamFunctionLattice(kernel, origin, spacing, (int(shape[0]), int(shape[1])))


# Largest difference of a variance from the prior's that counts for nothing, and of a product from a pattern, of the pattern.
_VARIANCE, _PRODUCT = 1e-6, 1e-9
_COVARIANCE, _FIXED = "unknowns_covariance", "fixed"


def pack(flow: FlowEstimate) -> bytes:
    """Return a flow as the bytes of an archive of arrays (``.npz``); equal flows give equal bytes."""
    arrays = {
        name: np.asarray(value)
        for name, names, *_ in FIELDS
        if (value := part_at(flow, names)) is not None and np.size(value)
    }
    arrays["horizontal_functions"] = np.array(kind_of(flow))
    arrays["about"] = np.array(json.dumps(dict(flow.about)))
    if flow.span_ns is not None:
        arrays["data_span"] = np.array("{} {}".format(*flow.span_ns))
    if _COVARIANCE in arrays:
        arrays["variances"], arrays["directions"] = _eigen_parts(arrays.pop(_COVARIANCE))
    if _FIXED in arrays:
        arrays |= _factors(arrays.pop(_FIXED))
    for name in {"modes", "moving", "directions", _FIXED, "fixed_modes"} & arrays.keys():
        arrays[name] = arrays[name].astype(np.float32)
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]  # names of arrays, not of options
    return file.getvalue()


def unpack(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of the bytes of ``pack``.

    Args:
        data: Bytes of ``pack``.
        name: Name of the data in errors.

    Raises:
        ForecastError: The data are damaged or of another kind.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {
                key: each.astype(np.float64) if each.dtype == np.float32 else each
                for key, each in file.items()
            }
        if "variances" in arrays:
            # float32 left the directions nearly orthogonal
            orthogonal, _ = np.linalg.qr(arrays["directions"])
            p = np.eye(len(orthogonal)) - orthogonal * (1.0 - arrays["variances"]) @ orthogonal.T
            arrays[_COVARIANCE] = (p + p.T) / 2.0
        if "fixed_modes" in arrays:
            arrays[_FIXED] = arrays["fixed_depths"][..., None] * arrays["fixed_modes"][:, None]
        attributes = {
            "horizontal_functions": arrays["horizontal_functions"].item(),
            "replay_kit_about": arrays["about"].item(),
        }
        if "data_span" in arrays:
            attributes["data_span"] = arrays["data_span"].item()
        found = {
            names: arrays[key] if arrays[key].ndim else arrays[key].item()
            for key, names, *_ in FIELDS
            if key in arrays
        }
        return flow_of(attributes, found)
    # what damaged bytes lead to has no end
    except Exception as error:
        raise ForecastError(
            f"{name}: expected an estimate of a result, but it is not one, or is damaged: {error}; replay the log again"
        ) from error


def _eigen_parts(p: Array) -> tuple[Array, Array]:
    """Return M, shape (n,), and V, shape (k, n), of a covariance."""
    less = np.eye(len(p)) - p
    # loads slowly, and what reads an estimate needs none
    from scipy.linalg.lapack import dpstrf

    lower, pivots, rank, _ = dpstrf(less, tol=1e-13, lower=1)
    factor = np.zeros((len(p), rank))
    factor[pivots - 1] = np.tril(lower)[:, :rank]
    if np.abs(less - factor @ factor.T).max(initial=0.0) > _VARIANCE**2:
        # some variance is larger than the prior's
        values, vectors = np.linalg.eigh(less)
    else:
        values, turned = np.linalg.eigh(factor.T @ factor)
        vectors = factor @ turned / np.sqrt(np.maximum(values, 1e-300))
    kept = np.abs(values) > _VARIANCE
    return 1.0 - values[kept], vectors[:, kept]


def _factors(patterns: Array) -> dict[str, Array]:
    """Return patterns, shape (B, K, r), by their stored names: as factors if all are products."""
    rows, largest = np.arange(len(patterns)), np.abs(patterns).max(axis=2).argmax(axis=1)
    of_modes = patterns[rows, largest]
    norm = np.maximum(np.sum(of_modes**2, axis=1), 1e-300)
    depths = np.einsum("bkr,br->bk", patterns, of_modes) / norm[:, None]
    apart = np.abs(patterns - depths[..., None] * of_modes[:, None]).max()
    if apart > _PRODUCT * np.abs(patterns).max():
        return {_FIXED: patterns}
    return {"fixed_depths": depths, "fixed_modes": of_modes}
