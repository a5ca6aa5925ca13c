"""The lossless NetCDF form of a flow: its arrays, bit for bit, with metadata after CF-1.8.

CF-1.8 has no 64-bit integers, and no floating-point number of seconds since 1970 holds nanoseconds. The coordinate ``time`` is therefore
in float64 seconds, for any reader, and its attribute ``nanoseconds_since_1970`` holds the exact time as decimal digits, for this one.

An estimate that changes with time is saved as the process model and the unknowns in it, from which any later estimate is made; the
covariance of its weights follows from theirs, which is smaller, and is not in the file.

The file ends with the SHA-256 of all bytes before it (``sealed.py``), which other readers of NetCDF pass over.

Of symmetric matrices the file has the lower half, row by row. The covariance of the weights is in it as its factors where these are fewer
numbers (``factors.py``).
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.atomic import write_whole
from replay_kit.core.flow.cf import CF_TIME, LEAP_SECONDS, Encoding, described
from replay_kit.core.flow.evolution import Evolution, constant
from replay_kit.core.flow.factors import CovarianceFactors, half_of
from replay_kit.core.flow.field import FlowField
from replay_kit.core.flow.functions import HorizontalFunctions, NodeKernel
from replay_kit.core.flow.lattice import StreamFunctionLattice
from replay_kit.core.flow.local import LocalCurrent
from replay_kit.core.sealed import sealed
from replay_kit.core.version import __version__

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "replay_kit.FlowEstimate"
# since version 6 the file ends with its checksum
# since version 5 covariances are halves, or factors; since version 4 the file says which horizontal functions the flow has, and a node
# kernel's nodes; before, all were kernels of the grid's nodes; since version 3 it says how the flow changes with time; since version 2 time
# is in seconds, with its nanoseconds in an attribute, and wet has the depth last; in version 1 time was an integer of nanoseconds, and the
# depth came first
FORMAT_VERSION = 6
READ_VERSIONS = (1, 2, 3, 4, 5, 6)
#: Since which version the file ends with its checksum.
SEALED_VERSION = 6

#: What ``horizontal_functions`` may be.
NODE_KERNEL, LATTICE = "node kernel", "stream function lattice"
EXACT_TIME = "nanoseconds_since_1970"
_AXES = ("east", "north")

#: Name to dimensions, array and meaning.
_Values = dict[str, tuple[tuple[str, ...], Array, str]]


def history(made_by: str, flow: FlowField) -> str:
    """Return the global attribute ``history``: program, version, function and the time of the estimate.

    CF leaves its form open. It has no time of writing, because the same flow must give the same bytes.

    Args:
        made_by: The function that made the dataset.
        flow: The flow.
    """
    at = "" if flow.time_ns is None else f", time = {np.datetime64(flow.time_ns, 'ns')}Z"
    return f"replay-kit {__version__}: {made_by}(flow{at})"


def to_lossless(flow: FlowField) -> xr.Dataset:
    """Return the flow as the dataset from which ``load`` makes an equal one."""
    import xarray as xr  # loads slowly, and who reads a saved flow needs it not

    kind, of_functions, numbers_of_functions = _horizontal(flow.horizontal)
    grid, evolution = flow.grid, flow.later.trimmed() if isinstance(flow.later, Evolution) else None
    # NetCDF has no dimension of length zero that is not unlimited: a flow without uncertainty has neither modes nor weight_cov.
    values = {
        "depth": (("depth",), grid.levels, "m, levels, positive down"),
        "longitude": (("y", "x"), grid.longitude, "degrees east"),
        "latitude": (("y", "x"), grid.latitude, "degrees north"),
        "east": (("y", "x"), grid.east, "m, local east"),
        "north": (("y", "x"), grid.north, "m, local north"),
        # CF wants dimensions that are no axes, as a curvilinear grid's, before the depth
        "wet": (
            ("y", "x", "depth"),
            np.moveaxis(grid.wet, 0, -1).astype(np.int8),
            "1 where the forecast has a velocity",
        ),
        "latent": (("function", "depth"), flow.latent, "latent values, one a horizontal function"),
        **(
            {"modes": (("function", "mode"), flow.modes, "latent values of the modes")}
            if flow.n_modes
            else {}
        ),
        **of_functions,
        **(_weight_cov(flow) if evolution is None else _evolution(evolution)),
        **({} if flow.local is None else _local(flow.local)),
        **(
            {"time": ((), np.float64(flow.time_ns / 1e9), "time of the estimate")}
            if flow.time_ns is not None
            else {}
        ),
    }
    variables = {
        name: xr.Variable(dims, array, {"long_name": words})
        for name, (dims, array, words) in values.items()
    }
    for name, about in _standard(flow).items():
        variables[name].attrs |= about
    numbers = {
        "projection_longitude": grid.projection.longitude,
        "projection_latitude": grid.projection.latitude,
        "depth_function_length": flow.depth_functions.length,
        **numbers_of_functions,
    }
    attrs: dict[str, object] = {
        "replay_kit_format": FORMAT,
        "replay_kit_format_version": np.int32(FORMAT_VERSION),
        "horizontal_functions": kind,
        "depth_function_kind": flow.depth_functions.kind,
        "evolution": "constant"
        if flow.later is constant
        else "none"
        if evolution is None
        else "process",
        **{name: np.float64(number) for name, number in numbers.items()},
    }
    if evolution is not None:
        process = evolution.process
        attrs |= {
            name: np.float64(getattr(process, name)) for name in ("trajectory_scale", "local_scale")
        }
        variables["forecast_time"].attrs |= {
            "units": CF_TIME["units"],
            EXACT_TIME: " ".join(map(str, process.times_ns)),
        }
        if evolution.oscillation is not None:
            attrs |= {
                "oscillation_scale": np.float64(evolution.oscillation.scale),
                "oscillation_time": str(evolution.oscillation.time_ns),
            }
        if evolution.time_ns is not None:
            attrs["evolution_time"] = str(evolution.time_ns)
    if flow.local is not None:
        attrs["local_time"] = str(flow.local.time_ns)
    if flow.about:
        attrs["replay_kit_about"] = json.dumps(dict(flow.about))
    made_by = history("save", flow)
    return described(
        xr.Dataset(variables, attrs=attrs),
        "Ocean current estimate without loss",
        made_by,
        flow.about,
    )


def _horizontal(functions: HorizontalFunctions) -> tuple[str, _Values, dict[str, float]]:
    """Return the kind of the horizontal functions, their arrays and their numbers."""
    numbers = {
        f"kernel_{name}": getattr(functions.kernel, name)
        for name in ("length_east", "length_north", "speed")
    }
    if isinstance(functions, NodeKernel):
        words = "m, local {}, of the nodes of the kernel, whose latent values are all east then all north"
        return (
            NODE_KERNEL,
            {
                f"node_{name}": (("node",), functions.nodes[:, i], words.format(name))
                for i, name in enumerate(_AXES)
            },
            numbers,
        )
    if not isinstance(functions, StreamFunctionLattice):
        raise TypeError(f"no form of {type(functions).__name__} in a file is known")
    for part in ("origin", "spacing", "shape"):
        numbers |= {
            f"lattice_{part}_{axis}": value
            for axis, value in zip(_AXES, getattr(functions, part), strict=True)
        }
    return LATTICE, {}, numbers


def _weight_cov(flow: FlowField) -> _Values:
    if not flow.n_modes:
        return {}
    kept = flow.kept_covariance
    if not isinstance(kept, CovarianceFactors):
        return {"weight_cov": _half(kept, "weight", "covariance of weights, level after level")}
    values: _Values = {
        "covariance_factor": (
            ("row", "depth", "mode"),
            kept.prior.factor,
            "rows whose outer products are a part of the prior covariance",
        ),
        "covariance_vertical": (
            ("vertical_function", "depth"),
            kept.prior.vertical,
            "vertical functions of the other part",
        ),
        "covariance_horizontal": _half(
            kept.prior.horizontal,
            "mode",
            "covariance of the modes' amplitudes in each vertical function",
        ),
        "covariance_directions": (
            ("direction", "mode"),
            kept.directions,
            "directions of the modes that were measured",
        ),
        "covariance_matrix": _half(
            kept.matrix,
            "measured",
            "what measurements took from the prior covariance, in these directions",
        ),
    }
    return {name: value for name, value in values.items() if value[1].size}


def _half(matrix: Array, what: str, words: str) -> tuple[tuple[str, ...], Array, str]:
    """Return a symmetric matrix, or several, as a half; one that is not symmetric to the last bit as it is."""
    if not np.array_equal(matrix, np.swapaxes(matrix, -1, -2), equal_nan=True):
        return (what, f"{what}_2"), matrix, words
    more = ("group",) if matrix.ndim == 3 else ()
    return (*more, f"{what}_pair"), half_of(matrix), f"{words}; its lower half, row by row"


def _evolution(evolution: Evolution) -> _Values:
    process = evolution.process
    values: _Values = {
        "offset": (
            ("function", "depth"),
            evolution.offset,
            "latent values where all weights are 0",
        ),
        "forecast_time": (("forecast",), process.times_ns / 1e9, "times of the forecast"),
        "process_mean": (("forecast", "level", "mode"), process.mean, "mean of the weights"),
        "trajectories": (
            ("forecast", "member", "level", "mode"),
            process.trajectories,
            "weights of one unit of each mixture's unknown",
        ),
        "spread": (("forecast",), process.spread, "growth of the local corrections"),
        "local": (
            ("correction", "level", "mode"),
            process.local,
            "weights of one unit of each local correction's unknown",
        ),
        "unknown_mean": (
            ("unknown",),
            evolution.mean,
            "mean of the unknowns, those of mixtures first",
        ),
        "unknown_cov": _half(evolution.covariance(), "unknown", "covariance of the unknowns"),
    }
    if (known := evolution.oscillation) is not None:
        values["oscillation_omega"] = (
            ("oscillation",),
            known.omega,
            "rad/s, angular velocity of each oscillation",
        )
        for name, array in (("cosine", known.cosine), ("sine", known.sine)):
            values[f"oscillation_{name}"] = (
                ("oscillation", "component", "depth"),
                array,
                f"m/s, local, of its {name}",
            )
    return {name: value for name, value in values.items() if value[1].size}


def _local(local: LocalCurrent) -> _Values:
    return {
        "local_probability": (
            ("local",),
            local.probability,
            "probability of each process of the current beside the flow",
        ),
        "local_std": (("local",), local.std, "m/s, of a component in the long run"),
        "local_scale": (("local",), local.scale, "s, decorrelation time"),
        "local_mean": (
            ("local", "component"),
            local.mean,
            "m/s, local east and north, after the last dive",
        ),
        "local_cov": (("local", "component", "component_2"), local.cov, "m2/s2, its covariance"),
    }


def _standard(flow: FlowField) -> dict[str, dict[str, str]]:
    """Return the standard names and units of the variables that have them.

    Longitude and latitude have none here: they are numbers the flow is made of, and no coordinates of the arrays.
    """
    named = {
        "depth": {"standard_name": "depth", "units": "m", "positive": "down", "axis": "Z"},
        "east": {"units": "m"},
        "north": {"units": "m"},
    }
    if flow.time_ns is not None:
        named["time"] = {
            "standard_name": "time",
            **CF_TIME,
            **LEAP_SECONDS,
            EXACT_TIME: str(int(flow.time_ns)),
        }
    return named


def save(flow: FlowField, path: Path) -> None:
    """Write the flow without loss; ``load`` gives equal arrays, bit for bit. The file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    data = save_bytes(flow)
    write_whole(Path(path), data)


def save_bytes(flow: FlowField) -> bytes:
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
    data = _bytes(dataset, encoding)
    write_whole(path, data)


def _bytes(dataset: xr.Dataset, encoding: Encoding) -> bytes:
    """Return a dataset as the bytes of a NetCDF-4 file.

    ``to_netcdf`` would take a lock named after the buffer's address from the scheduler, where the process is a worker of Dask. Addresses
    are used again by other missions, and the scheduler then no longer knows the lock. No other thread sees the buffer.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    buffer = BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file), encoding=encoding)
    return buffer.getvalue()
