"""Inputs given by a script: an in-memory forecast as a file; an estimator or planner that replaces those of the settings."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.estimator import Estimator
from replay_kit.estimator.interface import require_estimator
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.forecast import Forecasts, with_window
from replay_kit.workflows.replay.plans import Planner, PlannerFactory

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


def given(
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
