"""Bottom-track records of AD2CP files, decoded and assigned to pings.

Source: Nortek, "Integrators Guide, AD2CP" (N3015-007), bottom track data record definition (DF20): velocities as for water, along the beams
away from the instrument or along its axes, times 10 to the power of the velocity scaling [m/s]; distances [mm].
"""

import struct
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.logs.adcp.frames import Record
from replay_kit.logs.adcp.profiles import RawProfiles, one_vertical

BOTTOM_TRACK = 0x17
_LEAST = 78
#: Offset of the data, configuration, clock (years since 1900, months from 0, ..., seconds, then 0.1 ms), beams and coordinates, scaling.
_HEAD = struct.Struct("<xBH4x6BH14xH28xb")
_SYSTEMS = ("earth", "instrument", "beam")
# by the bit that says that a field is there, the type of its numbers
_VELOCITY, _DISTANCE, _MERIT = 1 << 5, 1 << 8, 1 << 9
_TYPES = {
    bit: np.dtype(kind) for bit, kind in ((_VELOCITY, "<i4"), (_DISTANCE, "<i4"), (_MERIT, "<u2"))
}
_MISSING = -32768
# The figure of merit is proportional to the standard deviation; Nortek's own examples have some 100. A limit of ours.
_MOST_MERIT = 1000
# A ping and the bottom ping beside it are fractions of a second apart [ns].
_BESIDE_NS = 3_000_000_000
NOT_FOUND = "bottom not found: by velocity, distance or figure of merit"


class BottomTracks(NamedTuple):
    """Bottom velocities relative to the instrument, in one coordinate system.

    Attributes:
        time_ns: shape (n,), increasing [ns], by the instrument's clock.
        velocity: shape (n, components) [m/s]; NaN without bottom.
        distance: shape (n, beams), vertical [m]; NaN without bottom.
    """

    time_ns: Times
    velocity: Array
    distance: Array


#: Bottom tracks by coordinate system and number of beams.
Tracks = Mapping[tuple[str, int], BottomTracks]


def bottom_tracks(data: bytes, records: Sequence[Record]) -> tuple[Tracks, Counter[str]]:
    """Return the bottom tracks of a file, and the number of unusable records by reason.

    Args:
        data: The file.
        records: Its valid records.
    """
    rows = defaultdict[tuple[str, int], list[tuple[int, Array, Array]]](list)
    unused: Counter[str] = Counter()
    for record in records:
        if record.kind == BOTTOM_TRACK:
            found = _decoded(data[record.start + data[record.start + 1] : record.end])
            if isinstance(found, str):
                unused[found] += 1
            else:
                system, row = found
                rows[system, row[2].size].append(row)
    tracks = {}
    for key, held in rows.items():
        times, velocity, distance = zip(*sorted(held, key=lambda row: row[0]), strict=True)
        tracks[key] = BottomTracks(np.array(times), np.array(velocity), np.array(distance))
    return tracks, unused


def _decoded(body: bytes) -> tuple[str, tuple[int, Array, Array]] | str:
    """Return coordinate system, and time [ns], velocity and distance, of a record, or why it is unusable."""
    if len(body) < _LEAST:
        return f"bottom track of {len(body)} bytes, {_LEAST} are needed"
    offset, config, year, month, *rest, ticks, beams_cy, scaling = _HEAD.unpack_from(body)
    day, hour, minute, second = rest
    n, system = beams_cy >> 12, beams_cy >> 10 & 3
    if system >= len(_SYSTEMS) or not config & _VELOCITY or n < 3:
        return "bottom track without velocities, or in unknown coordinates"
    values = {_DISTANCE: np.full(n, np.nan), _MERIT: np.zeros(n)}
    for bit, dtype in _TYPES.items():
        if config & bit:
            if offset + n * dtype.itemsize > len(body):
                return "bottom track shorter than its configuration says"
            values[bit] = np.frombuffer(body, dtype, n, offset).astype(np.float64)
            offset += n * dtype.itemsize
    try:
        time = datetime(1900 + year, month + 1, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return "bottom track without a time"
    time_ns = int(time.timestamp()) * 1_000_000_000 + ticks * 100_000
    velocity, distance = values[_VELOCITY], values[_DISTANCE] / 1000.0
    lost = (velocity == _MISSING) | (distance <= 0.0) | (values[_MERIT] >= _MOST_MERIT)
    # of coordinates made of all beams, one that found no bottom spoils all
    spoilt = lost if _SYSTEMS[system] == "beam" else np.full(n, lost.any())
    if spoilt.all():
        return NOT_FOUND
    moved = one_vertical(np.where(spoilt, np.nan, velocity * 10.0**scaling), _SYSTEMS[system])
    return _SYSTEMS[system], (time_ns, moved, np.where(lost, np.nan, distance))


def with_bottom(profiles: RawProfiles, tracks: Tracks) -> RawProfiles:
    """Return pings with the bottom track nearest in time, within three seconds, in the pings' own coordinates.

    Beam and instrument coordinates are converted to the pings' by the beams' unit vectors; others must agree.

    Args:
        profiles: The pings.
        tracks: Bottom tracks.
    """
    system, vectors = profiles.common["coordinate_system"], profiles.common["beam_unit_vectors"]
    for (own, _), track in tracks.items():
        velocity = _converted(track.velocity, own, system, vectors)
        if velocity is not None:
            times, wanted = track.time_ns, profiles.time_ns
            after = np.minimum(np.searchsorted(times, wanted), times.size - 1)
            before = np.maximum(after - 1, 0)
            nearer = np.abs(times[after] - wanted) < np.abs(times[before] - wanted)
            nearest = np.where(nearer, after, before)
            beside = (np.abs(times[nearest] - wanted) <= _BESIDE_NS)[:, None]
            held = (velocity, track.distance)
            found, distance = (np.where(beside, each[nearest], np.nan) for each in held)
            return replace(profiles, bottom=(found, distance))
    return profiles


def _converted(velocity: Array, own: str, wanted: str, vectors: Any) -> Array | None:
    """Return velocities in other coordinates, shape (n, components); None if no conversion exists."""
    if own == wanted:
        return velocity
    if {own, wanted} != {"beam", "instrument"} or vectors is None:
        return None
    matrix = np.array(vectors) if wanted == "beam" else np.linalg.pinv(np.array(vectors))
    return np.asarray(velocity @ matrix.T) if velocity.shape[1] == matrix.shape[1] else None
