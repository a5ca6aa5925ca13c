"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds that other logs hold.

The records are found and checked here, decoded by MHKiT. Velocities stay in the file's own coordinates, relative to the platform,
with attitude, beam geometry, bottom track and the vessel's velocity by GPS in the same message: ``measurements`` rotates them.
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
from replay_kit.core.vessel import Track, vessel_velocity
from replay_kit.logs.adcp.dolfyn import read_datasets
from replay_kit.logs.adcp.gps import clock_offset_ns, declination_deg
from replay_kit.logs.adcp.profiles import RawProfiles, raw_profiles
from replay_kit.logs.adcp.records import PD0_MAGIC, lose_between, scan
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.payloads import FIX, PING, location_fix, number, numbers, stamp
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
            self._track, self._offset_ns, self._bad_fixes = _track(datasets[0])
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
        self._skip("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)", self._bad_fixes)
        self._skip("/adcp/bottom_track", "bottom track of AD2CP files is not read", 0 if self.format == "pd0" else kinds[_BOTTOM_TRACK])
        # at one time a position comes before the velocities measured there
        yield from self._by_time(chain(self._fixes(), *(self._pings(_TOPICS[tag], profiles) for tag, profiles in self._profiles.items())))

    def _fixes(self) -> Iterator[Entry]:
        track = self._track
        for time_ns, longitude, latitude in zip(track.time_ns.tolist(), track.longitude.tolist(), track.latitude.tolist(), strict=True):
            yield time_ns, "/vehicle/fix", FIX, location_fix(time_ns, longitude, latitude, 0.0, False, float("nan"))

    def _pings(self, topic: str, profiles: RawProfiles) -> Iterator[Entry]:
        known = np.flatnonzero(profiles.known)
        time_ns = profiles.time_ns + (self._offset_ns or 0)
        vessel, vessel_std = vessel_velocity(time_ns, self._track)
        per_ping = {name: numbers(np.round(values, 6)) for name, values in profiles.per_ping.items()}
        for k in known.tolist():
            time = int(time_ns[k])
            payload = {
                "stamp": stamp(time),
                "frame_id": "adcp",
                "ping": k,
                **profiles.common,
                "velocity_std": None,
                **{name: values[k] for name, values in per_ping.items()},
                "clock_offset": None if self._offset_ns is None else self._offset_ns / _NS,
                "bottom_track": _bottom_track(profiles, k),
                "platform_velocity": _platform_velocity(vessel[k], vessel_std[k]),
            }
            yield time, topic, PING, payload | self._declination(time, payload)

    def _declination(self, time_ns: int, payload: dict[str, Any]) -> dict[str, Any]:
        """Return the declination at the ping's place, for a magnetic heading without a stated declination."""
        if payload["declination_applied"] or not self._track.time_ns.size:
            return {}
        near = min(int(np.searchsorted(self._track.time_ns, time_ns)), self._track.time_ns.size - 1)
        return {"magnetic_declination": declination_deg(time_ns, float(self._track.longitude[near]), float(self._track.latitude[near]))}


def _track(dataset: Any) -> tuple[Track, int | None, int]:
    """Return the fixes by UTC, the instrument's clock's offset [ns] (None without fixes), and how many fixes are none."""
    if "time_gps" not in dataset or "latitude_gps" not in dataset:
        none = np.zeros(0)
        return Track(none.astype(np.int64), none, none), None, 0
    gps, instrument = (dataset[name].values.astype("datetime64[us]").astype(np.int64) for name in ("time_gps", "hdwtime_gps"))
    longitude, latitude = (np.asarray(dataset[f"{name}_gps"].values, dtype=np.float64) for name in ("longitude", "latitude"))
    good = np.isfinite(longitude + latitude) & ((longitude != 0.0) | (latitude != 0.0))
    if "fix_gps" in dataset:
        good &= dataset["fix_gps"].values > 0
    if not good.any():
        return Track(np.zeros(0, np.int64), longitude[good], latitude[good]), None, int(good.size)
    # to the millisecond: MHKiT carries seconds as floats
    gps_ns, instrument_ns = (np.round(values[good] / 1000).astype(np.int64) * 1_000_000 for values in (gps, instrument))
    dated = dataset.attrs.get("source_program") == "VMDAS"
    offset_ns = clock_offset_ns(gps_ns, instrument_ns, dated)
    if not dated:
        # of several whole days the one that the offset means
        gps_ns = gps_ns - np.round((gps_ns - instrument_ns - offset_ns) / (86_400 * _NS)).astype(np.int64) * 86_400 * _NS
    time_ns, first = np.unique(gps_ns, return_index=True)
    return Track(time_ns, longitude[good][first], latitude[good][first]), offset_ns, int(good.size - good.sum())


def _bottom_track(profiles: RawProfiles, k: int) -> dict[str, Any] | None:
    """Return the bottom's velocity relative to the instrument, in the ping's coordinates, and its distance by beam."""
    if profiles.bottom is None or not np.isfinite(profiles.bottom[0][k]).any():
        return None
    velocity, distance = (numbers(np.round(values[k], 4)) for values in profiles.bottom)
    return {"velocity": velocity, "velocity_std": None, "distance": distance}


def _platform_velocity(velocity: Any, std: float) -> dict[str, Any] | None:
    if not np.isfinite(std):
        return None
    east, north = (number(round(float(component), 4)) for component in velocity)
    return {"east": east, "north": north, "velocity_std": round(float(std), 4), "source": "gps"}
