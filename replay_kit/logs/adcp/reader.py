"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds in other logs.

Records are found and checked here and decoded by MHKiT, bottom tracks of AD2CP files by ourselves. Velocities stay in the file's
coordinates, relative to the platform, with attitude, beam geometry and bottom track in the message; ``measurements`` makes them absolute.

Source: Nortek, "Integrators Guide, AD2CP" (N3015-007), bottom track data record definition (DF20).
"""

import struct
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.frames import AD2CP_MAGICS, PD0_MAGIC, Record, losses_between, scan
from replay_kit.logs.adcp.library import (
    BURST,
    NO_ENSEMBLE,
    PINGS,
    by_configuration,
    modes_of,
    read_mode,
    read_pd0,
)
from replay_kit.logs.adcp.profiles import (
    SECOND_NS,
    Fixes,
    RawProfiles,
    fixes_of,
    one_vertical,
    raw_profiles,
)
from replay_kit.logs.payloads import PING, Entry, entries, fix_entries, numbers
from replay_kit.logs.reader import Told, WholeLog, read_bytes

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
    for (of_track, _), track in tracks.items():
        velocity = _converted(track.velocity, of_track, system, vectors)
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


def _converted(velocity: Array, given: str, wanted: str, vectors: Any) -> Array | None:
    """Return velocities in other coordinates, shape (n, components); None if no conversion exists."""
    if given == wanted:
        return velocity
    if {given, wanted} != {"beam", "instrument"} or vectors is None:
        return None
    matrix = np.array(vectors) if wanted == "beam" else np.linalg.pinv(np.array(vectors))
    return np.asarray(velocity @ matrix.T) if velocity.shape[1] == matrix.shape[1] else None


_AVERAGES = "/adcp/average"
# kind of a PD0 ensemble, and names of other packets
_ENSEMBLE, _KNOWN = 0, {0x79: ", waves"}
#: Topic, number of pings that the file holds, and what was read of them.
Stream = tuple[str, int, RawProfiles]
_UNTURNED = "bottom track in coordinates that cannot be turned to those of the pings"


def open_raw_adcp(
    paths: Sequence[Path],
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
) -> WholeLog:
    """Return the log of a raw ADCP file; the instrument's clock is corrected by GPS fixes in the file.

    ``/vehicle/fix``: the vessel's GPS. ``/adcp``: velocities relative to the platform; ``/adcp/average``: Nortek's averaging mode. Further
    configurations of a Nortek are on ``/adcp/2`` and so on.

    Args:
        paths: The file.
        input: Ignored; set when the log is opened.
        config: Settings of log reading.
        wanted: Ignored.

    Raises:
        LogError: The file cannot be read, has no valid ensemble, or MHKiT is not installed or cannot read it.
    """
    del input, wanted
    path, data = paths[0], read_bytes(paths[0])
    records, told = scan(data), Told()
    told.losses = losses_between(records, len(data))
    is_ad2cp = data[:2] in AD2CP_MAGICS
    try:
        gps, streams = (_ad2cp if is_ad2cp else _pd0)(path, data, records, told)
    except (LookupError, ValueError, TypeError) as error:
        raise LogError(
            f"{path}: unknown setting of an instrument: {type(error).__name__}: {error}"
        ) from error
    missing: Counter[str] = Counter()
    for topic, expected, profiles in streams:
        missing[topic] += expected - int(profiles.known.sum())
    left_out = "ping that MHKiT leaves out or gives no time"
    first = {(topic, left_out): max(count, 0) for topic, count in missing.items()}
    bad = {("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)"): gps.n_bad}
    told.skipped = Counter({**first, **told.skipped, **bad})

    def begin() -> list[Iterator[Entry]]:
        # at one time a position comes before the velocities measured there
        pings = (_pings(topic, profiles, gps) for topic, _, profiles in streams)
        return [chain(fix_entries(gps.columns), *pings)]

    return WholeLog(paths, "ad2cp" if is_ad2cp else "pd0", told, begin, config)


def _pd0(
    path: Path, data: bytes, records: Sequence[Record], told: Told
) -> tuple[Fixes, list[Stream]]:
    """Return the fixes and the profiles of each configuration."""
    kinds = Counter(record.kind for record in records)
    ensembles = [record for record in records if record.kind == _ENSEMBLE]
    groups = by_configuration(data, ensembles, told)
    if not groups:
        why = "; ".join(f"{count} x {reason}" for (_, reason), count in told.skipped.items())
        raise LogError(f"{path}: {f'no ensemble can be read: {why}' if why else NO_ENSEMBLE}")
    others = [
        f"{count} packets of another kind ({PD0_MAGIC[0]:02X} {kind:02X}{_KNOWN.get(kind, '')})"
        for kind, count in sorted(kinds.items())
        if kind != _ENSEMBLE
    ]
    if others:
        told.notes.append(f"{', '.join(others)}, skipped")
    datasets, found, errors = [], list[Stream](), list[LogError]()
    for group in groups:
        ordinals, parts = zip(*group, strict=True)
        try:
            datasets.append(read_pd0(path, parts))
        except LogError as error:
            # damage that left a sum of bytes as it was may look like another configuration
            errors.append(error)
            told.skipped[PINGS, _unreadable(path, error)] += len(group)
            continue
        found.append((PINGS, len(group), raw_profiles(datasets[-1], "", ordinals)))
    if not found:
        raise errors[0]
    if not any("vel" in dataset for dataset in datasets):
        told.notes.append("bottom track and fixes alone: the file holds no profile of the current")
    return fixes_of(datasets), found


def _unreadable(path: Path, error: Exception) -> str:
    return f"configuration that cannot be read: {str(error).removeprefix(f'{path}: ')}"


def _ad2cp(
    path: Path, data: bytes, records: Sequence[Record], told: Told
) -> tuple[Fixes, list[Stream]]:
    """Return empty fixes, and the profiles of each mode and configuration with bottom tracks as streams."""
    tracks, no_bottom = bottom_tracks(data, records)
    found: list[Stream] = []
    names, said, errors = Counter[str](), [], list[Exception]()
    for mode in modes_of(path, data, records):
        topic = PINGS if mode.kind == BURST else _AVERAGES
        names[topic] += 1
        topic = topic if names[topic] == 1 else f"{topic}/{names[topic]}"
        try:
            dataset = read_mode(path, mode)
            # of one mode alone MHKiT may leave the name of an average out
            tag = "" if "vel" in dataset else "_avg"
            profiles = with_bottom(raw_profiles(dataset, tag, mode.ordinals), tracks)
        except (LogError, LookupError, ValueError, TypeError) as error:
            errors.append(error)
            told.skipped[topic, _unreadable(path, error)] += len(mode.pings)
            continue
        found.append((topic, len(mode.pings), profiles))
        cells, size = (profiles.common[name] for name in ("n_cells", "cell_size"))
        said.append(f"{topic} ({len(mode.pings)} pings of {cells} cells of {size:g} m)")
    if not found:
        raise errors[0]
    if len(said) > 1:
        told.notes.append(f"{len(said)} configurations, each a stream of pings: {', '.join(said)}")
    if tracks and all(profiles.bottom is None for *_, profiles in found):
        no_bottom[_UNTURNED] = sum(track.time_ns.size for track in tracks.values())
    told.skipped.update({("/adcp/bottom_track", why): n for why, n in no_bottom.items()})
    return fixes_of([]), found


def _pings(topic: str, profiles: RawProfiles, gps: Fixes) -> Iterator[Entry]:
    offset_ns = gps.offset_ns
    time_ns = profiles.time_ns + (offset_ns or 0)
    common = {
        "frame_id": "adcp",
        **profiles.common,
        "clock_offset": None if offset_ns is None else offset_ns / SECOND_NS,
    }
    columns: dict[str, NDArray[Any]] = {
        name: np.round(values, 6) for name, values in profiles.per_ping.items()
    }
    columns |= {"ping": profiles.ordinals, "bottom_track": _bottom_tracks(profiles)}
    if not common["declination_applied"] and offset_ns is not None:
        # the heading is magnetic, and the instrument stated no declination
        found = map(gps.declination, time_ns.tolist())
        columns["magnetic_declination"] = np.array([*found], np.float64)
    return entries((topic, PING), time_ns, columns, np.flatnonzero(profiles.known), common)


def _bottom_tracks(profiles: RawProfiles) -> NDArray[Any]:
    """Return the bottom velocity relative to the instrument, in the ping's coordinates, and its distance by beam; None without."""
    found = np.full(profiles.time_ns.size, None)
    if profiles.bottom is not None:
        velocity, distance = (numbers(np.round(values, 4)) for values in profiles.bottom)
        for k in np.flatnonzero(np.isfinite(profiles.bottom[0]).any(axis=1)).tolist():
            found[k] = {"velocity": velocity[k], "distance": distance[k]}
    return found
