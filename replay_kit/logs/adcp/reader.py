"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds in other logs.

Records are found and checked here and decoded by MHKiT. Velocities stay in the file's coordinates, relative to the platform, with attitude,
beam geometry and bottom track in the message; ``measurements`` makes them absolute.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.bottom_track import bottom_tracks, with_bottom
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
from replay_kit.logs.adcp.profiles import SECOND_NS, Fixes, RawProfiles, fixes_of, raw_profiles
from replay_kit.logs.payloads import PING, Entry, entries, fix_entries, numbers
from replay_kit.logs.reader import Told, WholeLog, read_bytes

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
    datasets = [read_pd0(path, [part for _, part in group]) for group in groups]
    if not any("vel" in dataset for dataset in datasets):
        told.notes.append("bottom track and fixes alone: the file holds no profile of the current")
    return fixes_of(datasets), [
        (PINGS, len(group), raw_profiles(dataset, "", [ordinal for ordinal, _ in group]))
        for dataset, group in zip(datasets, groups, strict=True)
    ]


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
            why = str(error).removeprefix(f"{path}: ")
            told.skipped[topic, f"configuration that cannot be read: {why}"] += len(mode.pings)
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
