"""Observations and tables of observations as a log: one message type for profiles, others for DACs and single components."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.core.errors import ConfigError
from replay_kit.core.message import Message
from replay_kit.core.observation import Fix, LinearMeasurement, Observation, PathMean
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.logs.netcdf.surface import RADAR
from replay_kit.logs.netcdf.text import name_and_unit
from replay_kit.logs.netcdf.unknown import TOPIC, Asked, ping_of, profiles_in_memory
from replay_kit.logs.netcdf.variables import Stored
from replay_kit.logs.payloads import DIVE_MEAN, PING, number, numbers, stamp
from replay_kit.workflows.library.parts import dataset_of, is_table

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
        held += _of_table(each, name, columns) if is_table(each) else [each]
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


def _of_table(value: Any, name: str, columns: Asked) -> list[Observation]:
    """Return the profiles of a table; assumptions about it are warnings. Units may be in brackets, as in a file."""
    notes: list[str] = []
    stored, names = {}, {}
    for key, v in (held := dataset_of(value, name).variables).items():
        short, unit = name_and_unit(str(key))
        names[key] = short = str(key) if short in held else short
        stored[short] = Stored(v.values, {"units": unit, **v.attrs}, tuple(map(str, v.dims)))
    asked = {key: names.get(own, own) for key, own in columns.items()}
    found, left_out = profiles_in_memory(name, stored, asked, notes)
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
            f"observations: expected the fixes before and after each mean current, that at {mean.time_ns} ns has none"
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
