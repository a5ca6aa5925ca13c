"""Inputs given by a script: in-memory observations and forecasts as files; an estimator or planner that replaces those of the settings."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.message import Message
from replay_kit.core.observation import Fix, LinearMeasurement, Observation, PathMean
from replay_kit.estimator import Estimator
from replay_kit.estimator.interface import require_estimator
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.netcdf.surface import RADAR
from replay_kit.logs.netcdf.unknown import TOPIC, Asked, ping_of, profiles_in_memory
from replay_kit.logs.netcdf.variables import Stored, name_and_unit
from replay_kit.logs.payloads import DIVE_MEAN, PING, number, numbers, stamp
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.forecast import Forecasts, with_window
from replay_kit.workflows.replay.inputs.planner import Planner, PlannerFactory

if TYPE_CHECKING:
    import xarray as xr


def is_table(value: object) -> bool:
    """Return whether a value is a pandas table, an xarray ``Dataset``, or a mapping convertible to one."""
    # neither library is loaded for the question: whoever has a table has loaded it
    return (
        (hasattr(value, "columns") and hasattr(value, "groupby"))
        or hasattr(value, "data_vars")
        or (isinstance(value, Mapping) and any(map(_has_numbers, value.values())))
    )


def _has_numbers(value: object) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_has_numbers, value))
    return hasattr(value, "dtype") or isinstance(value, int | float)


def dataset_of(value: Any, name: str) -> "xr.Dataset":
    """Return a table as a dataset; pandas tables and arrays without dimensions have the dimension ``row``.

    Args:
        value: Value accepted by ``is_table``; times may be the index of a pandas table.
        name: Its name in errors.

    Raises:
        ConfigError: It cannot be converted.
    """
    # takes half a second to load
    import xarray as xr

    if hasattr(value, "columns"):
        held = {**value.index.to_frame(), **value}
        value = {
            "time"
            if isinstance(key, int) and column.dtype.kind == "M"
            else str(key): column.to_numpy()
            for key, column in held.items()
        }
    if not any(hasattr(each, "dims") or isinstance(each, tuple) for each in value.values()):
        value = {key: (("row",) * np.ndim(each), np.asarray(each)) for key, each in value.items()}
        n = max(each.size for _, each in value.values())
        for key, (dims, each) in value.items():
            if dims and each.shape != (n,):
                raise ConfigError(
                    f"{name}['{key}']: expected {n} values, as others have, got {each.shape}"
                )
    try:
        return xr.Dataset(value) if not hasattr(value, "data_vars") else value
    except (ValueError, TypeError) as error:
        raise ConfigError(
            f"{name}: expected what xarray.Dataset can be made of: {error}; give each as (dimensions, values)"
        ) from error


def is_forecast(value: object) -> bool:
    """Return whether a value is an ``Ensemble``, an xarray ``Dataset``, or a mapping convertible to one."""
    return isinstance(value, Ensemble) or is_table(value)


def write_forecast(path: Path, value: Any, name: str) -> None:
    """Write a forecast as NetCDF.

    Args:
        path: The file.
        value: Value accepted by ``is_forecast``.
        name: Its name in errors.

    Raises:
        ForecastError: Its values cannot be read or written.
    """
    dataset = _dataset_of(value) if isinstance(value, Ensemble) else dataset_of(value, name)
    halves = [name for name, held in dataset.variables.items() if held.dtype == np.float16]
    if halves:
        named = ", ".join(map(str, halves))
        warnings.warn(f"{named}: 16-bit numbers have three digits; read as they are", stacklevel=4)
        dataset = dataset.assign({name: dataset[name].astype(np.float32) for name in halves})
    try:
        dataset.to_netcdf(path, engine="h5netcdf")
    # a lazy dataset reads its file here, with whatever library it was opened with
    except Exception as error:
        said = " ".join(str(error).split())[:200]
        raise ForecastError(
            f"{name}: expected a Dataset whose values can be read and written as NetCDF, got {type(error).__name__}: {said}; "
            "is the file that it was opened from still there?"
        ) from error


def _dataset_of(ensemble: Ensemble) -> "xr.Dataset":
    """Return an ensemble as a dataset along true east and north."""
    # takes half a second to load
    import xarray as xr

    grid = ensemble.grid
    east, north = rotate_to_geographic(
        grid.projection, grid.longitude, grid.latitude, *np.moveaxis(ensemble.velocity, 1, 0)
    )
    dims = ("realization", "depth", "y", "x")
    names = ("eastward_sea_water_velocity", "northward_sea_water_velocity")
    dataset = xr.Dataset(
        {
            short: (dims, values, {"standard_name": name, "units": "m s-1"})
            for short, name, values in zip(("u", "v"), names, (east, north), strict=True)
        },
        {
            "realization": ("realization", np.arange(len(east)), {"standard_name": "realization"}),
            "depth": (
                "depth",
                grid.levels,
                {"standard_name": "depth", "units": "m", "positive": "down"},
            ),
            "longitude": (
                ("y", "x"),
                grid.longitude,
                {"standard_name": "longitude", "units": "degrees_east"},
            ),
            "latitude": (
                ("y", "x"),
                grid.latitude,
                {"standard_name": "latitude", "units": "degrees_north"},
            ),
        },
    )
    if ensemble.time_ns is None:
        return dataset
    return dataset.assign_coords(time=((), np.datetime64(ensemble.time_ns, "ns")))


#: Makes the estimator of an ensemble.
EstimatorBuilder = Callable[[Ensemble, EstimatorConfig], Estimator[Any]]


def given_estimator(
    estimator: EstimatorBuilder | Estimator[Any],
) -> Callable[[Forecasts, RunConfig], Estimator[Any]]:
    """Return the factory of a run's estimator, given one or its factory."""

    def make(forecasts: Forecasts, config: RunConfig) -> Estimator[Any]:
        # an estimator is not callable
        value = (
            estimator(forecasts.ensemble, config.estimator) if callable(estimator) else estimator
        )
        return with_window(require_estimator(value, "estimator"), config.time.window)

    return make


def planner_factory(planner: PlannerFactory | Planner | None) -> PlannerFactory:
    """Return the factory of a run's planner.

    Raises:
        ConfigError: The value is not a planner.
    """
    if planner is None:
        return planner_of
    if callable(planner):
        return planner
    lacking = [
        name for name in ("plan", "check", "with_odds", "seabed") if not hasattr(planner, name)
    ]
    if lacking:
        raise ConfigError(
            f"planner: expected a Planner, got {type(planner).__name__} without {', '.join(lacking)}"
        )
    return lambda config, grid: planner


#: What a person states: a profile, a mean current, a single component.
Stated = Observation | PathMean | LinearMeasurement
# s; as long as tides keep their direction, so that their error is counted once
_AVERAGED = 11_178.0


def is_observed(value: object) -> bool:
    """Return whether a value is an observation, a table, or a sequence of observations."""
    first = value[0] if isinstance(value, list | tuple) and value else value
    return isinstance(first, Stated) or is_table(first)


def write_observed(path: Path, value: Any, name: str, columns: Asked) -> None:
    """Write observations as an MCAP log, in order of time.

    Args:
        path: The log.
        value: Value accepted by ``is_observed``; a table has one row per depth, and rows of one time and place form a profile.
        name: Name of the value in errors.
        columns: Column names as in ``logs.columns``.

    Raises:
        ConfigError: An observation is relative to its platform, or a table lacks a column.
    """
    held: list[Stated] = []
    for each in value if isinstance(value, list | tuple) else [value]:
        held += _table_profiles(each, name, columns) if is_table(each) else [each]
    for each in held:
        if not isinstance(each, Stated):
            raise ConfigError(
                f"{name}: expected Observation values or tables, got {type(each).__name__} among them"
            )
        if isinstance(each, Observation) and each.reference != "earth":
            raise ConfigError(
                f"{name}: expected profiles relative to the earth, got one relative to its platform; give its log"
            )
    held.sort(key=lambda each: each.time_ns)
    write_mcap_log(path, (_message(each, k) for k, each in enumerate(held)))


def _table_profiles(value: Any, name: str, columns: Asked) -> list[Observation]:
    """Return the profiles of a table; assumptions about it are warnings. Units may be in brackets, as in a file."""
    stored, names = {}, {}
    for key, v in (held := dataset_of(value, name).variables).items():
        short, unit = name_and_unit(str(key))
        names[key] = short = str(key) if short in held else short
        stored[short] = Stored(v.values, {"units": unit, **v.attrs}, tuple(map(str, v.dims)))
    asked = {key: names.get(column_name, column_name) for key, column_name in columns.items()}
    found, left_out, notes = profiles_in_memory(name, stored, asked)
    if not found:
        raise ConfigError(f"{name}: expected rows with a time and a place (longitude -180 to 360)")
    if left_out:
        notes.append(f"{left_out} rows without a time or a place excluded")
    for note in notes:
        # a unit that is stated is no assumption
        if ": converted from " not in note and not note.startswith("read as "):
            warnings.warn(f"{name}: {note}", stacklevel=5)
    return found


def _message(each: Stated, position: int) -> Message:
    if isinstance(each, PathMean):
        topic, schema, payload = "/dac", DIVE_MEAN, _mean(each)
    elif isinstance(each, LinearMeasurement):
        topic, schema, payload = "/components", RADAR, _component(each)
    else:
        topic, schema, payload = TOPIC, PING, ping_of(each, position)
    return Message(each.time_ns, topic, schema, payload, 0, position)


def _component(single: LinearMeasurement) -> dict[str, Any]:
    if single.components.shape != (1, 2) or single.value.shape != (1, 1):
        raise ConfigError(
            f"observations: expected one component at one place, got {single.value.size} values; make each with Observation.component"
        )
    columns = {
        "longitude": single.longitude,
        "latitude": single.latitude,
        "direction": np.degrees(np.arctan2(*single.components.T)),
        "speed": single.value[0],
        "error": single.error_std,
    }
    return {
        "stamp": stamp(single.time_ns),
        "depth": float(single.depth[0]),
        "averaged": _AVERAGED,
        "error_length": 0.0,
        "kind": single.label.kind,
        **{name: numbers(values) for name, values in columns.items()},
    }


def _mean(mean: PathMean) -> dict[str, Any]:
    if mean.fixes is None:
        raise ConfigError(
            f"observations: expected fixes around each mean current, that at {mean.time_ns} ns has none"
        )
    start, end = mean.fixes
    deepest = mean.deepest if np.isfinite(mean.deepest) else mean.depth.max()
    return {
        "stamp": stamp(mean.time_ns),
        **({"dive": mean.dive} if mean.dive else {}),
        "dac_eastward": mean.velocity[0],
        "dac_northward": mean.velocity[1],
        "error": mean.error_std,
        "start_fix": _fix(start),
        "end_fix": _fix(end),
        "max_depth": number(deepest),
        "radius": number(mean.radius),
        "declination": number(mean.declination),
        "dac_kind": "stated",
    }


def _fix(fix: Fix) -> dict[str, Any]:
    return {"time": stamp(fix.time_ns), "lon": fix.longitude, "lat": fix.latitude}
