"""The lossless NetCDF form of a flow: its arrays, bit for bit, by one table, with metadata after CF-1.8.

CF-1.8 has no 64-bit integers, and no floating-point number of seconds since 1970 holds nanoseconds. Times are therefore in float64 seconds,
for any reader, and the attribute ``nanoseconds_since_1970`` holds them exactly, as decimal digits, for this one.

The file ends with the SHA-256 of all bytes before it (``sealed.py``), which other readers of NetCDF pass over.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.atomic import write_whole
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.cf import CF_TIME, LEAP_SECONDS, Encoding, described, history
from replay_kit.core.flow.estimate import FlowEstimate, Unknowns
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalFunctions,
    HorizontalKernel,
    NodeKernel,
)
from replay_kit.core.flow.lattice import StreamFunctionLattice
from replay_kit.core.flow.local import LocalCurrent, Oscillation
from replay_kit.core.flow.process import Process
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.inputs import (
    claim_text,
    exceeds_claim,
    is_dimension,
    open_input,
    plain_attribute,
)
from replay_kit.core.paths import as_path
from replay_kit.core.sealed import sealed, unsealed

if TYPE_CHECKING:
    import xarray as xr

FORMAT, FORMAT_VERSION = "replay_kit.FlowEstimate", 7
_EARLIER = (6,)
EXACT_TIME = "nanoseconds_since_1970"
_NODE_KERNEL, _LATTICE = "node kernel", "stream function lattice"
_AXES = ("east", "north")


class Field(NamedTuple):
    """A variable of the file.

    Attributes:
        name: In the file.
        dims: Names of its dimensions.
        words: Unit and meaning.
        of: Returns its values; None where the flow has none.
    """

    name: str
    dims: tuple[str, ...]
    words: str
    of: Callable[[FlowEstimate], Array | None]


def _part(owner: str, name: str) -> Callable[[FlowEstimate], Array | None]:
    """Return what returns an attribute of a part of a flow, such as ``unknowns.process``, where it has that part."""

    def value(flow: FlowEstimate) -> Array | None:
        held: Any = flow
        for step in owner.split("."):
            held = None if held is None else getattr(held, step)
        return None if held is None else np.asarray(getattr(held, name))

    return value


_PROCESS, _LOCAL = "unknowns.process", "local"
FIELDS = (
    Field("depth", ("depth",), "m, levels, positive down", lambda flow: flow.grid.levels),
    Field("longitude", ("y", "x"), "degrees east", _part("grid", "longitude")),
    Field("latitude", ("y", "x"), "degrees north", _part("grid", "latitude")),
    Field("east", ("y", "x"), "m, local east", _part("grid", "east")),
    Field("north", ("y", "x"), "m, local north", _part("grid", "north")),
    # CF wants dimensions that are no axes, as a curvilinear grid's, before the depth
    Field(
        "wet",
        ("y", "x", "depth"),
        "1 where the forecast has a velocity",
        lambda flow: np.moveaxis(flow.grid.wet, 0, -1).astype(np.int8),
    ),
    Field(
        "latent",
        ("function", "depth"),
        "latent values, one a horizontal function",
        lambda flow: flow.latent,
    ),
    Field(
        "potential",
        ("function", "depth"),
        "latent values of the part with divergence",
        lambda flow: flow.potential,
    ),
    Field("modes", ("function", "mode"), "latent values of the modes", lambda flow: flow.modes),
    Field(
        "node_east", ("node",), "m, local, of the nodes of the kernel", lambda flow: _node(flow, 0)
    ),
    Field(
        "node_north", ("node",), "m, local, of the nodes of the kernel", lambda flow: _node(flow, 1)
    ),
    Field(
        "offset",
        ("function", "depth"),
        "latent values where all weights are 0",
        _part("unknowns", "offset"),
    ),
    Field("unknowns", ("unknown",), "mean of the unknowns", _part("unknowns", "x")),
    Field(
        "unknowns_covariance",
        ("pair",),
        "covariance of the unknowns; its lower half, row by row",
        lambda flow: _half(flow),
    ),
    Field(
        "error",
        ("level", "wet_node"),
        "m/s, what the unknowns do not hold",
        _part("unknowns", "error"),
    ),
    Field(
        "measured",
        ("level",),
        "1 for levels among those whose depths were measured",
        lambda flow: _measured(flow),
    ),
    Field("mean", ("forecast", "level", "mode"), "mean of the weights", _part(_PROCESS, "mean")),
    Field(
        "moving",
        ("forecast", "moving_unknown", "vertical", "mode"),
        "weights of one unit of each unknown that moves",
        _part(_PROCESS, "moving"),
    ),
    Field(
        "fixed",
        ("fixed_unknown", "vertical", "mode"),
        "weights of one unit of each other unknown",
        _part(_PROCESS, "fixed"),
    ),
    Field("spread", ("forecast",), "growth of these", _part(_PROCESS, "spread")),
    Field("functions", ("vertical", "level"), "vertical functions", _part(_PROCESS, "functions")),
    Field("tau", ("unknown",), "s, decorrelation time of each unknown", _part(_PROCESS, "tau")),
    Field(
        "forecast_time",
        ("forecast",),
        "times of the forecast",
        lambda flow: _seconds(_part(_PROCESS, "times_ns")(flow)),
    ),
    Field("time", (), "time of the estimate", lambda flow: _seconds(flow.time_ns)),
    *(
        Field(f"oscillation_{name}", dims, words, _part("oscillation", name))
        for name, dims, words in (
            ("omega", ("oscillation",), "rad/s, angular velocity"),
            ("cosine", ("oscillation", "component", "depth"), "m/s, local, of its cosine"),
            ("sine", ("oscillation", "component", "depth"), "m/s, local, of its sine"),
        )
    ),
    *(
        Field(f"local_{name}", dims, words, _part(_LOCAL, name))
        for name, dims, words in (
            (
                "probability",
                ("local",),
                "probability of each process of the current beside the flow",
            ),
            ("std", ("local",), "m/s, of a component in the long run"),
            ("scale", ("local",), "s, decorrelation time"),
            ("mean", ("local", "component"), "m/s, local east and north, after the last dive"),
            ("cov", ("local", "component", "component_2"), "m2/s2, its covariance"),
        )
    ),
)
_STANDARD = {
    "depth": {"standard_name": "depth", "units": "m", "positive": "down", "axis": "Z"},
    "east": {"units": "m"},
    "north": {"units": "m"},
    "time": {"standard_name": "time", **CF_TIME, **LEAP_SECONDS},
    "forecast_time": {"units": CF_TIME["units"]},
}


def to_lossless(flow: FlowEstimate) -> xr.Dataset:
    """Return the flow as the dataset from which ``load`` makes an equal one."""
    import xarray as xr  # loads slowly, and who reads a saved flow needs it not

    variables = {}
    for each in FIELDS:
        values = each.of(flow)
        # NetCDF has no dimension of length zero that is not unlimited
        if values is not None and np.asarray(values).size:
            about = {"long_name": each.words, **_STANDARD.get(each.name, {})}
            variables[each.name] = xr.Variable(each.dims, values, about)
    unknowns, kernel = flow.unknowns, flow.horizontal.kernel
    exact = {"time": [flow.time_ns]}
    if unknowns is not None:
        exact["forecast_time"] = unknowns.process.times_ns.tolist()
    for name, times in exact.items():
        if name in variables:
            variables[name].attrs[EXACT_TIME] = " ".join(map(str, times))
    numbers = {
        "projection_longitude": flow.grid.projection.longitude,
        "projection_latitude": flow.grid.projection.latitude,
        "depth_function_length": flow.depth_functions.length,
        **{
            f"kernel_{name}": getattr(kernel, name)
            for name in ("length_east", "length_north", "speed")
        },
    }
    if isinstance(flow.horizontal, StreamFunctionLattice):
        for part in ("origin", "spacing", "shape"):
            pair = zip(_AXES, getattr(flow.horizontal, part), strict=True)
            numbers |= {f"lattice_{part}_{axis}": value for axis, value in pair}
    if unknowns is not None:
        numbers["scale"] = unknowns.scale
    attrs: dict[str, object] = {
        "replay_kit_format": FORMAT,
        "replay_kit_format_version": np.int32(FORMAT_VERSION),
        "horizontal_functions": _NODE_KERNEL
        if isinstance(flow.horizontal, NodeKernel)
        else _LATTICE,
        "depth_function_kind": flow.depth_functions.kind,
        **{name: np.float64(number) for name, number in numbers.items()},
    }
    if unknowns is not None and unknowns.time_ns is not None:
        attrs["unknowns_time"] = str(unknowns.time_ns)
    if flow.oscillation is not None:
        attrs["oscillation_scale"] = np.float64(flow.oscillation.scale)
        attrs["oscillation_time"] = str(flow.oscillation.time_ns)
    if flow.local is not None:
        attrs["local_time"] = str(flow.local.time_ns)
    if flow.span_ns is not None:
        attrs["data_span"] = "{} {}".format(*flow.span_ns)
    if flow.about:
        attrs["replay_kit_about"] = json.dumps(dict(flow.about))
    dataset, made_by = xr.Dataset(variables, attrs=attrs), history("save", flow.time_ns)
    return described(dataset, "Ocean current estimate without loss", made_by, flow.about)


def save(flow: FlowEstimate, path: Path) -> None:
    """Write the flow without loss; ``load`` gives equal arrays, bit for bit. The file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_whole(Path(path), save_bytes(flow))


def save_bytes(flow: FlowEstimate) -> bytes:
    """Return the bytes of the file that ``save`` writes, with their seal; the same flow and libraries give the same bytes."""
    dataset = to_lossless(flow)
    return sealed(_bytes(dataset, {str(name): {"_FillValue": None} for name in dataset.variables}))


def write_dataset(dataset: xr.Dataset, path: Path, encoding: Encoding) -> None:
    """Write a dataset as NetCDF; the file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be created.
        ReplayKitError: It cannot be written to its end, as on a full disk.
    """
    # made in memory, since the HDF5 library crashes the process when a disk is full
    write_whole(path, _bytes(dataset, encoding))


def _bytes(dataset: xr.Dataset, encoding: Encoding) -> bytes:
    """Return a dataset as the bytes of a NetCDF-4 file.

    ``to_netcdf`` would take a lock named after the buffer's address from the scheduler, where the process is a worker of Dask. Addresses
    are used again by other missions, and the scheduler then no longer knows the lock. No other thread sees the buffer.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file), encoding=encoding)
    return buffer.getvalue()


def load(path: str | Path) -> FlowEstimate:
    """Return the flow that ``save`` wrote.

    Raises:
        ForecastError: The file is missing, damaged, not such a file, or of another format version.
    """
    path = as_path(path, "estimate")
    try:
        if why := exceeds_claim(path, path.stat().st_size):
            raise ForecastError(f"{path}: cannot read the flow: {why}; was it written whole?")
        with open_input(path) as file:
            return load_bytes(file.read(), str(path))
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the flow: {error.strerror}") from error


def load_bytes(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of a saved file's bytes, such as the attachment ``estimate.nc`` of a result MCAP.

    Args:
        data: The bytes.
        name: What to call them in errors.

    Raises:
        ForecastError: As for ``load``.
    """
    try:
        content = unsealed(data)
        # by the HDF5 library alone: xarray takes longer to load than a mission to plan
        with h5py.File(io.BytesIO(data if content is None else content)) as file:
            attrs = _attributes(file)
            kind, version = (attrs.get(f"replay_kit_format{part}") for part in ("", "_version"))
            # a flow without uncertainty has had the same form before
            certain = version in _EARLIER and "modes" not in file
            if kind == FORMAT and (version == FORMAT_VERSION or certain):
                if content is None:
                    raise ValueError(
                        "its checksum is missing: it was cut, or written by another program"
                    )
                return _flow(attrs, *_values(file, len(data)))
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


def _values(file: h5py.File, size: int) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the arrays of a file, and the exact times of those that state them.

    Raises:
        ValueError: They claim more bytes than a file of a size can hold.
    """
    # a dimension without a variable is an array of NetCDF-4 too, and takes its name from another
    arrays = {
        name.removeprefix("_nc4_non_coord_"): array
        for name, array in file.items()
        if not is_dimension(array)
    }
    if why := claim_text(sum(array.nbytes for array in arrays.values()), size):
        raise ValueError(why)
    exact = {n: _attributes(a)[EXACT_TIME] for n, a in arrays.items() if EXACT_TIME in a.attrs}
    return {name: np.asarray(array[()]) for name, array in arrays.items()}, exact


def _attributes(of: h5py.HLObject) -> dict[str, Any]:
    """Return the attributes of a file or an array."""
    return {name: plain_attribute(value) for name, value in of.attrs.items()}


def _flow(
    attrs: Mapping[str, Any], values: Mapping[str, Array], exact: Mapping[str, str]
) -> FlowEstimate:
    """Return the flow of what a file has.

    Raises:
        KeyError: Something is missing in it.
        ValueError: Its parts do not fit together.
    """
    place = (float(attrs[f"projection_{axis}"]) for axis in ("longitude", "latitude"))
    grid = Grid(
        projection=Projection(*place),
        **{name: values[name] for name in ("longitude", "latitude", "east", "north")},
        levels=values["depth"],
        wet=np.ascontiguousarray(np.moveaxis(values["wet"], -1, 0).astype(np.bool_)),
    )
    latent, functions, kind = (
        values["latent"],
        _horizontal(attrs, values),
        attrs["depth_function_kind"],
    )
    if kind not in ("hat", "gaussian") or latent.shape[0] != functions.size:
        raise ValueError(
            f"depth functions {kind!r} and {latent.shape[0]} latent rows do not fit {functions.size} horizontal functions"
        )
    local = None
    if "local_time" in attrs:
        names = ("probability", "std", "scale", "mean", "cov")
        parts = {name: values[f"local_{name}"] for name in names}
        local = LocalCurrent(**parts, time_ns=int(attrs["local_time"]))
    return FlowEstimate(
        grid=grid,
        horizontal=functions,
        depth_functions=DepthFunctions(kind, float(attrs["depth_function_length"])),
        latent=latent,
        modes=values.get("modes", np.empty((latent.shape[0], 0))),
        time_ns=int(exact["time"]) if "time" in values else None,
        unknowns=_unknowns(attrs, values, exact) if "unknowns" in values else None,
        potential=values.get("potential"),
        local=local,
        about=json.loads(str(attrs.get("replay_kit_about", "{}"))),
        span_ns=_span(attrs),
    )


def _span(attrs: Mapping[str, Any]) -> tuple[int, int] | None:
    if "data_span" not in attrs:
        return None
    first, last = map(int, attrs["data_span"].split())
    return first, last


def _unknowns(
    attrs: Mapping[str, Any], values: Mapping[str, Array], exact: Mapping[str, str]
) -> Unknowns:
    mean, functions = values["mean"], values["functions"]
    shape = len(functions), mean.shape[2]
    process = Process(
        times_ns=np.array(exact["forecast_time"].split(), dtype=np.int64),
        mean=mean,
        moving=values.get("moving", np.empty((len(mean), 0, *shape))),
        fixed=values.get("fixed", np.empty((0, *shape))),
        spread=values["spread"],
        functions=functions,
        tau=values["tau"],
    )
    p = np.empty((process.size, process.size))
    half = np.tril_indices(process.size)
    p[half] = p.T[half] = values["unknowns_covariance"]
    oscillation = None
    if "oscillation_omega" in values:
        omega, cosine, sine = (
            values[f"oscillation_{name}"] for name in ("omega", "cosine", "sine")
        )
        scale, time_ns = float(attrs["oscillation_scale"]), int(attrs["oscillation_time"])
        oscillation = Oscillation(omega, cosine, sine, scale, time_ns)
    return Unknowns(
        process,
        values["offset"],
        values["unknowns"],
        p,
        int(attrs["unknowns_time"]) if "unknowns_time" in attrs else None,
        values["error"],
        float(attrs["scale"]),
        oscillation,
        values["measured"].astype(bool) if "measured" in values else None,
    )


def _horizontal(attrs: Mapping[str, Any], values: Mapping[str, Array]) -> HorizontalFunctions:
    """Return the horizontal functions of a file."""
    kernel = HorizontalKernel(
        *(float(attrs[f"kernel_{name}"]) for name in ("length_east", "length_north", "speed"))
    )
    kind = attrs["horizontal_functions"]
    if kind == _NODE_KERNEL:
        return NodeKernel(kernel, np.column_stack([values["node_east"], values["node_north"]]))
    if kind != _LATTICE:
        raise ValueError(
            f"horizontal functions {kind!r}; expected {_NODE_KERNEL!r} or {_LATTICE!r}"
        )
    origin, spacing, shape = (
        [float(attrs[f"lattice_{part}_{axis}"]) for axis in _AXES]
        for part in ("origin", "spacing", "shape")
    )
    size = int(shape[0]), int(shape[1])
    return StreamFunctionLattice(kernel, (origin[0], origin[1]), (spacing[0], spacing[1]), size)


def _node(flow: FlowEstimate, axis: int) -> Array | None:
    """Return a coordinate of the nodes of a kernel, all east then all north; None of a lattice."""
    return flow.horizontal.nodes[:, axis] if isinstance(flow.horizontal, NodeKernel) else None


def _measured(flow: FlowEstimate) -> Array | None:
    known = None if flow.unknowns is None else flow.unknowns.measured
    return None if known is None else known.astype(np.int8)


def _half(flow: FlowEstimate) -> Array | None:
    return None if flow.unknowns is None else flow.unknowns.p[np.tril_indices(len(flow.unknowns.p))]


def _seconds(time_ns: Any) -> Array | None:
    return None if time_ns is None else np.asarray(time_ns) / 1e9
