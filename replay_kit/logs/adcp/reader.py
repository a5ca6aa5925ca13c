"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds in other logs.

Records are found and checked here and decoded by MHKiT. Velocities stay in the file's coordinates, relative to the platform, with attitude,
beam geometry and bottom track in the message; ``measurements`` makes them absolute.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.adcp.bottom_track import bottom_tracks, with_bottom
from replay_kit.logs.adcp.frames import AD2CP_MAGICS, PD0_MAGIC, lose_between, scan
from replay_kit.logs.adcp.library import BURST, NO_ENSEMBLE, modes_of, read_mode, read_pd0
from replay_kit.logs.adcp.pd0 import by_configuration
from replay_kit.logs.adcp.profiles import RawProfiles, raw_profiles
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import PING, Positions, numbers, stamp

_SECOND_NS = 1_000_000_000
_HALF_DAY_NS = 43_200 * _SECOND_NS


@dataclass(frozen=True, slots=True, eq=False)
class Fixes(Positions):
    """Fixes of a vessel.

    Attributes:
        offset_ns: UTC minus the instrument's clock [ns]; None without fixes.
        n_bad: Number of GPS records without a fix.
    """

    offset_ns: int | None
    n_bad: int

    def declination_deg(self, time_ns: int) -> float | None:
        """Return the magnetic declination at the first fix from a time on, or at the last; None without fixes or before 2010."""
        if not self.time_ns.size:
            return None
        near = min(int(np.searchsorted(self.time_ns, time_ns)), self.time_ns.size - 1)
        return declination_deg(time_ns, float(self.longitude[near]), float(self.latitude[near]))


def fixes_of(datasets: Sequence[Any]) -> Fixes:
    """Return the fixes in the MHKiT datasets (xarray) of one file, in any order."""
    found = [
        _raw_fixes(dataset)
        for dataset in datasets
        if "time_gps" in dataset and "latitude_gps" in dataset
    ]
    if not found:
        none = np.zeros(0)
        return Fixes(none.astype(np.int64), none, none, none, None, 0)
    gps_ns, instrument_ns, longitude, latitude, good = (
        np.concatenate(parts) for parts in zip(*found, strict=True)
    )
    n_bad = int(good.size - good.sum())
    gps_ns, instrument_ns, longitude, latitude = (
        values[good] for values in (gps_ns, instrument_ns, longitude, latitude)
    )
    dated = any(dataset.attrs.get("source_program") == "VMDAS" for dataset in datasets)
    offset_ns = clock_offset_ns(gps_ns, instrument_ns, dated) if good.any() else None
    if offset_ns is not None and not dated:
        # of several whole days the one that the offset means
        gps_ns = (
            gps_ns
            - np.round((gps_ns - instrument_ns - offset_ns) / (2 * _HALF_DAY_NS)).astype(np.int64)
            * 2
            * _HALF_DAY_NS
        )
    time_ns, first = np.unique(gps_ns, return_index=True)
    unknown = np.full(time_ns.size, np.nan)
    return Fixes(time_ns, longitude[first], latitude[first], unknown, offset_ns, n_bad)


def _raw_fixes(dataset: Any) -> tuple[NDArray[Any], ...]:
    """Return GPS time and instrument's clock [ns], longitude, latitude, and validity of each fix, shape (n,) each."""
    gps, instrument = (
        dataset[name].values.astype("datetime64[us]").astype(np.int64)
        for name in ("time_gps", "hdwtime_gps")
    )
    longitude, latitude = (
        np.asarray(dataset[f"{name}_gps"].values, dtype=np.float64)
        for name in ("longitude", "latitude")
    )
    good = np.isfinite(longitude + latitude) & ((longitude != 0.0) | (latitude != 0.0))
    if "fix_gps" in dataset:
        good &= dataset["fix_gps"].values > 0
    # to the millisecond: MHKiT carries seconds as floats
    gps_ns, instrument_ns = (
        np.round(values / 1000).astype(np.int64) * 1_000_000 for values in (gps, instrument)
    )
    return gps_ns, instrument_ns, longitude, latitude, good


def clock_offset_ns(
    gps_ns: NDArray[np.int64], instrument_ns: NDArray[np.int64], dated: bool
) -> int:
    """Return UTC minus the instrument's clock [ns], the median over the fixes.

    Args:
        gps_ns: shape (n,), GPS time of each fix.
        instrument_ns: shape (n,), the instrument's clock at each fix.
        dated: Whether the GPS time has its own date; otherwise the offset is known modulo a day and the one within half a day is returned.
    """
    difference = gps_ns - instrument_ns
    if not dated:
        difference = (difference + _HALF_DAY_NS) % (2 * _HALF_DAY_NS) - _HALF_DAY_NS
    return int(np.median(difference))


def declination_deg(time_ns: int, longitude: float, latitude: float) -> float | None:
    """Return the magnetic declination [degrees, positive east] by the World Magnetic Model of the time; None before 2010.

    Positions are rounded to 0.1 degree and times to 0.1 year, below the resolution of a compass.
    """
    year = datetime.fromtimestamp(time_ns // _SECOND_NS, UTC)
    return _declination(
        round(year.year + (year.timetuple().tm_yday - 1) / 366.0, 1),
        round(longitude, 1),
        round(latitude, 1),
    )


@lru_cache(maxsize=1024)
def _declination(year: float, longitude: float, latitude: float) -> float | None:
    from pygeomag import GeoMag

    # models of five years each: the first that covers the year; none does before 2010
    for file in ("WMM_2010", "WMM_2015v2", "WMM_2020", "WMM_2025"):
        model = GeoMag(coefficients_file=f"wmm/{file}.COF")
        low, high = model.life_span
        if low <= year <= high:
            return round(
                float(model.calculate(glat=latitude, glon=longitude, alt=0.0, time=year).d), 2
            )
    return None


_PINGS, _AVERAGES = "/adcp", "/adcp/average"
# kind of a PD0 ensemble, and names of other packets
_ENSEMBLE, _KNOWN = 0, {0x79: ", waves"}
#: Topic, number of pings that the file holds, and what was read of them.
Stream = tuple[str, int, RawProfiles]
_UNTURNED = "bottom track in coordinates that cannot be turned to those of the pings"


class RawAdcpReader(LogFile):
    """Reader of a raw ADCP file, read whole; the instrument's clock is corrected by GPS fixes in the file."""

    def _prepare(self) -> None:
        """Read the file.

        Raises:
            LogError: The file cannot be read, has no valid ensemble, or MHKiT is not installed or cannot read it.
        """
        with self._opened() as file:
            data = file.read()
        self.format = "ad2cp" if data[:2] in AD2CP_MAGICS else "pd0"
        self._size = len(data)
        self._records = scan(data)
        self._unreadable: Counter[tuple[str, str]] = Counter()
        self._notes: tuple[str, ...] = ()
        self._no_bottom: Counter[str] = Counter()
        try:
            self._gps, self._profiles = (self._pd0 if self.format == "pd0" else self._ad2cp)(data)
        except (LookupError, ValueError, TypeError) as error:
            raise LogError(
                f"{self.path}: unknown setting of an instrument: {type(error).__name__}: {error}"
            ) from error

    def _pd0(self, data: bytes) -> tuple[Fixes, list[Stream]]:
        """Return the fixes and the profiles of each configuration."""
        path, kinds = Path(self.path), Counter(record.kind for record in self._records)
        ensembles = [record for record in self._records if record.kind == _ENSEMBLE]
        found = by_configuration(data, ensembles)
        if not found.parts:
            why = "; ".join(f"{count} x {reason}" for reason, count in found.unreadable.items())
            raise LogError(f"{path}: {f'no ensemble can be read: {why}' if why else NO_ENSEMBLE}")
        self._unreadable += Counter(
            {(_PINGS, reason): count for reason, count in found.unreadable.items()}
        )
        others = [
            f"{count} packets of another kind ({PD0_MAGIC[0]:02X} {kind:02X}{_KNOWN.get(kind, '')}), skipped"
            for kind, count in sorted(kinds.items())
            if kind != _ENSEMBLE
        ]
        self._notes = (*found.notes, *others)
        datasets = [
            read_pd0(path, [found.parts[k] for k in group], key.has_pressure)
            for key, group in found.groups.items()
        ]
        if not any("vel" in dataset for dataset in datasets):
            self._notes += (
                "bottom track and fixes alone: the file holds no profile of the current",
            )
        pairs = zip(datasets, found.groups.values(), strict=True)
        return fixes_of(datasets), [
            (_PINGS, len(group), raw_profiles(dataset, "", group)) for dataset, group in pairs
        ]

    def _ad2cp(self, data: bytes) -> tuple[Fixes, list[Stream]]:
        """Return empty fixes, and the profiles of each mode and configuration with bottom tracks as streams."""
        tracks, self._no_bottom = bottom_tracks(data, self._records)
        found: list[Stream] = []
        names, said, errors = Counter[str](), [], list[Exception]()
        for mode in modes_of(Path(self.path), data, self._records):
            topic = _PINGS if mode.kind == BURST else _AVERAGES
            names[topic] += 1
            topic = topic if names[topic] == 1 else f"{topic}/{names[topic]}"
            try:
                dataset = read_mode(Path(self.path), mode)
                # of one mode alone MHKiT may leave the name of an average out
                tag = "" if "vel" in dataset else "_avg"
                profiles = with_bottom(raw_profiles(dataset, tag, mode.ordinals), tracks)
            except (LogError, LookupError, ValueError, TypeError) as error:
                errors.append(error)
                why = str(error).removeprefix(f"{self.path}: ")
                self._unreadable[topic, f"configuration that cannot be read: {why}"] += len(
                    mode.pings
                )
                continue
            found.append((topic, len(mode.pings), profiles))
            cells, size = (profiles.common[name] for name in ("n_cells", "cell_size"))
            said.append(f"{topic} ({len(mode.pings)} pings of {cells} cells of {size:g} m)")
        if not found:
            raise errors[0]
        if len(said) > 1:
            self._notes = (
                f"{len(said)} configurations, each a stream of pings: {', '.join(said)}",
            )
        if tracks and all(profiles.bottom is None for *_, profiles in found):
            self._no_bottom[_UNTURNED] = sum(track.time_ns.size for track in tracks.values())
        return fixes_of([]), found

    def messages(self) -> Iterator[Message]:
        """Yield the messages in order of time.

        ``/vehicle/fix``: the vessel's GPS. ``/adcp``: velocities relative to the platform; ``/adcp/average``: Nortek's averaging mode.
        Further configurations of a Nortek are on ``/adcp/2`` and so on.
        """
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        lose_between(self.statistics, self._records, self._size)
        missing: Counter[str] = Counter()
        for topic, expected, profiles in self._profiles:
            missing[topic] += expected - int(profiles.known.sum())
        for topic, count in missing.items():
            self._skip(topic, "ping that MHKiT leaves out or gives no time", max(count, 0))
        for (topic, reason), count in self._unreadable.items():
            self._skip(topic, reason, count)
        self._skip("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)", self._gps.n_bad)
        for reason, count in self._no_bottom.items():
            self._skip("/adcp/bottom_track", reason, count)
        # at one time a position comes before the velocities measured there
        yield from self._by_time(
            chain(
                self._gps.entries(),
                *(self._pings(topic, profiles) for topic, _, profiles in self._profiles),
            )
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
                "clock_offset": None if offset_ns is None else offset_ns / _SECOND_NS,
                "bottom_track": _bottom_track(profiles, k),
            }
            if not payload["declination_applied"] and self._gps.time_ns.size:
                # the heading is magnetic, and the instrument stated no declination
                payload["magnetic_declination"] = self._gps.declination_deg(time_ns)
            yield time_ns, topic, PING, payload


def _bottom_track(profiles: RawProfiles, k: int) -> dict[str, Any] | None:
    """Return the bottom velocity relative to the instrument, in the ping's coordinates, and its distance by beam."""
    if profiles.bottom is None or not np.isfinite(profiles.bottom[0][k]).any():
        return None
    velocity, distance = (numbers(np.round(values[k], 4)) for values in profiles.bottom)
    return {"velocity": velocity, "velocity_std": None, "distance": distance}
