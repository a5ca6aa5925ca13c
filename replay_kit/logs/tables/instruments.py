"""Payloads of ``replay_kit.AdcpPing`` as tables of pings; fields and units are in ``ADCP_PING.md``.

Columns of pings of m cells, with shapes after (n,):

* velocity (m, k), k >= 3 [m/s], along beams, or x, y, z, or east, north, up; a fourth is the error velocity or a fourth beam.
* error_std (m) [m/s]; distance (m) [m], vertical, from the transducer to the cells' centres.
* heading, pitch, roll, declination [degrees]; pressure [dbar]; transducer_depth [m], below that pressure or the vehicle's depth.
* bottom (b) [m/s], of the ground relative to the platform, along the ping's axes; bottom_std [m/s]; bottom_range [m], vertical, nearest.
* platform (2) [m/s], east and north, of the platform over the ground; platform_std [m/s].
* amplitude, correlation, percent_good, snr (m, b), error_velocity (m, 1 or more), where stated; no_amplitude and so on, why not.
* dive, -1 for none; messages, their number; place (3), longitude, latitude [degrees] and depth [m] of a mooring.

Of the instrument, in ``fixed``: frame (beam, instrument, ship or earth), reference (earth or platform), orientation (down or
up), cell_size [m], vectors ((b, 3), unit vectors of beams, or None), bin_mapped, noise_floor ((1 or b,) [dB]), needs_depth,
correlation_depth [m], derived, convention (teledyne or nortek), gimbal, tilt_applied, declination_applied (or None), and layout, equal
in tables to be joined.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, repeat
from reprlib import repr as shorten
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation.table import Raw, Table
from replay_kit.core.words.quantities import metres_per_second
from replay_kit.logs.tables.columns import (
    Payload,
    Tables,
    by_cell,
    dive_number,
    field,
    known_word,
    number,
    padded_rows,
    regular_array,
    stated_numbers,
    table_of,
    unused_table,
    velocity_cells,
    whole_number,
)

SYSTEMS = ("beam", "instrument", "ship", "earth")
#: Fields that are one of some words, or its number.
WORDS = {
    "coordinate_system": SYSTEMS,
    "reference": ("earth", "platform"),
    "orientation": ("down", "up"),
}
QUALITY = ("amplitude", "correlation", "percent_good", "snr", "error_velocity")
_NUMBERS = {
    **{name: name for name in ("heading", "pitch", "roll", "pressure", "transducer_depth")},
    "declination": "magnetic_declination",
    "bottom_std": "bottom_track.velocity_std",
    "platform_std": "platform_velocity.velocity_std",
}
_LISTS = ("velocity", "velocity_std", "cell_distances", *QUALITY)
# What is the instrument's, and mostly the same in all its pings; the rest each ping has of its own.
_INSTRUMENT = [
    "n_cells",
    "reference",
    "coordinate_system",
    "orientation",
    "cell_size",
    "bin0_distance",
    "beam_unit_vectors",
    "bin_mapped",
    "noise_floor",
    "vehicle_depth_needed",
    "correlation_depth",
    "derived",
    "attitude_convention",
    "gimbal_pitch",
    "tilt_applied",
    "declination_applied",
]
# m/s; an error outside is no statement of one, and its square would not survive the filter's arithmetic
STD_BELIEVED = (1e-6, 1e3)
_NO_REFERENCE = "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference"


def ping_tables(
    raw: Raw,
    payloads: Sequence[Any],
    config: MeasurementConfig,
    messages: Any = 1,
    places: Any = math.nan,
) -> list[Table]:
    """Return the tables of pings in messages, one per layout, and that of unusable ones.

    Args:
        raw: Messages.
        payloads: Fields of a ``replay_kit.AdcpPing`` for each, with nested (JSON) or flat (protobuf) lists; or the reason for exclusion.
        config: Reference and unit of velocities if payloads do not state them.
        messages: Number of messages of each ping or exclusion.
        places: shape (n, 3), longitude, latitude and depth of the instrument; NaN if on the vehicle.
    """
    n = len(payloads)
    reasons = [one if isinstance(one, str) else "" for one in payloads]
    counts, place = np.full(n, messages, np.int64), np.full((n, 3), places, np.float64)
    at = [k for k in range(n) if not reasons[k]]
    held, found = [payloads[k] for k in at], list[Table]()
    said = (field(held, name) for name in _LISTS)
    sizes = [[*map(len, _lists(one))] for one in said]
    left = _grouped(at, [*sizes, *(field(held, name) for name in _INSTRUMENT)]) if at else []
    while left:
        at = left.pop()
        held = [payloads[k] for k in at]
        try:
            columns, fixed = _columns(held, config)
        except (MeasurementError, ValueError, TypeError, OverflowError) as error:
            # one of them differs, perhaps each second one: the others must not suffer
            if len(at) == 1:
                reasons[at[0]] = str(error)
            else:
                left += at[::2], at[1::2]
        else:
            columns |= {"messages": counts[at], "place": place[at]}
            found.append(table_of(raw, "ping", np.array(at), columns, fixed))
    return found + unused_table(raw, reasons, counts)


def _grouped(at: list[int], columns: Iterable[Sequence[Any]]) -> list[list[int]]:
    """Return the indices of pings grouped by equal values in all columns."""
    unlike = [one for one in columns if one.count(one[0]) < len(one)]
    if not unlike:
        return [at]
    groups = defaultdict[str, list[int]](list)
    for k, *values in zip(at, *unlike, strict=True):
        groups[repr(values)].append(k)
    return [*groups.values()]


def _lists(values: Sequence[Any], least: int = 0) -> list[Any]:
    """Return values with empty lists for other types and lists that are too short."""
    kinds = (list, tuple)
    return [one if isinstance(one, kinds) and len(one) >= least else () for one in values]


def _columns(
    payloads: Sequence[Payload], config: MeasurementConfig
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the columns and fixed values of pings of one layout.

    Raises:
        MeasurementError: A ping is unusable.
        ValueError: The pings differ in layout.
    """
    fixed, velocity = _instrument(payloads[0], config), velocity_cells(payloads, SYSTEMS)
    n, m, _ = velocity.shape
    errors = padded_rows([value or None for value in field(payloads, "velocity_std")])
    if errors.shape[1] not in (1, m):
        raise MeasurementError(
            f"ping: expected velocity_std to be a number or {m} numbers, got {errors.shape[1]}"
        )
    found: dict[str, NDArray[Any]] = {
        **{name: stated_numbers(payloads, path)[0] for name, path in _NUMBERS.items()},
        "dive": np.array([*map(dive_number, field(payloads, "dive"))], np.int64),
        # an unknown unit is that of a config that says none
        "velocity": velocity * (metres_per_second(config.velocity_unit or "m/s") or 1.0),
        "distance": _distance(payloads, n, m),
        "error_std": np.broadcast_to(believed_errors(errors), (n, m)),
        "bottom": padded_rows(_lists(field(payloads, "bottom_track.velocity"), 3), 4),
        "bottom_range": np.fmin.reduce(
            padded_rows(_lists(field(payloads, "bottom_track.distance")), 1), axis=1
        ),
        "platform": np.column_stack(stated_numbers(payloads, "east north", "platform_velocity.")),
    }
    for name in QUALITY:
        values, found[f"no_{name}"] = _by_cell(field(payloads, name), name, n, m)
        if values is not None:
            found[name] = values
    shapes = {name: column.shape[1:] for name, column in found.items()}
    return found, fixed | {"layout": repr((fixed, shapes))}


def _instrument(payload: Payload, config: MeasurementConfig) -> dict[str, Any]:
    """Return the common properties of all pings of an instrument.

    Raises:
        MeasurementError: A word is unknown.
    """
    said = payload.get
    if said("reference") is None:
        if config.reference is None:
            raise MeasurementError(_NO_REFERENCE)
        said = {**payload, "reference": config.reference}.get
    words = {name: known_word(said(name), known) for name, known in WORDS.items()}
    for name, value in words.items():
        if value not in WORDS[name]:
            raise MeasurementError(
                f"ping: expected {name} to be one of {', '.join(WORDS[name])}, got {value}; state it in the message"
            )
    vectors = said("beam_unit_vectors")
    return {
        "frame": words.pop("coordinate_system"),
        **words,
        "cell_size": number(said("cell_size")),
        "vectors": _vectors(vectors) if vectors else None,
        # a number in MAVLink, as that of the declination
        "bin_mapped": number(said("bin_mapped")) == 1.0,
        "noise_floor": padded_rows([said("noise_floor")], 1)[0],
        "needs_depth": said("vehicle_depth_needed") is True,
        "correlation_depth": number(said("correlation_depth")),
        "derived": said("derived") is True,
        "convention": known_word(said("attitude_convention"), ("teledyne", "nortek")),
        "gimbal": said("gimbal_pitch") is True,
        "tilt_applied": said("tilt_applied") is not False,
        "declination_applied": {1.0: True, 0.0: False}.get(number(said("declination_applied"))),
    }


def _vectors(value: Any) -> Array:
    """Return vectors, nested or flat (protobuf), shape (b, 3); (0, 3) if invalid."""
    plain = regular_array([value])
    return plain.reshape(-1, 3) if plain.size % 3 == 0 else np.empty((0, 3))


def believed_errors(errors: Array) -> Array:
    """Return errors [m/s]; NaN where implausible."""
    least, most = STD_BELIEVED
    return np.where((errors >= least) & (errors <= most), errors, np.nan)


def _distance(payloads: Sequence[Payload], n: int, m: int) -> Array:
    """Return the distances of cell centres from the transducer, shape (n, m) [m], listed or evenly spaced.

    Raises:
        MeasurementError: The list has another length, or first distance or size are invalid.
    """
    listed = field(payloads, "cell_distances")
    if {*map(type, listed)} != {NoneType}:
        found = by_cell(padded_rows(_lists(listed)), m)
        if found is None or found.shape[2] > 1:
            raise MeasurementError(
                f"ping: expected cell_distances to be {m} numbers [m], got {shorten(listed[0])}"
            )
        return found[:, :, 0]
    said = [payloads[0].get(name) for name in ("cell_size", "bin0_distance")]
    size, first = map(number, said)
    if not (size > 0.0 and math.isfinite(first)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {' and '.join(map(shorten, said))}"
        )
    return np.broadcast_to(first + size * np.arange(m), (n, m))


def _by_cell(said: Sequence[Any], name: str, n: int, m: int) -> tuple[Array | None, NDArray[Any]]:
    """Return a field with numbers for each of m cells, shape (n, m, b), and why pings lack it, shape (n,)."""
    none = f"the ping has no {name}"
    if not any(said):
        return None, np.full(n, none, object)
    values = regular_array(said)
    if not values.ndim:
        # cells of different lengths, or something among them that is no number
        values = np.array([padded_rows(one) for one in said])
    cells = by_cell(values, m)
    if cells is None:
        return None, np.full(n, f"{name} is not as long as the velocity", object)
    return cells, np.where(np.isfinite(cells).any(axis=(1, 2)), "", none).astype(object)


# Pings carried by MAVLink are five frames of equal topic, ``array_id`` and ``time_usec``; NaN means unknown.
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


def joined_frames(
    pending: Open, raws: Sequence[Raw], config: MeasurementConfig
) -> tuple[Open, Tables]:
    """Return the frames of incomplete pings, and the tables of complete pings and unusable frames.

    Args:
        pending: Frames of earlier incomplete pings.
        raws: Frames with names of ``PARTS``.
        config: see ``ping_tables``.
    """
    held, found = dict(pending), Tables()
    order = sorted((place, r, k) for r, raw in enumerate(raws) for k, place in enumerate(raw.order))
    taken = {(r, k): _add_frame(held, raws[r].topic, raws[r].payloads[k]) for _, r, k in order}
    for r, raw in enumerate(raws):
        payloads, counts = zip(*(taken[r, k] for k in range(len(raw.time))), strict=True)
        found += ping_tables(raw, payloads, config, counts)
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


def lost_frames(pending: Open, order: int) -> Tables:
    """Return the tables of frames of incomplete pings at the end of the log, at a position in the stream."""
    found = Tables()
    for (topic, _, _), frames in pending.items():
        zero, at = np.zeros(len(frames), np.int64), np.full(len(frames), order, np.int64)
        found += unused_table(Raw(topic, SCHEMA, 0, zero, at, zero, ()), _INCOMPLETE)
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
