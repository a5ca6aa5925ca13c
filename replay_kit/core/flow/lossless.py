"""The lossless NetCDF form of a flow: the arrays that it is made of, bit for bit, with metadata after CF-1.8.

CF-1.8 has no 64-bit integers, and no floating-point number of seconds since 1970 holds nanoseconds. The coordinate ``time`` is therefore
in float64 seconds, for any reader, and its attribute ``nanoseconds_since_1970`` holds the exact time as decimal digits, for this one.
"""

import numpy as np
import xarray as xr

from replay_kit import __version__
from replay_kit.core.flow.depth import DepthFunctions
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.horizontal import HorizontalKernel
from replay_kit.core.grid import Grid, Projection

FORMAT = "replay_kit.FlowEstimate"
# since version 2 time is in seconds, with its nanoseconds in an attribute, and wet has the depth last; in version 1 time was an integer of
# nanoseconds, and the depth came first
FORMAT_VERSION = 2
READ_VERSIONS = (1, 2)
CONVENTIONS = "CF-1.8"
CF_TIME = {"units": "seconds since 1970-01-01", "calendar": "standard"}

_EXACT_TIME = "nanoseconds_since_1970"


def history(made_by: str, flow: FlowEstimate) -> str:
    """Return the global attribute ``history``: program, version, function and the time of the estimate.

    CF leaves its form open. It has no time of writing, because the same flow must give the same bytes.

    Args:
        made_by: The function that made the dataset.
        flow: The flow.
    """
    at = "" if flow.time_ns is None else f", time = {np.datetime64(flow.time_ns, 'ns')}Z"
    return f"replay-kit {__version__}: {made_by}(flow{at})"


def to_lossless(flow: FlowEstimate) -> xr.Dataset:
    """Return the flow as the dataset from which ``from_lossless`` makes an equal one."""
    grid = flow.grid
    # NetCDF has no dimension of length zero that is not unlimited: a flow without uncertainty has neither modes nor weight_cov.
    values = {
        "depth": (("depth",), grid.levels, "m, levels, positive down"),
        "longitude": (("y", "x"), grid.longitude, "degrees east"),
        "latitude": (("y", "x"), grid.latitude, "degrees north"),
        "east": (("y", "x"), grid.east, "m, local east"),
        "north": (("y", "x"), grid.north, "m, local north"),
        # CF wants dimensions that are no axes, as a curvilinear grid's, before the depth
        "wet": (("y", "x", "depth"), np.moveaxis(grid.wet, 0, -1).astype(np.int8), "1 where the forecast has a velocity"),
        "latent": (("component_node", "depth"), flow.latent, "latent velocities, all east then all north"),
        **({"modes": (("component_node", "mode"), flow.modes, "latent velocities of the modes")} if flow.n_modes else {}),
        **({"weight_cov": (("weight", "weight_2"), flow.weight_cov, "covariance of weights, level after level")} if flow.n_modes else {}),
        **({"time": ((), np.float64(flow.time_ns / 1e9), "time of the estimate")} if flow.time_ns is not None else {}),
    }
    variables = {name: xr.Variable(dims, array, {"long_name": words}) for name, (dims, array, words) in values.items()}
    for name, about in _standard(flow).items():
        variables[name].attrs |= about
    numbers = {
        "projection_longitude": grid.projection.longitude,
        "projection_latitude": grid.projection.latitude,
        "kernel_length_east": flow.kernel.length_east,
        "kernel_length_north": flow.kernel.length_north,
        "kernel_speed": flow.kernel.speed,
        "depth_function_length": flow.depth_functions.length,
    }
    attrs = {
        "Conventions": CONVENTIONS,
        "title": "Ocean current estimate without loss",
        "history": history("save", flow),
        "replay_kit_format": FORMAT,
        "replay_kit_format_version": np.int32(FORMAT_VERSION),
        "source": f"replay-kit {__version__}",
        "depth_function_kind": flow.depth_functions.kind,
        **{name: np.float64(number) for name, number in numbers.items()},
    }
    return xr.Dataset(variables, attrs=attrs)


def from_lossless(dataset: xr.Dataset) -> FlowEstimate:
    """Return the flow of a dataset that was read without decoding times.

    Raises:
        KeyError: Something is missing in it.
        ValueError: Its parts do not fit together.
    """
    attrs = dataset.attrs
    values = {str(name): np.asarray(variable.values) for name, variable in dataset.variables.items()}
    grid = Grid(
        projection=Projection(float(attrs["projection_longitude"]), float(attrs["projection_latitude"])),
        longitude=values["longitude"],
        latitude=values["latitude"],
        east=values["east"],
        north=values["north"],
        levels=values["depth"],
        wet=np.ascontiguousarray(dataset["wet"].transpose("depth", "y", "x").values.astype(np.bool_)),
    )
    latent = values["latent"]
    kind = attrs["depth_function_kind"]
    if kind not in ("hat", "gaussian") or latent.shape[0] != 2 * int(grid.wet[0].sum()):
        raise ValueError(f"depth functions {kind!r} and {latent.shape[0]} latent rows do not fit {int(grid.wet[0].sum())} nodes")
    return FlowEstimate(
        grid=grid,
        kernel=HorizontalKernel(float(attrs["kernel_length_east"]), float(attrs["kernel_length_north"]), float(attrs["kernel_speed"])),
        depth_functions=DepthFunctions(kind, float(attrs["depth_function_length"])),
        latent=latent,
        modes=values.get("modes", np.empty((latent.shape[0], 0))),
        covariance=values.get("weight_cov", np.empty((0, 0))),
        time_ns=_time_ns(dataset),
    )


def _standard(flow: FlowEstimate) -> dict[str, dict[str, str]]:
    """Return the standard names and units of the variables that have them.

    Longitude and latitude have none here: they are numbers the flow is made of, as are the nodes, and no coordinates of the arrays.
    """
    named = {
        "depth": {"standard_name": "depth", "units": "m", "positive": "down", "axis": "Z"},
        "east": {"units": "m"},
        "north": {"units": "m"},
    }
    if flow.time_ns is not None:
        named["time"] = {"standard_name": "time", **CF_TIME, _EXACT_TIME: str(int(flow.time_ns))}
    return named


def _time_ns(dataset: xr.Dataset) -> int | None:
    """Return the exact time [ns, UTC] of either version; None for a flow that holds for no time."""
    if "time" not in dataset.variables:
        return None
    time = dataset.variables["time"]
    return int(time.values) if dataset.attrs["replay_kit_format_version"] == 1 else int(time.attrs[_EXACT_TIME])
