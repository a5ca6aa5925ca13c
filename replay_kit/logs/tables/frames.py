"""ADCP pings carried by MAVLink: ``DEBUG_FLOAT_ARRAY`` frames joined to ``replay_kit.AdcpPing`` payloads.

A ping is five frames of equal topic, ``array_id`` and ``time_usec``. The layout of ``ADCP_CFG`` is in ``ADCP_PING.md``. NaN means unknown.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import chain, repeat
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation.table import Raw
from replay_kit.logs.tables.columns import (
    Payload,
    Tables,
    number,
    unused,
    whole_number,
)
from replay_kit.logs.tables.instruments import WORDS, pings

SCHEMA = "DEBUG_FLOAT_ARRAY"
#: Names of a ping's frames.
PARTS = ["ADCP_CFG", "ADCP_E", "ADCP_N", "ADCP_U", "ADCP_STD"]
#: Names of the values of the first.
CONFIGURATION = [
    "n_cells",
    "cell_size",
    "bin0_distance",
    "coordinate_system",
    "reference",
    "orientation",
    "bin_mapped",
    "heading",
    "pitch",
    "roll",
    "pressure",
    "sound_speed",
    "temperature",
    "magnetic_declination",
    "declination_applied",
    "n_components",
    "transducer_depth",
]
# Frames of a ping follow one another at once; when this many pings stand open the oldest has lost a frame.
_OPEN_PINGS = 8
_INCOMPLETE = "part of an incomplete ping"
_NO_KEY = "frame of a ping: expected array_id and time_usec to be integers and data to be a list"

#: Numbers of the frames of pings that are not complete, by name of the frame, of each topic, ``array_id`` and ``time_usec``.
Open = Mapping[tuple[str, int, int], Mapping[str, Sequence[Any]]]


def joined(pending: Open, raws: Sequence[Raw], config: MeasurementConfig) -> tuple[Open, Tables]:
    """Return the frames of incomplete pings, and the tables of complete pings and unusable frames.

    Args:
        pending: Frames of earlier incomplete pings.
        raws: Frames with names of ``PARTS``.
        config: See ``pings``.
    """
    held, found = dict(pending), Tables()
    order = sorted((place, r, k) for r, raw in enumerate(raws) for k, place in enumerate(raw.order))
    taken = {(r, k): _add_frame(held, raws[r].topic, raws[r].payloads[k]) for _, r, k in order}
    for r, raw in enumerate(raws):
        payloads, counts = zip(*(taken[r, k] for k in range(len(raw.time))), strict=True)
        found += pings(raw, payloads, config, counts)
    return held, found


def _add_frame(held: dict[Any, Any], topic: str, payload: Payload) -> tuple[Payload | str, int]:
    """Add a frame; return the completed ping or the reason for exclusion, and the number of frames."""
    name, data = payload["name"], payload.get("data")
    key = topic, *(whole_number(payload.get(part)) for part in ("array_id", "time_usec"))
    if None in key or not isinstance(data, list | tuple):
        return _NO_KEY, 1
    frames = held.get(key, {})
    if name in frames:
        return "repeated frame of a ping", 1
    frames = held[key] = {**frames, name: data}
    two = _configuration(frames.get("ADCP_CFG", ()))["n_components"] == 2
    if {*PARTS} - {*frames} <= ({"ADCP_U"} if two else set()):
        return _assembled(held.pop(key)), len(frames)
    last = [] if len(held) <= _OPEN_PINGS else held.pop(next(iter(held)))
    return _INCOMPLETE, len(last)


def lost(pending: Open, order: int) -> Tables:
    """Return the tables of frames of incomplete pings at the end of the log, at a position in the stream."""
    found = Tables()
    for (topic, _, _), frames in pending.items():
        zero, at = np.zeros(len(frames), np.int64), np.full(len(frames), order, np.int64)
        found += unused(Raw(topic, SCHEMA, 0, zero, at, zero, ()), _INCOMPLETE)
    return found


def _assembled(frames: Mapping[str, Sequence[Any]]) -> dict[str, Any]:
    """Return the ping's payload in the form of JSON; short frames are left to the ping's own checks."""
    payload = _configuration(frames["ADCP_CFG"])
    n_cells = max(whole_number(payload["n_cells"]) or 0, 0)
    *components, std = [frames[part][:n_cells] for part in PARTS[1:] if part in frames]
    velocity = [list(cell) for cell in zip(*components, strict=False)]
    return {**payload, "n_cells": n_cells, "velocity": velocity, "velocity_std": [*std]}


def declination_in(payload: Payload) -> float:
    """Return the magnetic declination [degrees east] in a frame; NaN in others."""
    if payload.get("name") != "ADCP_CFG" or not isinstance(payload.get("data"), list | tuple):
        return math.nan
    return number(_configuration(payload["data"])["magnetic_declination"])


def _configuration(data: Sequence[Any]) -> dict[str, Any]:
    """Return the named values of ``ADCP_CFG``; None where missing or NaN."""
    values = zip(CONFIGURATION, chain(data, repeat(math.nan)), strict=False)
    # NaN is no number that two pings could have in common
    return {name: value if name in WORDS or value == value else None for name, value in values}
