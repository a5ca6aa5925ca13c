"""What CF-1.8 asks of every dataset: what it is and what made it, times without 64-bit integers, fill values where something is missing."""

import numpy as np
import xarray as xr

from replay_kit.core.version import __version__

#: Of each variable of a file, as xarray takes it.
Encoding = dict[str, dict[str, object]]

CONVENTIONS = "CF-1.8"
CF_TIME = {"units": "seconds since 1970-01-01", "calendar": "standard"}


def attributes(title: str, history: str) -> dict[str, str]:
    """Return the global attributes of a dataset.

    Args:
        title: What it holds.
        history: What made it; without a time of writing, so that the same values give the same bytes.
    """
    return {
        "Conventions": CONVENTIONS,
        "title": title,
        "source": f"replay-kit {__version__}",
        "history": history,
    }


def encoding_of(dataset: xr.Dataset) -> Encoding:
    """Return how variables are written: times as float64 seconds, and with a fill value those alone that miss something.

    CF-1.8 has no 64-bit integers, which nanoseconds need; a coordinate has a value everywhere.
    """
    encoding: Encoding = {}
    for name, variable in dataset.variables.items():
        missing = variable.isnull().values if variable.dtype.kind in "Mf" else np.array(False)
        each: dict[str, object] = {
            "_FillValue": np.nan if missing.any() and name not in dataset.dims else None
        }
        if variable.dtype.kind == "M":
            # of no date at all xarray cannot tell whether it is one of the calendar, and warns
            each |= (
                {"units": CF_TIME["units"], "dtype": "float64"}
                if missing.all()
                else {**CF_TIME, "dtype": "float64"}
            )
        encoding[str(name)] = each
    return encoding


def encoded(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset that ``to_netcdf`` writes as ``encoding_of`` says."""
    for name, encoding in encoding_of(dataset).items():
        dataset.variables[name].encoding.update(encoding)
    return dataset
