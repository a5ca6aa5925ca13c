"""The payload of a ``replay_kit.AdcpPing`` to an ``AdcpPing``: every field is read and checked here, once.

The field names and units are in ``ADCP_PING.md`` beside this file. A field that decides what the velocities are must be right; one that
only some pings need (beam vectors, the attitude's convention) is refused where it is needed.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from reprlib import repr as shorten
from typing import Any, cast

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Reference
from replay_kit.measurements.messages import fields
from replay_kit.measurements.messages.fields import known_word, number, numbers
from replay_kit.measurements.ping.adcp_ping import (
    AdcpPing,
    BottomTrack,
    CoordinateSystem,
    InstrumentAttitude,
    Look,
    PlatformVelocity,
    QualityFields,
)

COORDINATE_SYSTEMS: tuple[CoordinateSystem, ...] = ("beam", "instrument", "ship", "earth")
_REFERENCES: tuple[Reference, ...] = ("earth", "platform")
_ORIENTATIONS: tuple[Look, ...] = ("down", "up")
_CELL_FIELDS = ("amplitude", "correlation", "percent_good", "snr", "error_velocity")
# What is the instrument's, and mostly the same in all its pings; the rest each ping has of its own.
_OF_INSTRUMENT = (
    "reference",
    "coordinate_system",
    "n_cells",
    "orientation",
    "cell_size",
    "bin0_distance",
    "cell_distances",
    "beam_unit_vectors",
    "bin_mapped",
    "noise_floor",
    "transducer_depth",
    "vehicle_depth_needed",
    "correlation_depth",
    "dive",
    "derived",
    "attitude_convention",
    "gimbal_pitch",
    "tilt_applied",
    "magnetic_declination",
    "declination_applied",
)
_CONVENTIONS = ("teledyne", "nortek")
_NO_REFERENCE = (
    "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference "
    "when the message has no place for it"
)


def parse_ping(payload: Mapping[str, Any], reference: Reference | None = None) -> AdcpPing:
    """Return the ping that a payload holds; arguments as of ``parse_pings``.

    Raises:
        MeasurementError: A word is none of the known, or the cells are not as many numbers as they must be.
    """
    (ping,) = parse_pings([payload], reference)
    if isinstance(ping, MeasurementError):
        raise ping
    return ping


def parse_pings(
    payloads: Sequence[Mapping[str, Any]], reference: Reference | None = None
) -> list[AdcpPing | MeasurementError]:
    """Return the pings that payloads hold, or what is wrong with one: a word is none of the known, or cells are not what they must be.

    Args:
        payloads: Their fields, with JSON's lists of lists or protobuf's flat ones.
        reference: What the velocities are relative to where a payload does not say.
    """
    found: list[AdcpPing | MeasurementError] = []
    known: tuple[Any, ...] = ()
    velocities = fields.velocity_cells(payloads, COORDINATE_SYSTEMS)
    for payload, velocity in zip(payloads, velocities, strict=True):
        stated = tuple(map(payload.get, _OF_INSTRUMENT))
        try:
            if isinstance(velocity, MeasurementError):
                raise velocity
            if stated != known:
                like, known = _of_instrument(payload, reference, velocity), stated
            found.append(_of_ping(like, payload, velocity))
        except MeasurementError as error:
            found.append(error)
    return found


def _of_instrument(
    payload: Mapping[str, Any], reference: Reference | None, velocity: Array
) -> AdcpPing:
    """Return a ping with all that pings of one instrument have in common, and nothing of its own."""
    if payload.get("reference") is None:
        if reference is None:
            raise MeasurementError(_NO_REFERENCE)
        payload = {**payload, "reference": reference}
    system = cast(CoordinateSystem, known_word(payload, "coordinate_system", COORDINATE_SYSTEMS))
    return AdcpPing(
        velocity=velocity,
        velocity_std=velocity[:, 0],
        coordinate_system=system,
        measured_system=system,
        reference=cast(Reference, known_word(payload, "reference", _REFERENCES)),
        orientation=cast(Look, known_word(payload, "orientation", _ORIENTATIONS)),
        cell_size=number(payload.get("cell_size")),
        beam_vectors=fields.unit_vectors(payload.get("beam_unit_vectors")),
        # a number in MAVLink, as the declination's
        bin_mapped=number(payload.get("bin_mapped")) == 1.0,
        bottom_track=None,
        platform_velocity=None,
        quality=_quality({}, velocity, fields.number_or_numbers(payload.get("noise_floor"))),
        pressure=math.nan,
        transducer_depth=number(payload.get("transducer_depth")),
        needs_vehicle_depth=payload.get("vehicle_depth_needed") is True,
        correlation_depth=number(payload.get("correlation_depth")),
        dive=fields.dive_number(payload.get("dive")),
        derived=payload.get("derived") is True,
        attitude=InstrumentAttitude(
            math.nan,
            math.nan,
            math.nan,
            fields.word(payload.get("attitude_convention"), _CONVENTIONS),
            euler_pitch=payload.get("gimbal_pitch") is True,
            tilt_applied=payload.get("tilt_applied") is not False,
            declination=number(payload.get("magnetic_declination")),
            declination_applied={1.0: True, 0.0: False}.get(
                number(payload.get("declination_applied"))
            ),
        ),
        distance=_distance(payload, len(velocity)),
    )


def _of_ping(like: AdcpPing, payload: Mapping[str, Any], velocity: Array) -> AdcpPing:
    """Return a ping of an instrument with what it has of its own."""
    quality = like.quality
    if any(map(payload.get, _CELL_FIELDS)):
        quality = _quality(payload, velocity, quality.noise_floor)
    bottom, platform = (
        fields.part(payload.get(name)) for name in ("bottom_track", "platform_velocity")
    )
    attitude, angles = like.attitude, [*map(payload.get, ("heading", "pitch", "roll"))]
    if angles != [None] * len(angles):
        heading, pitch, roll = map(number, angles)
        attitude = replace(attitude, heading=heading, pitch=pitch, roll=roll)
    return replace(
        like,
        velocity=velocity,
        velocity_std=fields.believed_std(payload.get("velocity_std"), len(velocity)),
        attitude=attitude,
        quality=quality,
        pressure=number(payload.get("pressure")),
        bottom_track=None
        if bottom is None
        else BottomTrack(
            numbers(bottom.get("velocity")),
            number(bottom.get("velocity_std")),
            numbers(bottom.get("distance")),
        ),
        platform_velocity=None
        if platform is None
        else PlatformVelocity(
            number(platform.get("east")),
            number(platform.get("north")),
            number(platform.get("velocity_std")),
            str(platform.get("source", "stated")),
        ),
    )


def _quality(payload: Mapping[str, Any], velocity: Array, noise_floor: Array) -> QualityFields:
    amplitude, correlation, percent_good, snr, error_velocity = (
        fields.by_cell(payload, name, len(velocity)) for name in _CELL_FIELDS
    )
    return QualityFields(amplitude, correlation, percent_good, snr, error_velocity, noise_floor)


def _distance(payload: Mapping[str, Any], n: int) -> Array:
    """Return how far the centres of n cells are from the transducer [m]: as ``cell_distances`` lists them, or evenly spaced."""
    if (listed := payload.get("cell_distances")) is not None:
        if not isinstance(listed, list | tuple) or len(listed) != n:
            raise MeasurementError(
                f"ping: expected cell_distances to be {n} numbers [m], got {shorten(listed)}"
            )
        return numbers(listed)
    first, size = (number(payload.get(name)) for name in ("bin0_distance", "cell_size"))
    if not (size > 0.0 and math.isfinite(first)):
        raise MeasurementError(
            "ping: expected cell_size > 0 and a finite bin0_distance [m], "
            f"got {shorten(payload.get('cell_size'))} and {shorten(payload.get('bin0_distance'))}"
        )
    return _evenly_spaced(first, size, n)


@lru_cache(maxsize=64)
def _evenly_spaced(first: float, size: float, n: int) -> Array:
    """Return the distances of n cells [m], for all pings of a configuration the same array."""
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.asarray(first + size * np.arange(n), np.float64)
    distance.setflags(write=False)
    return distance
