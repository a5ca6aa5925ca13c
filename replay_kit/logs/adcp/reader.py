"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds that other logs hold.

The records are found and checked here, decoded by MHKiT. Velocities stay in the file's own coordinates, relative to the platform,
with attitude, beam geometry and bottom track in the same message: ``measurements`` rotates them and makes them absolute.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.adcp.bottom_track import bottom_tracks, with_bottom
from replay_kit.logs.adcp.dolfyn import NO_ENSEMBLE, read_ad2cp, read_pd0
from replay_kit.logs.adcp.gps import Fixes, fixes_of
from replay_kit.logs.adcp.pd0 import by_configuration
from replay_kit.logs.adcp.profiles import RawProfiles, raw_profiles
from replay_kit.logs.adcp.records import PD0_MAGIC, lose_between, scan
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.payloads import FIX, PING, location_fix, numbers, stamp
from replay_kit.logs.shared.statistics import ReadStatistics

_NS = 1_000_000_000
_TOPICS = {"": "/adcp", "_avg": "/adcp/average"}
_BURST_PING, _AVERAGE_PING = 0x15, 0x16
_UNTURNED = "bottom track in coordinates that cannot be turned to those of the pings"


class RawAdcpReader(LogFile):
    """A raw ADCP file, read whole. An instrument has one clock, set right by GPS where the file has fixes."""

    def __init__(
        self,
        path: Path,
        input: int = 0,
        config: LogConfig | None = None,
        wanted: frozenset[str] | None = None,
    ) -> None:
        """Read the file; arguments as of ``LogFile``.

        Raises:
            LogError: The file cannot be read, has no sound ensemble, or MHKiT is not installed or cannot read it.
        """
        super().__init__(path, input, config, wanted)
        with self._opened() as file:
            data = file.read()
        self.format = "pd0" if data[:2] == PD0_MAGIC else "ad2cp"
        self._size = len(data)
        self._records = scan(data)
        self._unreadable: Mapping[str, int] = {}
        self._notes: tuple[str, ...] = ()
        self._no_bottom: Counter[str] = Counter()
        try:
            self._gps, self._profiles = (self._pd0 if self.format == "pd0" else self._ad2cp)(data)
        except (LookupError, ValueError, TypeError) as error:
            raise LogError(
                f"{path}: not a setting of an instrument that is understood: {type(error).__name__}: {error}"
            ) from error
        if not self._profiles:
            raise LogError(
                f"{path}: it has no profile of velocities; give a file of a current profiler"
            )

    def _pd0(self, data: bytes) -> tuple[Fixes, list[tuple[str, RawProfiles]]]:
        """Return the fixes and the profiles of each configuration."""
        path, found = Path(self.path), by_configuration(data, self._records)
        if not found.parts:
            why = "; ".join(f"{count} x {reason}" for reason, count in found.unreadable.items())
            raise LogError(f"{path}: {f'no ensemble can be read: {why}' if why else NO_ENSEMBLE}")
        self._unreadable, self._notes = found.unreadable, found.notes
        datasets = [
            read_pd0(path, [found.parts[k] for k in group], key.has_pressure)
            for key, group in found.groups.items()
        ]
        pairs = zip(datasets, found.groups.values(), strict=True)
        return fixes_of(datasets), [
            ("", raw_profiles(dataset, "", group)) for dataset, group in pairs
        ]

    def _ad2cp(self, data: bytes) -> tuple[Fixes, list[tuple[str, RawProfiles]]]:
        """Return the fixes, none, and the profiles of each mode with their bottom tracks."""
        datasets = read_ad2cp(Path(self.path), data, self._records)
        tracks, self._no_bottom = bottom_tracks(data, self._records)
        found = [
            (tag, with_bottom(raw_profiles(ds, tag), tracks))
            for ds in datasets
            for tag in _TOPICS
            if f"vel{tag}" in ds
        ]
        if tracks and all(profiles.bottom is None for _, profiles in found):
            self._no_bottom[_UNTURNED] = sum(track.time_ns.size for track in tracks.values())
        return fixes_of(datasets), found

    def messages(self) -> Iterator[Message]:
        """Yield the messages in order of time.

        ``/vehicle/fix``: the vessel's GPS. ``/adcp``: velocities relative to the platform; ``/adcp/average``: those of a Nortek's
        averaging mode, where it has both.
        """
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        lose_between(self.statistics, self._records, self._size)
        kinds = Counter(record.kind for record in self._records)
        pings = {"": 0 if self.format == "pd0" else _BURST_PING, "_avg": _AVERAGE_PING}
        for tag in dict.fromkeys(tag for tag, _ in self._profiles):
            known = sum(int(profiles.known.sum()) for of, profiles in self._profiles if of == tag)
            missing = kinds[pings[tag]] - known - sum(self._unreadable.values())
            self._skip(_TOPICS[tag], "ping that MHKiT leaves out or gives no time", max(missing, 0))
        for reason, count in self._unreadable.items():
            self._skip(_TOPICS[""], reason, count)
        self._skip("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)", self._gps.n_bad)
        for reason, count in self._no_bottom.items():
            self._skip("/adcp/bottom_track", reason, count)
        # at one time a position comes before the velocities measured there
        yield from self._by_time(
            chain(
                self._fixes(),
                *(self._pings(_TOPICS[tag], profiles) for tag, profiles in self._profiles),
            )
        )

    def _fixes(self) -> Iterator[Entry]:
        columns = (self._gps.time_ns, self._gps.longitude, self._gps.latitude)
        for time_ns, longitude, latitude in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            yield (
                time_ns,
                "/vehicle/fix",
                FIX,
                location_fix(time_ns, longitude, latitude, 0.0, False, float("nan")),
            )

    def _pings(self, topic: str, profiles: RawProfiles) -> Iterator[Entry]:
        offset_ns = self._gps.offset_ns
        per_ping = {
            name: numbers(np.round(values, 6)) for name, values in profiles.per_ping.items()
        }
        for k in np.flatnonzero(profiles.known).tolist():
            time_ns = int(profiles.time_ns[k]) + (offset_ns or 0)
            payload = {
                "stamp": stamp(time_ns),
                "frame_id": "adcp",
                "ping": int(profiles.ordinals[k]),
                **profiles.common,
                "velocity_std": None,
                **{name: values[k] for name, values in per_ping.items()},
                "clock_offset": None if offset_ns is None else offset_ns / _NS,
                "bottom_track": _bottom_track(profiles, k),
            }
            if not payload["declination_applied"] and self._gps.time_ns.size:
                # the heading is magnetic, and the instrument stated no declination
                payload["magnetic_declination"] = self._gps.declination_deg(time_ns)
            yield time_ns, topic, PING, payload


def _bottom_track(profiles: RawProfiles, k: int) -> dict[str, Any] | None:
    """Return the bottom's velocity relative to the instrument, in the ping's coordinates, and its distance by beam."""
    if profiles.bottom is None or not np.isfinite(profiles.bottom[0][k]).any():
        return None
    velocity, distance = (numbers(np.round(values[k], 4)) for values in profiles.bottom)
    return {"velocity": velocity, "velocity_std": None, "distance": distance}
