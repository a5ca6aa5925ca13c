"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds that other logs hold.

The records are found and checked here, decoded by MHKiT. Velocities stay in the file's own coordinates, relative to the platform,
with attitude, beam geometry and bottom track in the same message: ``measurements`` rotates them and makes them absolute.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.adcp.dolfyn import read_datasets
from replay_kit.logs.adcp.gps import fixes_of
from replay_kit.logs.adcp.profiles import RawProfiles, raw_profiles
from replay_kit.logs.adcp.records import PD0_MAGIC, lose_between, scan
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.payloads import FIX, PING, location_fix, numbers, stamp
from replay_kit.logs.shared.statistics import ReadStatistics

_NS = 1_000_000_000
_TOPICS = {"": "/adcp", "_avg": "/adcp/average"}
_BURST_PING, _AVERAGE_PING, _BOTTOM_TRACK = 0x15, 0x16, 0x17


class RawAdcpReader(LogFile):
    """A raw ADCP file, read whole. An instrument has one clock, set right by GPS where the file has fixes."""

    def __init__(self, path: Path, input: int = 0, config: LogConfig | None = None, wanted: frozenset[str] | None = None) -> None:
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
        datasets = read_datasets(path, data, self._records)
        try:
            self._gps = fixes_of(datasets[0])
            self._profiles = {tag: raw_profiles(ds, tag) for ds in datasets for tag in _TOPICS if f"vel{tag}" in ds}
        except (LookupError, ValueError, TypeError) as error:
            raise LogError(f"{path}: not a setting of an instrument that is understood: {type(error).__name__}: {error}") from error
        if not self._profiles:
            raise LogError(f"{path}: it has no profile of velocities; give a file of a current profiler")

    def messages(self) -> Iterator[Message]:
        """Yield the messages in order of time.

        ``/vehicle/fix``: the vessel's GPS. ``/adcp``: velocities relative to the platform; ``/adcp/average``: those of a Nortek's
        averaging mode, where it has both.
        """
        self.statistics = ReadStatistics()
        lose_between(self.statistics, self._records, self._size)
        kinds = Counter(record.kind for record in self._records)
        pings = {"": 0 if self.format == "pd0" else _BURST_PING, "_avg": _AVERAGE_PING}
        for tag, profiles in self._profiles.items():
            missing = max(kinds[pings[tag]] - int(profiles.known.sum()), 0)
            self._skip(_TOPICS[tag], "ping that MHKiT leaves out or gives no time", missing)
        self._skip("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)", self._gps.n_bad)
        self._skip("/adcp/bottom_track", "bottom track of AD2CP files is not read", 0 if self.format == "pd0" else kinds[_BOTTOM_TRACK])
        # at one time a position comes before the velocities measured there
        yield from self._by_time(chain(self._fixes(), *(self._pings(_TOPICS[tag], profiles) for tag, profiles in self._profiles.items())))

    def _fixes(self) -> Iterator[Entry]:
        columns = (self._gps.time_ns, self._gps.longitude, self._gps.latitude)
        for time_ns, longitude, latitude in zip(*(column.tolist() for column in columns), strict=True):
            yield time_ns, "/vehicle/fix", FIX, location_fix(time_ns, longitude, latitude, 0.0, False, float("nan"))

    def _pings(self, topic: str, profiles: RawProfiles) -> Iterator[Entry]:
        offset_ns = self._gps.offset_ns
        per_ping = {name: numbers(np.round(values, 6)) for name, values in profiles.per_ping.items()}
        for k in np.flatnonzero(profiles.known).tolist():
            time_ns = int(profiles.time_ns[k]) + (offset_ns or 0)
            payload = {
                "stamp": stamp(time_ns),
                "frame_id": "adcp",
                "ping": k,
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
