"""Observations and tables of them as a log: messages of one kind for profiles, of others for mean currents and single components."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core.errors import ConfigError
from replay_kit.core.message import Message
from replay_kit.core.observation import Fix, LinearMeasurement, Observation, PathMean, usable
from replay_kit.core.quantities import to_time_ns
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.shared.payloads import PING, number, numbers, stamp
from replay_kit.logs.surface.totals import SCHEMA as RADAR

if TYPE_CHECKING:
    import pandas as pd

#: What a person states: a profile, a mean current, a single component.
Stated = Observation | PathMean | LinearMeasurement
_MEAN = "replay_kit.DepthAveragedCurrent"
# s; as long as tides keep their direction, so that their error is counted once
_AVERAGED = 11_178.0
# columns of a table, with other names that they may have
_PROFILE: Mapping[str, tuple[str, ...]] = {
    "time": ("date", "datetime"),
    "lon": ("longitude",),
    "lat": ("latitude",),
    "depth": (),
    "u": ("east", "eastward"),
    "v": ("north", "northward"),
    "error": ("error_std", "standard_error"),
}
_TABLE = "expected a table with the columns time, lon, lat, depth [m], u, v and error [m/s], a row a depth"


def is_observed(value: object) -> bool:
    """Return whether a value is a measurement, a table, or a sequence of measurements."""
    first = value[0] if isinstance(value, list | tuple) and value else value
    return isinstance(first, Stated) or _is_table(first)


def write_observed(path: Path, value: Any) -> None:
    """Write measurements as an MCAP log, in order of time.

    Args:
        path: The log.
        value: As of ``is_observed``; a table has a row for each depth, and rows of one time and place are a profile.

    Raises:
        ConfigError: A measurement is relative to its platform, or a table lacks a column.
    """
    held: list[Stated] = []
    for each in value if isinstance(value, list | tuple) else [value]:
        held += _of_table(each) if _is_table(each) else [each]
    for each in held:
        if not isinstance(each, Stated):
            raise ConfigError(
                f"observations: expected Observation values or tables, got {type(each).__name__} among them"
            )
        if isinstance(each, Observation) and each.reference != "earth":
            raise ConfigError(
                "observations: expected profiles relative to the earth, got one relative to its platform; give its log"
            )
    held.sort(key=lambda each: each.time_ns)
    write_mcap_log(path, (_message(each, k) for k, each in enumerate(held)))


def _is_table(value: object) -> bool:
    # pandas is not loaded for the question: whoever has a table has loaded it
    return hasattr(value, "columns") and hasattr(value, "groupby")


def _of_table(table: "pd.DataFrame") -> Iterator[Observation]:
    """Yield the profiles of a table."""
    own = {str(name).lower(): name for name in table.columns}
    found = {
        key: next((own[name] for name in (key, *others) if name in own), None)
        for key, others in _PROFILE.items()
    }
    lacking = [key for key, name in found.items() if name is None]
    if lacking:
        raise ConfigError(
            f"table: {_TABLE}; it lacks {', '.join(lacking)}"
            + (
                "; state the standard error of each component, it is not guessed"
                if "error" in lacking
                else ""
            )
        )
    columns = {
        key: table[name].to_numpy(np.float64) for key, name in found.items() if key != "time"
    }
    time = to_time_ns(table[found["time"]].to_numpy())
    key = np.column_stack([time.astype(np.float64), columns["lon"], columns["lat"]])
    # profiles in the order of their first rows
    _, first, of_profile = np.unique(key, axis=0, return_index=True, return_inverse=True)
    for profile in np.argsort(first).tolist():
        rows = np.flatnonzero(of_profile.ravel() == profile)
        rows = rows[np.argsort(columns["depth"][rows], kind="stable")]
        k = rows[0]
        yield Observation.profile(
            *(int(time[k]), float(columns["lon"][k]), float(columns["lat"][k])),
            *(columns[name][rows] for name in ("depth", "u", "v", "error")),
        )


def _message(each: Stated, position: int) -> Message:
    if isinstance(each, PathMean):
        topic, schema, payload = "/dac", _MEAN, _mean(each)
    elif isinstance(each, LinearMeasurement):
        topic, schema, payload = "/components", RADAR, _component(each)
    else:
        topic, schema, payload = "/observations", PING, _ping(each, position)
    return Message(each.time_ns, topic, schema, payload, 0, position)


def _ping(profile: Observation, ordinal: int) -> dict[str, Any]:
    good = usable(profile.flags)[:, None]
    velocity = np.where(good, profile.velocity, np.nan)
    std = np.hypot(profile.error_std, profile.common_std)
    return {
        "stamp": stamp(profile.time_ns),
        "ping": ordinal,
        **({"dive": profile.dive} if profile.dive else {}),
        "place": {"lon": profile.longitude, "lat": profile.latitude},
        "coordinate_system": "earth",
        "reference": "earth",
        "orientation": "down",
        "bin_mapped": True,
        "n_cells": profile.depth.size,
        "cell_distances": numbers(profile.depth),
        "transducer_depth": 0.0,
        "pressure": 0.0,
        "velocity": numbers(velocity),
        "velocity_std": numbers(std),
        "correlation_depth": profile.correlation_depth,
    }


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
            f"observations: expected the fixes before and after each mean current, that at {mean.time_ns} ns has none"
        )
    deepest = mean.deepest if math.isfinite(mean.deepest) else float(mean.depth.max())
    return {
        "stamp": stamp(mean.time_ns),
        **({"dive": mean.dive} if mean.dive else {}),
        "dac_eastward": mean.velocity[0],
        "dac_northward": mean.velocity[1],
        "error": mean.error_std,
        "start_fix": _fix(mean.fixes[0]),
        "end_fix": _fix(mean.fixes[1]),
        "max_depth": number(deepest),
        "dac_kind": "stated",
    }


def _fix(fix: Fix) -> dict[str, Any]:
    return {"time": stamp(fix.time_ns), "lon": fix.longitude, "lat": fix.latitude}
