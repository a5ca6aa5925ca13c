"""Files of forecasts to ``Ensemble`` values: NetCDF and Zarr through xarray."""

from replay_kit.forecast.changing import read_changing_truth
from replay_kit.forecast.describe import describe_ensemble
from replay_kit.forecast.reader import read_ensemble, read_truth
from replay_kit.forecast.series import read_series
from replay_kit.forecast.sources import ensemble_files, find_sources

__all__ = [
    "describe_ensemble",
    "ensemble_files",
    "find_sources",
    "read_changing_truth",
    "read_ensemble",
    "read_series",
    "read_truth",
]
