"""Flows from the files that ``FlowEstimate.save`` writes, and from the attachment ``estimate.nc`` of a result MCAP."""

import io
import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.covariance import HybridCovariance
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import Evolution, ProcessModel, constant
from replay_kit.core.flow.factors import CovarianceFactors, half_size, whole_of
from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalFunctions,
    HorizontalKernel,
    NodeKernel,
)
from replay_kit.core.flow.lattice import StreamFunctionLattice
from replay_kit.core.flow.local import LocalCurrent, Oscillation
from replay_kit.core.flow.lossless import (
    EXACT_TIME,
    FORMAT,
    LATTICE,
    NODE_KERNEL,
    READ_VERSIONS,
    SEALED_VERSION,
)
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.inputs import (
    claim_text,
    exceeds_claim,
    is_dimension,
    open_input,
    plain_attribute,
)
from replay_kit.core.paths import as_path
from replay_kit.core.sealed import unsealed


@dataclass(frozen=True, slots=True)
class _Content:
    """What a file has, by name: its attributes, its arrays, and the exact times in nanoseconds as the arrays' attributes state them."""

    attrs: Mapping[str, Any]
    values: Mapping[str, Array]
    exact: Mapping[str, str]


def load(path: str | Path) -> FlowEstimate:
    """Return the flow that ``save`` wrote; a file of an earlier version without a checksum gives a warning.

    Raises:
        ForecastError: The file is missing, damaged, not such a file, or of another format version.
    """
    flow, note = load_noted(as_path(path, "estimate"))
    if note:
        warnings.warn(note, stacklevel=2)
    return flow


def load_noted(path: Path) -> tuple[FlowEstimate, str]:
    """Return the flow that ``save`` wrote, and what should be known of its file, empty where there is nothing.

    Raises:
        ForecastError: As for ``load``.
    """
    try:
        if why := exceeds_claim(path, path.stat().st_size):
            raise ForecastError(f"{path}: cannot read the flow: {why}; was it written whole?")
        with open_input(path) as file:
            data = file.read()
    except OSError as error:
        raise ForecastError(f"{path}: cannot read the flow: {error.strerror}") from error
    flow, checked = _load(data, str(path))
    note = f"{path}: has no checksum, as files of version 0.2.0, so that damage cannot be detected"
    return flow, "" if checked else note


def load_bytes(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of a saved file's bytes, such as the attachment ``estimate.nc`` of a result MCAP.

    Args:
        data: The bytes.
        name: What to call them in errors.

    Raises:
        ForecastError: As for ``load``.
    """
    return _load(data, name)[0]


def _load(data: bytes, name: str) -> tuple[FlowEstimate, bool]:
    """Return the flow of a saved file's bytes, and whether their checksum was compared."""
    try:
        content = unsealed(data)
        # by the HDF5 library alone: xarray takes longer to load than a mission to plan
        with h5py.File(io.BytesIO(data if content is None else content)) as file:
            attrs = _attributes(file)
            kind, version = (
                attrs.get("replay_kit_format"),
                attrs.get("replay_kit_format_version"),
            )
            if kind == FORMAT and version in READ_VERSIONS:
                if content is None and version >= SEALED_VERSION:
                    raise ValueError(
                        "its checksum is missing: it was cut, or written by another program"
                    )
                arrays = _arrays(file)
                if why := claim_text(sum(array.nbytes for array in arrays.values()), len(data)):
                    raise ValueError(why)
                values = {name: np.asarray(array[()]) for name, array in arrays.items()}
                exact = {
                    name: _attributes(array)[EXACT_TIME]
                    for name, array in arrays.items()
                    if EXACT_TIME in array.attrs
                }
                return _flow(_Content(attrs, values, exact)), content is not None
    # what the HDF5 library and the values of a damaged file without a checksum lead to has no end
    except Exception as error:
        raise ForecastError(
            f"{name}: expected a file of --save-estimate (NetCDF-4), but it is not one, or is damaged: {error}; "
            "copy it again from where it was written, or save it again"
        ) from error
    if kind != FORMAT:
        raise ForecastError(
            f"{name}: expected a file of --save-estimate, got another NetCDF file (no attribute replay_kit_format = {FORMAT})"
        )
    known = " and ".join(map(str, READ_VERSIONS))
    raise ForecastError(
        f"{name}: flow format version {version}, but this replay-kit reads versions {known}; write it again"
    )


def _arrays(file: h5py.File) -> dict[str, h5py.Dataset]:
    """Return the variables of a file of NetCDF-4, in which a dimension without one is an array too and takes its name from another."""
    return {
        name.removeprefix("_nc4_non_coord_"): array
        for name, array in file.items()
        if not is_dimension(array)
    }


def _attributes(of: h5py.HLObject) -> dict[str, Any]:
    """Return the attributes of a file or an array."""
    return {name: plain_attribute(value) for name, value in of.attrs.items()}


def _flow(content: _Content) -> FlowEstimate:
    """Return the flow of what a file has.

    Raises:
        KeyError: Something is missing in it.
        ValueError: Its parts do not fit together.
    """
    attrs, values = content.attrs, content.values
    wet = (
        values["wet"]
        if attrs["replay_kit_format_version"] == 1
        else np.moveaxis(values["wet"], -1, 0)
    )
    grid = Grid(
        projection=Projection(
            float(attrs["projection_longitude"]), float(attrs["projection_latitude"])
        ),
        longitude=values["longitude"],
        latitude=values["latitude"],
        east=values["east"],
        north=values["north"],
        levels=values["depth"],
        wet=np.ascontiguousarray(wet.astype(np.bool_)),
    )
    latent = values["latent"]
    kind = attrs["depth_function_kind"]
    functions = _horizontal(attrs, values, grid)
    if kind not in ("hat", "gaussian") or latent.shape[0] != functions.size:
        raise ValueError(
            f"depth functions {kind!r} and {latent.shape[0]} latent rows do not fit {functions.size} horizontal functions"
        )
    flow = FlowEstimate(
        grid=grid,
        horizontal=functions,
        depth_functions=DepthFunctions(kind, float(attrs["depth_function_length"])),
        latent=latent,
        modes=values.get("modes", np.empty((latent.shape[0], 0))),
        covariance=_covariance(values),
        time_ns=_time_ns(content),
        later=constant if attrs.get("evolution") == "constant" else None,
        local=_local(attrs, values),
        about=json.loads(str(attrs.get("replay_kit_about", "{}"))),
    )
    if attrs.get("evolution") != "process":
        return flow
    evolution = _evolution(content)
    # where nothing was observed the unknowns hold at any time, and the flow may have none
    at = int(evolution.process.times_ns[0]) if flow.time_ns is None else flow.time_ns
    return replace(evolution.flow(flow, at), time_ns=flow.time_ns, about=flow.about)


def _horizontal(
    attrs: Mapping[str, Any], values: Mapping[str, Array], grid: Grid
) -> HorizontalFunctions:
    """Return the horizontal functions; before version 4 they were the kernel of the grid's nodes."""
    kernel = HorizontalKernel(
        *(float(attrs[f"kernel_{name}"]) for name in ("length_east", "length_north", "speed"))
    )
    kind = attrs.get("horizontal_functions")
    if kind is None:
        return NodeKernel(kernel, grid.nodes)
    if kind == NODE_KERNEL:
        return NodeKernel(kernel, np.column_stack([values["node_east"], values["node_north"]]))
    if kind != LATTICE:
        raise ValueError(f"horizontal functions {kind!r}; expected {NODE_KERNEL!r} or {LATTICE!r}")
    origin, spacing, shape = (
        [float(attrs[f"lattice_{part}_{axis}"]) for axis in ("east", "north")]
        for part in ("origin", "spacing", "shape")
    )
    return StreamFunctionLattice(
        kernel, (origin[0], origin[1]), (spacing[0], spacing[1]), (int(shape[0]), int(shape[1]))
    )


def _covariance(values: Mapping[str, Array]) -> Array | CovarianceFactors:
    """Return the covariance of the weights; before version 5 it was the whole matrix."""
    if "weight_cov" in values or "modes" not in values:
        return _whole(values.get("weight_cov", np.empty((0, 0))))
    n_modes, n_levels = values["modes"].shape[1], values["depth"].size
    prior = HybridCovariance(
        values.get("covariance_factor", np.empty((0, n_levels, n_modes))),
        values.get("covariance_vertical", np.empty((0, n_levels))),
        whole_of(values.get("covariance_horizontal", np.empty((0, half_size(n_modes))))),
    )
    directions = values.get("covariance_directions", np.empty((0, n_modes)))
    return CovarianceFactors(
        prior, directions, _whole(values.get("covariance_matrix", np.empty((0, 0))))
    )


def _whole(matrix: Array) -> Array:
    """Return a matrix of which the file may have one half."""
    return whole_of(matrix) if matrix.ndim == 1 else matrix


def _evolution(content: _Content) -> Evolution:
    attrs, values = content.attrs, content.values
    mean, unknown_mean, cov = (
        values["process_mean"],
        values["unknown_mean"],
        _whole(values["unknown_cov"]),
    )
    times_ns = np.array(content.exact["forecast_time"].split(), dtype=np.int64)
    none = np.empty((0, *mean.shape[1:]))
    process = ProcessModel(
        times_ns=times_ns,
        mean=mean,
        trajectories=values.get("trajectories", np.empty((len(mean), *none.shape))),
        spread=values["spread"],
        local=values.get("local", none),
        trajectory_scale=float(attrs["trajectory_scale"]),
        local_scale=float(attrs["local_scale"]),
    )
    time_ns = int(attrs["evolution_time"]) if "evolution_time" in attrs else None
    return Evolution(
        process, values["offset"], unknown_mean, lambda: cov, time_ns, _oscillation(attrs, values)
    )


def _oscillation(attrs: Mapping[str, Any], values: Mapping[str, Array]) -> Oscillation | None:
    """Return what oscillates beside the slow current; None where nothing is known to, as before it was saved."""
    if "oscillation_omega" not in values:
        return None
    omega, cosine, sine = (values[f"oscillation_{name}"] for name in ("omega", "cosine", "sine"))
    return Oscillation(
        omega, cosine, sine, float(attrs["oscillation_scale"]), int(attrs["oscillation_time"])
    )


def _local(attrs: Mapping[str, Any], values: Mapping[str, Array]) -> LocalCurrent | None:
    """Return the current beside the flow; None where none is known, as before it was saved."""
    if "local_time" not in attrs:
        return None
    parts = {
        name: values[f"local_{name}"] for name in ("probability", "std", "scale", "mean", "cov")
    }
    return LocalCurrent(**parts, time_ns=int(attrs["local_time"]))


def _time_ns(content: _Content) -> int | None:
    """Return the exact time [ns, UTC] of either version; None for a flow that holds for no time."""
    if "time" not in content.values:
        return None
    first = content.attrs["replay_kit_format_version"] == 1
    return int(content.values["time"] if first else content.exact["time"])
