"""Forecasts in NetCDF and Zarr files, read with xarray as ``Ensemble`` values."""

from replay_kit.forecast.describe import describe_ensemble
from replay_kit.forecast.files import ensemble_files, find_sources
from replay_kit.forecast.reader import read_ensemble, read_truth
from replay_kit.forecast.series import read_series

__all__ = [
    "describe_ensemble",
    "ensemble_files",
    "find_sources",
    "read_ensemble",
    "read_series",
    "read_truth",
]
