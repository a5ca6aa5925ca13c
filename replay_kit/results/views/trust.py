"""Whether the stated uncertainty of an estimate holds: coverage of the innovations, and what the measurements took from the error."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.results.views.slices import CurrentSlices

#: Standard deviations, and the share of a Gaussian within them.
EXPECTED = {1.0: 0.6827, 2.0: 0.9545, 3.0: 0.9973}


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Innovations over their predicted standard deviations.

    Attributes:
        standardized: shape (n,), of each component of each bin used.
        coverage: Share of them within a number of standard deviations; empty without values.
        mean: Of them; 0 without bias.
        std: Of them; 1 when the stated errors hold.
    """

    standardized: Array
    coverage: Mapping[float, float]
    mean: float
    std: float


def calibration(bins: pd.DataFrame) -> Calibration:
    """Return how the innovations compare with their predicted standard deviations.

    Args:
        bins: ``Result.innovations``.
    """
    parts = [
        (bins[f"innovation_{axis}"] / bins[f"innovation_std_{axis}"]).to_numpy(np.float64)
        for axis in ("east", "north")
    ]
    values = np.concatenate(parts)
    known = np.isfinite(values)
    values = values if known.all() else values[known]
    if values.size == 0:
        return Calibration(values, {}, np.nan, np.nan)
    sizes = np.abs(values)
    coverage = {limit: float(np.mean(sizes <= limit)) for limit in EXPECTED}
    return Calibration(values, coverage, float(values.mean()), float(values.std()))


def error_through_time(slices: CurrentSlices) -> Array:
    """Return the RMS standard error of a component over each published slice [m/s], shape (D, T); NaN where it is unknown."""
    squares = slices.fields[:, :, 2:] ** 2
    known = np.isfinite(squares)
    count = known.sum(axis=(2, 3, 4))
    total = np.where(known, squares, 0.0).sum(axis=(2, 3, 4))
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean))


def information_by_dive(observations: pd.DataFrame) -> pd.Series:
    """Return the degrees of freedom for signal that the measurements of each dive determined.

    Args:
        observations: ``Result.observations``.
    """
    used = observations[observations["accepted"].astype(bool) & (observations["dive"] > 0)]
    return used.groupby("dive")["signal_dof"].sum()
