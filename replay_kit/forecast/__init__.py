"""Ensemble files to ``Ensemble`` values: NetCDF and Zarr through xarray."""

from replay_kit.forecast.changing import read_changing_truth
from replay_kit.forecast.reader import read_ensemble, read_truth

__all__ = ["read_changing_truth", "read_ensemble", "read_truth"]
