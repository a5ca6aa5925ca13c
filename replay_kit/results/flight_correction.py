"""Mean currents, measured and corrected for the flight model's error: in messages of every version, as JSON and as a sentence."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.core.observation import Innovation
from replay_kit.results.schemas import CONTRACT_VERSION

#: Records of a result by name.
Metadata = Mapping[str, Mapping[str, str]]
#: A current to the east and north and the error of each component [m/s], NaN where the result does not hold it.
Part = tuple[float, float, float]
# The first contract version whose measured mean currents are the log's, and what messages hold since then.
_MEASURED_SINCE = 5
_ENDS = ("east", "north", "standard_error")
_SINCE = (
    "measured_standard_error",
    *(f"{name}_{end}" for name in ("corrected", "estimated") for end in _ENDS),
)


def mean_current_values(value: Innovation) -> dict[str, Any]:
    """Return the values of ``replay_kit.MeanCurrent``: measured, corrected for the flight model's error, predicted and estimated.

    Args:
        value: The innovation of a mean current, or of another source, of which the kind alone is known.
    """
    measured, corrected, used = (
        np.full(2, np.nan) if each is None else each
        for each in (value.mean_current, value.corrected_current, value.used_current)
    )
    parts: dict[str, Any] = {
        "measured": measured,
        "predicted": used - value.innovation[0],
        "corrected": corrected,
        "estimated": used - value.residual[0],
    }
    numbers = {
        f"{name}_{axis}": part[k]
        for name, part in parts.items()
        for k, axis in enumerate(("east", "north"))
    }
    errors = {
        "measured": value.mean_std,
        "corrected": value.corrected_std,
        "estimated": value.estimated_std,
    }
    return {
        "kind": value.mean_kind,
        **numbers,
        **{f"{name}_standard_error": error for name, error in errors.items()},
    }


def mean_current_parts(
    mean: Any, metadata: Metadata, settings: Mapping[str, Any]
) -> tuple[Part | None, Part | None]:
    """Return what ``replay_kit.MeanCurrent`` holds as measured and as corrected; None for what it does not hold.

    Args:
        mean: The message, of any version of the contract.
        metadata: Of the result, records by name.
        settings: Of the result, its configuration.
    """
    measured: Part = (
        mean.measured_east,
        mean.measured_north,
        mean.measured_standard_error or math.nan,
    )
    if mean.kind == "dac" and measured_is_corrected(metadata, settings):
        return None, measured
    corrected: Part = (mean.corrected_east, mean.corrected_north, mean.corrected_standard_error)
    return measured, corrected if corrected[2] > 0.0 else None


def named_by_contract(
    columns: dict[str, Any], metadata: Metadata, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return columns of ``replay_kit.Innovation`` with the mean currents of an earlier contract under their names of today.

    Args:
        columns: Lists of numbers by name.
        metadata: Of the result, records by name.
        settings: Of the result, its configuration.
    """
    if _version(metadata) >= _MEASURED_SINCE:
        return columns
    kinds = columns["mean_current_kind"]
    unknown = [math.nan] * len(kinds)
    columns = columns | {f"mean_current_{name}": unknown for name in _SINCE}
    if measured_is_corrected(metadata, settings):
        for axis in ("east", "north"):
            both = list(zip(kinds, columns[f"mean_current_measured_{axis}"], strict=True))
            columns[f"mean_current_corrected_{axis}"] = [
                value if kind == "dac" else math.nan for kind, value in both
            ]
            columns[f"mean_current_measured_{axis}"] = [
                math.nan if kind == "dac" else value for kind, value in both
            ]
    return columns


def measured_is_corrected(metadata: Metadata, settings: Mapping[str, Any]) -> bool:
    """Return whether a result holds, as measured mean currents of dives, corrected ones, as those before contract version 5 do.

    Args:
        metadata: Its records by name.
        settings: Its configuration.
    """
    return _version(metadata) < _MEASURED_SINCE and bool(
        settings.get("measurements", {}).get("flight_bias", False)
    )


def _version(metadata: Metadata) -> int:
    return int(metadata.get("contract", {}).get("version", CONTRACT_VERSION))
