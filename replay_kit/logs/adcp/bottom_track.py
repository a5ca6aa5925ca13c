"""Bottom-track records of AD2CP files, decoded and assigned to pings.

Source: Nortek, "Integrators Guide, AD2CP" (N3015-007), bottom track data record definition (DF20): velocities as for water, along the beams
away from the instrument or along its axes, times 10 to the power of the velocity scaling [m/s]; distances [mm].
"""

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.adcp.frames import Record
from replay_kit.logs.adcp.profiles import RawProfiles, one_vertical

BOTTOM_TRACK = 0x17
_LEAST = 78
_SYSTEMS = ("earth", "instrument", "beam")
_VELOCITY, _DISTANCE, _MERIT = 1 << 5, 1 << 8, 1 << 9
_MISSING = -32768
# The figure of merit is proportional to the standard deviation; Nortek's own examples have some 100. A limit of ours.
_MOST_MERIT = 1000
# A ping and the bottom ping beside it are fractions of a second apart [ns].
_BESIDE_NS = 3_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NOT_FOUND = "bottom not found: by velocity, distance or figure of merit"


@dataclass(frozen=True, slots=True, eq=False)
class BottomTracks:
    """Bottom velocities relative to the instrument, in one coordinate system.

    Attributes:
        time_ns: shape (n,), increasing [ns], by the instrument's clock.
        velocity: shape (n, components) [m/s]; NaN without bottom.
        distance: shape (n, beams), vertical [m]; NaN without bottom.
    """

    time_ns: NDArray[np.int64]
    velocity: Array
    distance: Array


def bottom_tracks(
    data: bytes, records: Sequence[Record]
) -> tuple[dict[str, BottomTracks], Counter[str]]:
    """Return the bottom tracks of a file by coordinate system, and the number of unusable records by reason.

    Args:
        data: The file.
        records: Its valid records.
    """
    rows: dict[str, list[tuple[int, Array, Array]]] = {}
    unused: Counter[str] = Counter()
    for record in records:
        if record.kind == BOTTOM_TRACK:
            system, row = _decoded(data[record.start + data[record.start + 1] : record.end])
            if row is None:
                unused[system] += 1
            else:
                rows.setdefault(system, []).append(row)
    return {system: _as_columns(found) for system, found in rows.items()}, unused


def _as_columns(rows: list[tuple[int, Array, Array]]) -> BottomTracks:
    rows = sorted(rows, key=lambda row: row[0])
    velocity, distance = (
        _stacked([velocity for _, velocity, _ in rows]),
        _stacked([distance for _, _, distance in rows]),
    )
    return BottomTracks(np.array([time_ns for time_ns, _, _ in rows], np.int64), velocity, distance)


def _stacked(rows: list[Array]) -> Array:
    """Return rows as one array, padded with NaN."""
    stacked = np.full((len(rows), max(row.size for row in rows)), np.nan)
    for k, row in enumerate(rows):
        stacked[k, : row.size] = row
    return stacked


def _decoded(body: bytes) -> tuple[str, tuple[int, Array, Array] | None]:
    """Return coordinate system, and time, velocity and distance of a record; or the reason and None for an unusable one."""
    if len(body) < _LEAST:
        return f"bottom track of {len(body)} bytes, {_LEAST} are needed", None
    (config,), (beams_cy,) = struct.unpack_from("<H", body, 2), struct.unpack_from("<H", body, 30)
    (scaling,) = struct.unpack_from("<b", body, 60)
    n, system = beams_cy >> 12, beams_cy >> 10 & 3
    if system >= len(_SYSTEMS) or not config & _VELOCITY or n < 3:
        return "bottom track without velocities, or in unknown coordinates", None
    fields = {
        bit: struct.Struct(f"<{n}{code}")
        for bit, code in ((_VELOCITY, "i"), (_DISTANCE, "i"), (_MERIT, "H"))
        if config & bit
    }
    if body[1] + sum(field.size for field in fields.values()) > len(body):
        return "bottom track shorter than its configuration says", None
    values, offset = {}, body[1]
    for bit, field in fields.items():
        values[bit] = np.array(field.unpack_from(body, offset), np.float64)
        offset += field.size
    time_ns = _time_ns(body)
    if time_ns is None:
        return "bottom track without a time", None
    distance = values.get(_DISTANCE, np.full(n, np.nan)) / 1000.0
    lost = (
        (values[_VELOCITY] == _MISSING)
        | (distance <= 0.0)
        | (values.get(_MERIT, np.zeros(n)) >= _MOST_MERIT)
    )
    # of coordinates made of all beams, one that found no bottom spoils all
    spoilt = lost if _SYSTEMS[system] == "beam" else np.full(n, lost.any())
    if spoilt.all():
        return NOT_FOUND, None
    velocity = np.where(spoilt, np.nan, values[_VELOCITY] * 10.0**scaling)
    return _SYSTEMS[system], (
        time_ns,
        one_vertical(velocity, _SYSTEMS[system]),
        np.where(lost, np.nan, distance),
    )


def _time_ns(body: bytes) -> int | None:
    year, month, day, hour, minute, second, ticks = struct.unpack_from("<6BH", body, 8)
    try:
        since = datetime(1900 + year, month + 1, day, hour, minute, second, tzinfo=UTC) - _EPOCH
    except ValueError:
        return None
    return int(since / timedelta(seconds=1)) * 1_000_000_000 + int(ticks) * 100_000


def with_bottom(profiles: RawProfiles, tracks: Mapping[str, BottomTracks]) -> RawProfiles:
    """Return pings with the bottom track nearest in time, within three seconds, in the pings' own coordinates.

    Beam and instrument coordinates are converted to the pings' by the beams' unit vectors; others must agree.

    Args:
        profiles: The pings.
        tracks: Bottom tracks by coordinate system.
    """
    system, vectors = profiles.common["coordinate_system"], profiles.common["beam_unit_vectors"]
    for own, track in tracks.items():
        velocity = _converted(track.velocity, own, system, vectors)
        if velocity is not None:
            after = np.clip(
                np.searchsorted(track.time_ns, profiles.time_ns), 1, max(track.time_ns.size - 1, 1)
            )
            before = after - 1
            after = np.minimum(after, track.time_ns.size - 1)
            nearer = np.abs(track.time_ns[after] - profiles.time_ns) < np.abs(
                track.time_ns[before] - profiles.time_ns
            )
            nearest = np.where(nearer, after, before)
            beside = np.abs(track.time_ns[nearest] - profiles.time_ns) <= _BESIDE_NS
            found, distance = (
                np.where(beside[:, None], values[nearest], np.nan)
                for values in (velocity, track.distance)
            )
            return replace(profiles, bottom=(found, distance))
    return profiles


def _converted(velocity: Array, own: str, wanted: str, vectors: Any) -> Array | None:
    """Return velocities in other coordinates, shape (n, components); None if no conversion exists."""
    if own == wanted:
        return velocity
    if (
        {own, wanted} != {"beam", "instrument"}
        or vectors is None
        or velocity.shape[1] != (3 if own == "instrument" else len(vectors))
    ):
        return None
    matrix = np.array(vectors) if wanted == "beam" else np.linalg.pinv(np.array(vectors))
    return np.asarray(velocity @ matrix.T)
