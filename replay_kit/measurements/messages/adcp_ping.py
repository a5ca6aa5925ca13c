"""The payload of a ``replay_kit.AdcpPing`` to an ``AdcpPing``: every field is read and checked here, once.

The field names and units are in ``ADCP_PING.md`` beside this file. A field that decides what the velocities are must be right; one that
only some pings need (beam vectors, the attitude's convention) is refused where it is needed.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from reprlib import repr as shorten
from typing import Any, cast

import numpy as np

from replay_kit.core.arrays import Array
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
_NUMBERS = (
    "cell_size",
    "bin0_distance",
    "heading",
    "pitch",
    "roll",
    "magnetic_declination",
    "declination_applied",
    "bin_mapped",
    "pressure",
    "transducer_depth",
    "correlation_depth",
)
_CONVENTIONS = ("teledyne", "nortek")
_NO_REFERENCE = (
    "ping: expected reference to be one of earth, platform, got none; state it in the message, or as measurements.reference "
    "when the message has no place for it"
)


def parse_ping(payload: Mapping[str, Any], reference: Reference | None = None) -> AdcpPing:
    """Return the ping that a payload holds.

    Args:
        payload: Its fields, with JSON's lists of lists or protobuf's flat ones.
        reference: What the velocities are relative to where the payload does not say.

    Raises:
        MeasurementError: A word is none of the known, or the cells are not as many numbers as they must be.
    """
    if payload.get("reference") is None:
        if reference is None:
            raise MeasurementError(_NO_REFERENCE)
        payload = {**payload, "reference": reference}
    system = cast(CoordinateSystem, known_word(payload, "coordinate_system", COORDINATE_SYSTEMS))
    velocity = fields.velocity_cells(payload, system == "earth")
    n = len(velocity)
    stated = dict.fromkeys(_NUMBERS, math.nan)
    stated |= {name: number(payload[name]) for name in payload.keys() & stated.keys()}
    bottom, platform = (
        fields.part(payload.get(name)) for name in ("bottom_track", "platform_velocity")
    )
    east, north, platform_std = (
        number((platform or {}).get(name)) for name in ("east", "north", "velocity_std")
    )
    amplitude, correlation, percent_good, snr, error_velocity = (
        fields.by_cell(payload, name, n) for name in _CELL_FIELDS
    )
    convention = fields.word(payload.get("attitude_convention"), _CONVENTIONS)
    return AdcpPing(
        velocity=velocity,
        velocity_std=fields.believed_std(payload.get("velocity_std"), n),
        coordinate_system=system,
        measured_system=system,
        reference=cast(Reference, known_word(payload, "reference", _REFERENCES)),
        orientation=cast(Look, known_word(payload, "orientation", _ORIENTATIONS)),
        cell_size=stated["cell_size"],
        beam_vectors=fields.unit_vectors(payload.get("beam_unit_vectors")),
        # a number in MAVLink, as the declination's
        bin_mapped=stated["bin_mapped"] == 1.0,
        bottom_track=None
        if bottom is None
        else BottomTrack(
            numbers(bottom.get("velocity")),
            number(bottom.get("velocity_std")),
            numbers(bottom.get("distance")),
        ),
        platform_velocity=None
        if platform is None
        else PlatformVelocity(east, north, platform_std, str(platform.get("source", "stated"))),
        quality=QualityFields(
            amplitude,
            correlation,
            percent_good,
            snr,
            error_velocity,
            fields.number_or_numbers(payload.get("noise_floor")),
        ),
        pressure=stated["pressure"],
        transducer_depth=stated["transducer_depth"],
        needs_vehicle_depth=payload.get("vehicle_depth_needed") is True,
        correlation_depth=stated["correlation_depth"],
        dive=fields.dive_number(payload.get("dive")),
        derived=payload.get("derived") is True,
        attitude=_attitude(payload, stated, convention),
        distance=_distance(payload, stated, n),
    )


def _attitude(
    payload: Mapping[str, Any], stated: Mapping[str, float], convention: str
) -> InstrumentAttitude:
    return InstrumentAttitude(
        stated["heading"],
        stated["pitch"],
        stated["roll"],
        convention,
        euler_pitch=payload.get("gimbal_pitch") is True,
        tilt_applied=payload.get("tilt_applied") is not False,
        declination=stated["magnetic_declination"],
        declination_applied={1.0: True, 0.0: False}.get(stated["declination_applied"]),
    )


def _distance(payload: Mapping[str, Any], stated: Mapping[str, float], n: int) -> Array:
    """Return how far the centres of n cells are from the transducer [m]: as ``cell_distances`` lists them, or evenly spaced."""
    if (listed := payload.get("cell_distances")) is not None:
        if not isinstance(listed, list | tuple) or len(listed) != n:
            raise MeasurementError(
                f"ping: expected cell_distances to be {n} numbers [m], got {shorten(listed)}"
            )
        return numbers(listed)
    first, size = stated["bin0_distance"], stated["cell_size"]
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
