"""Raw Teledyne (PD0, VMDAS, WinRiver) and Nortek (AD2CP) files as messages of the kinds in other logs.

Records are found and checked here and decoded by MHKiT. Velocities stay in the file's coordinates, relative to the platform, with attitude,
beam geometry and bottom track in the message; ``measurements`` makes them absolute.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.adcp.bottom_track import bottom_tracks, with_bottom
from replay_kit.logs.adcp.frames import AD2CP_MAGICS, PD0_MAGIC, lose_between, scan
from replay_kit.logs.adcp.gps import Fixes, fixes_of
from replay_kit.logs.adcp.library import BURST, NO_ENSEMBLE, modes_of, read_mode, read_pd0
from replay_kit.logs.adcp.pd0 import by_configuration
from replay_kit.logs.adcp.profiles import RawProfiles, raw_profiles
from replay_kit.logs.blocks import ReadStatistics
from replay_kit.logs.payloads import PING, Entry, entries, fix_entries, numbers
from replay_kit.logs.reader import LogFile

_SECOND_NS = 1_000_000_000
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
        self._size, self._records = len(data), scan(data)
        #: Messages that are not there, by topic and reason.
        self._skipped: Counter[tuple[str, str]] = Counter()
        self._notes: tuple[str, ...] = ()
        try:
            self._gps, self._profiles = (self._pd0 if self.format == "pd0" else self._ad2cp)(data)
        except (LookupError, ValueError, TypeError) as error:
            raise LogError(
                f"{self.path}: unknown setting of an instrument: {type(error).__name__}: {error}"
            ) from error
        missing: Counter[str] = Counter()
        for topic, expected, profiles in self._profiles:
            missing[topic] += expected - int(profiles.known.sum())
        left_out = "ping that MHKiT leaves out or gives no time"
        first = {(topic, left_out): max(count, 0) for topic, count in missing.items()}
        bad = {("/vehicle/fix", "not a GPS fix (quality 0, or 0 N 0 E)"): self._gps.n_bad}
        self._skipped = Counter({**first, **self._skipped, **bad})

    def _pd0(self, data: bytes) -> tuple[Fixes, list[Stream]]:
        """Return the fixes and the profiles of each configuration."""
        path, kinds = Path(self.path), Counter(record.kind for record in self._records)
        ensembles = [record for record in self._records if record.kind == _ENSEMBLE]
        found = by_configuration(data, ensembles)
        if not found.parts:
            why = "; ".join(f"{count} x {reason}" for reason, count in found.unreadable.items())
            raise LogError(f"{path}: {f'no ensemble can be read: {why}' if why else NO_ENSEMBLE}")
        self._skipped.update({(_PINGS, why): n for why, n in found.unreadable.items()})
        others = [
            f"{count} packets of another kind ({PD0_MAGIC[0]:02X} {kind:02X}{_KNOWN.get(kind, '')}), skipped"
            for kind, count in sorted(kinds.items())
            if kind != _ENSEMBLE
        ]
        self._notes = (*found.notes, *others)
        datasets = [
            read_pd0(path, [found.parts[k] for k in group], has_pressure)
            for (_, has_pressure), group in found.groups.items()
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
        tracks, no_bottom = bottom_tracks(data, self._records)
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
                unread = f"configuration that cannot be read: {why}"
                self._skipped[topic, unread] += len(mode.pings)
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
            no_bottom[_UNTURNED] = sum(track.time_ns.size for track in tracks.values())
        self._skipped.update({("/adcp/bottom_track", why): n for why, n in no_bottom.items()})
        return fixes_of([]), found

    def messages(self) -> Iterator[Message]:
        """Yield the messages in order of time.

        ``/vehicle/fix``: the vessel's GPS. ``/adcp``: velocities relative to the platform; ``/adcp/average``: Nortek's averaging mode.
        Further configurations of a Nortek are on ``/adcp/2`` and so on.
        """
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        lose_between(self.statistics, self._records, self._size)
        for (topic, reason), count in self._skipped.items():
            self._skip(topic, reason, count)
        # at one time a position comes before the velocities measured there
        yield from self._by_time(
            chain(
                fix_entries(self._gps.columns),
                *(self._pings(topic, profiles) for topic, _, profiles in self._profiles),
            )
        )

    def _pings(self, topic: str, profiles: RawProfiles) -> Iterator[Entry]:
        offset_ns = self._gps.offset_ns
        time_ns = profiles.time_ns + (offset_ns or 0)
        common = {
            "frame_id": "adcp",
            **profiles.common,
            "clock_offset": None if offset_ns is None else offset_ns / _SECOND_NS,
        }
        columns: dict[str, NDArray[Any]] = {
            name: np.round(values, 6) for name, values in profiles.per_ping.items()
        }
        columns |= {"ping": profiles.ordinals, "bottom_track": _bottom_tracks(profiles)}
        if not common["declination_applied"] and offset_ns is not None:
            # the heading is magnetic, and the instrument stated no declination
            found = map(self._gps.declination, time_ns.tolist())
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
