"""Payloads of a ``replay_kit.AdcpPing`` as tables of pings; names and units of the fields are in ``ADCP_PING.md``.

Columns of a table of pings of m cells, with shapes after (n,):

* velocity (m, k), k >= 3 [m/s], along beams, or x, y, z, or east, north, up; a fourth is the error velocity or a fourth beam.
* error_std (m) [m/s]; distance (m) [m], vertical, from the transducer to the cells' centres.
* heading, pitch, roll, declination [degrees]; pressure [dbar]; transducer_depth [m], below that pressure or the vehicle's depth.
* bottom (b) [m/s], of the ground relative to the platform, along the ping's axes; bottom_std [m/s]; bottom_range [m], vertical, nearest.
* platform (2) [m/s], east and north, of the platform over the ground; platform_std [m/s].
* amplitude, correlation, percent_good, snr (m, b), error_velocity (m, 1 or more), of pings that have them; no_amplitude and so on, in words
  why a ping has none, else empty.
* dive, -1 for none; messages, of how many a ping was made; place (3), longitude, latitude [degrees] and depth [m] of a mooring.

What is an instrument's is in ``fixed``: frame (beam, instrument, ship or earth), reference (earth or platform), orientation (down or up),
cell_size [m], vectors ((b, 3), unit vectors of beams, or None), bin_mapped, noise_floor ((1 or b,) [dB]), needs_depth, correlation_depth
[m], derived, convention (teledyne or nortek), gimbal, tilt_applied, declination_applied (or None), and layout, equal for tables that can
be joined.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.quantities import metres_per_second
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables import columns
from replay_kit.logs.tables.cells import believed_std, by_cell, cell_distances, velocity_cells
from replay_kit.logs.tables.columns import Payload, field, known_word, listed, number, numbers

SYSTEMS = ("beam", "instrument", "ship", "earth")
_REFERENCES, _ORIENTATIONS, _CONVENTIONS = (
    ("earth", "platform"),
    ("down", "up"),
    ("teledyne", "nortek"),
)
QUALITY = ("amplitude", "correlation", "percent_good", "snr", "error_velocity")
_NUMBERS = ("heading", "pitch", "roll", "pressure", "transducer_depth")
# What is the instrument's, and mostly the same in all its pings; the rest each ping has of its own.
_INSTRUMENT = (
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
)
_NO_REFERENCE = (
    "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference "
    "when the message has no place for it"
)


def pings(
    raw: Raw,
    payloads: Sequence[Payload | str],
    config: MeasurementConfig,
    messages: Sequence[int] | None = None,
    places: Sequence[tuple[float, float, float] | None] | None = None,
) -> list[Table]:
    """Return the tables of pings that messages hold, one for each layout, and that of those that cannot be used.

    Args:
        raw: The messages.
        payloads: Fields of a ``replay_kit.AdcpPing`` for each of them, with JSON's lists of lists or protobuf's flat ones; or in words why
            there are none.
        config: What the velocities are relative to, and their unit, where payloads do not say.
        messages: Number of messages that make each ping; None for one.
        places: Longitude, latitude and depth of the instrument; None for one on the vehicle.
    """
    reasons = [""] * len(payloads)
    if str in {*map(type, payloads)}:
        reasons = [payload if isinstance(payload, str) else "" for payload in payloads]
    good = [k for k, reason in enumerate(reasons) if not reason]
    held = cast(Sequence[Payload], [payloads[k] for k in good])
    times = np.ones(len(payloads), np.int64) if messages is None else np.array(messages)
    where = np.array([place or (math.nan,) * 3 for place in places or []]).reshape(-1, 3)
    where = where if places else np.full((len(payloads), 3), np.nan)
    found: list[Table] = []
    for at, alike in _groups(held, velocity_cells(held, SYSTEMS)):
        rows = np.array([good[k] for k in at])
        for part, made in (
            [(slice(None), alike)] if isinstance(alike, str) else alike.tables(config)
        ):
            own = rows[part]
            if isinstance(made, str):
                for k in own:
                    reasons[k] = made
                continue
            own_columns = {**made[0], "messages": times[own], "place": where[own]}
            found.append(columns.table(raw, "ping", own, own_columns, made[1]))
    bad = np.array([k for k in np.repeat(np.arange(len(reasons)), times) if reasons[k]], np.intp)
    if bad.size:
        words = np.array([reasons[k] for k in bad], object)
        found.append(columns.table(raw, "unused", bad, {"reason": words}))
    return found


def _groups(
    payloads: Sequence[Payload], velocities: Sequence[Array | MeasurementError]
) -> Iterator[tuple[list[int], "_Alike | str"]]:
    """Yield the numbers of pings of one instrument with as many cells, and these pings; or in words why they are none."""
    groups: list[tuple[Any, list[int]]] = []
    at: list[int] = []
    known: Any = None
    stated = zip(*(field(payloads, name) for name in _INSTRUMENT), strict=True)
    for k, (own, velocity) in enumerate(zip(stated, velocities, strict=True)):
        if isinstance(velocity, MeasurementError):
            yield [k], str(velocity)
            continue
        own = (*own, velocity.shape)
        if own != known:
            known, at = next((group for group in groups if group[0] == own), (own, []))
            if not at:
                groups.append((own, at))
        at.append(k)
    for _, at in groups:
        yield at, _Alike([payloads[k] for k in at], np.array([velocities[k] for k in at]))


class _Alike:
    """Pings of one instrument with as many cells and components."""

    def __init__(self, payloads: Sequence[Payload], velocity: Array) -> None:
        self.payloads, self.velocity = payloads, velocity

    def tables(
        self, config: MeasurementConfig
    ) -> list[tuple[NDArray[np.intp], tuple[dict[str, NDArray[Any]], dict[str, Any]] | str]]:
        """Return columns and what is fixed of some pings each, or in words why they cannot be used, with the numbers of these pings."""
        everyone = np.arange(len(self.payloads))
        try:
            fixed = _instrument(self.payloads[0], config)
        except MeasurementError as error:
            return [(everyone, str(error))]
        try:
            return [(everyone, self._columns(fixed, config))]
        except (MeasurementError, ValueError, TypeError, OverflowError) as error:
            if everyone.size == 1:
                return [(everyone, str(error))]
        # one of them differs: the others must not suffer
        found = []
        for part in self._by_shape():
            rest = _Alike([self.payloads[k] for k in part], self.velocity[part])
            found += [(part[at], one) for at, one in rest.tables(config)]
        return found

    def _by_shape(self) -> list[NDArray[np.intp]]:
        """Return the pings by what fields they hold and how long these are; where all are alike in that, one by one."""

        def shape(value: Any) -> Any:
            if isinstance(value, list | tuple) and value:
                return len(value), shape(value[0])
            return type(value) if isinstance(value, Mapping | str) else value is None

        groups: dict[Any, list[int]] = {}
        names = (*QUALITY, "velocity_std", "cell_distances", "bottom_track")
        for k, payload in enumerate(self.payloads):
            groups.setdefault(tuple(shape(payload.get(name)) for name in names), []).append(k)
        if len(groups) == 1:
            return [np.array([k]) for k in range(len(self.payloads))]
        return [np.array(at) for at in groups.values()]

    def _columns(
        self, fixed: dict[str, Any], config: MeasurementConfig
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        payloads, (n, m, _) = self.payloads, self.velocity.shape
        found: dict[str, NDArray[Any]] = {name: numbers(field(payloads, name)) for name in _NUMBERS}
        found["declination"] = numbers(field(payloads, "magnetic_declination"))
        found["dive"] = np.array(
            columns.each(columns.dive_number, field(payloads, "dive")), np.int64
        )
        found["velocity"] = self.velocity * _factor(config)
        found["distance"] = cell_distances(payloads, n, m)
        found["error_std"] = believed_std(field(payloads, "velocity_std"), m)
        found |= _bottom(field(payloads, "bottom_track"))
        found |= _platform(field(payloads, "platform_velocity"))
        for name in QUALITY:
            values, found[f"no_{name}"] = by_cell(field(payloads, name), name, n, m)
            if values is not None:
                found[name] = values
        shapes = {name: column.shape[1:] for name, column in found.items()}
        own = {k: v.tobytes() if isinstance(v, np.ndarray) else v for k, v in fixed.items()}
        return found, fixed | {"layout": repr((own, shapes))}


def _instrument(payload: Payload, config: MeasurementConfig) -> dict[str, Any]:
    """Return what all pings of an instrument have in common.

    Raises:
        MeasurementError: A word is none of the known.
    """
    if payload.get("reference") is None:
        if config.reference is None:
            raise MeasurementError(_NO_REFERENCE)
        payload = {**payload, "reference": config.reference}
    floor = payload.get("noise_floor")
    vectors = payload.get("beam_unit_vectors")
    return {
        "frame": known_word(payload, "coordinate_system", SYSTEMS),
        "reference": known_word(payload, "reference", _REFERENCES),
        "orientation": known_word(payload, "orientation", _ORIENTATIONS),
        "cell_size": number(payload.get("cell_size")),
        "vectors": _vectors(vectors) if vectors else None,
        # a number in MAVLink, as that of the declination
        "bin_mapped": number(payload.get("bin_mapped")) == 1.0,
        "noise_floor": listed(floor)
        if isinstance(floor, list | tuple) and floor
        else np.array([number(floor)]),
        "needs_depth": payload.get("vehicle_depth_needed") is True,
        "correlation_depth": number(payload.get("correlation_depth")),
        "derived": payload.get("derived") is True,
        "convention": columns.word(payload.get("attitude_convention"), _CONVENTIONS),
        "gimbal": payload.get("gimbal_pitch") is True,
        "tilt_applied": payload.get("tilt_applied") is not False,
        "declination_applied": {1.0: True, 0.0: False}.get(
            number(payload.get("declination_applied"))
        ),
    }


def _vectors(value: Any) -> Array:
    """Return vectors listed one by one or flat, as protobuf carries them, shape (b, 3); (0, 3) where they are none."""
    try:
        return np.array(value, np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        return np.empty((0, 3))


def _factor(config: MeasurementConfig) -> float:
    """Return by what velocities are multiplied whose unit the settings state [m/s]."""
    return metres_per_second(config.velocity_unit or "m/s") or 1.0


def _bottom(stated: Sequence[Any]) -> dict[str, Array]:
    """Return the columns of the bottom track; NaN where none gives a velocity of three components, or a distance."""
    parts = _parts(stated)
    if not any(parts):
        blank = np.full((len(parts), 4), np.nan)
        return {"bottom": blank, "bottom_std": blank[:, 0], "bottom_range": blank[:, 0]}
    velocity = [listed(part.get("velocity")) for part in parts]
    bottom = np.full((len(parts), max(4, *map(len, velocity))), np.nan)
    for k, each in enumerate(velocity):
        if each.size >= 3:
            bottom[k, : each.size] = each
    ranges = [listed(part.get("distance")) for part in parts]
    nearest = [float(np.nanmin(each)) if np.isfinite(each).any() else math.nan for each in ranges]
    return {
        "bottom": bottom,
        "bottom_std": numbers(field(parts, "velocity_std")),
        "bottom_range": np.array(nearest),
    }


def _parts(stated: Sequence[Any]) -> Sequence[Payload]:
    """Return the fields of parts of messages, none where a message has no such part."""
    if {*map(type, stated)} == {dict}:
        return stated
    return [part if part is not None and isinstance(part, Mapping) else {} for part in stated]


def _platform(stated: Sequence[Any]) -> dict[str, Array]:
    parts = _parts(stated)
    east, north, std = (numbers(field(parts, name)) for name in ("east", "north", "velocity_std"))
    return {"platform": np.column_stack([east, north]), "platform_std": std}
