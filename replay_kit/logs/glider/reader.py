"""Reader of glider files: fixes, positions, mean currents and ADCP pings of any known dialect as messages."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.message import NO_MEANS, Loss, Message
from replay_kit.core.observation import Fix
from replay_kit.core.text import count_text
from replay_kit.logs.glider.adcp import INVERTED
from replay_kit.logs.glider.columns import Columns, joined, read_columns
from replay_kit.logs.glider.currents import DiveMean, mean_currents
from replay_kit.logs.glider.dialects import Dialect
from replay_kit.logs.glider.files import GliderFile, open_glider_file, surface_kind
from replay_kit.logs.glider.instruments import (
    PROFILES,
    absolute_profiles,
    fixes_of,
    instrument_entries,
)
from replay_kit.logs.glider.missions import mission_of
from replay_kit.logs.glider.rows import NetcdfRows, refuse_forecast
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.payloads import (
    FIX,
    by_variable,
    gather,
    location_fix,
    number,
    stamp,
)

_NS = 1_000_000_000
_DECIMATED_NS = 60 * _NS
# m; samples of one time that lie farther apart have no depth of their own
_ONE_DEPTH = 5.0
_DAC = "replay_kit.DepthAveragedCurrent"


class GliderReader(LogFile):
    """The files of one dialect that are one log, read whole: a mission has some ten thousand samples."""

    def __init__(
        self,
        files: Sequence[GliderFile],
        input: int = 0,
        config: LogConfig | None = None,
        losses: Sequence[Loss] = (),
        notes: Sequence[str] = (),
    ) -> None:
        """Read the files.

        Args:
            files: The log's files, all of one dialect, in order of time; the log is named after the first.
            input: Position of the log among the run's inputs.
            config: How logs are read.
            losses: Damage found while the files were opened.
            notes: What was assumed then.

        Raises:
            LogError: A variable has a unit that is not understood.
        """
        super().__init__(files[0].content.path, input, config)
        self._dialect = files[0].dialect
        self.format = self._dialect.name
        self._losses = tuple(losses)
        self.files = tuple(
            path for part in files for path in part.content.sources or (part.content.path,)
        )
        notes = list(notes)
        if len(self.files) > 1:
            notes.insert(0, f"{self._dialect.title}: {len(self.files)} files are one log")
        if left_out := sum(part.content.attributes.get("lines_left_out", 0) for part in files):
            notes.append(
                f"{count_text(left_out, 'line')} with fewer or more columns than the heading, not used"
            )
        self.mission = _one_mission(files, notes)
        self._columns = joined([read_columns(part.content, self._dialect, notes) for part in files])
        self._fixes, self._lost_fixes = fixes_of(self._columns, notes)
        self._means = mean_currents(self._columns, self._fixes, self._dialect.ascent_share, notes)
        pings = self._dialect.pings
        self._adcp = (
            []
            if pings is None
            else [entry for part in files for entry in pings(part.content, notes)]
        )
        self._adcp += absolute_profiles(self._columns, self._means.means, notes)
        if (
            not (self._means.means or self._adcp)
            and self._fixes.time_ns.size > 1
            and {
                "longitude",
                "depth",
            }
            <= set(self._columns.samples)
        ):
            notes.append(
                f"{NO_MEANS}none is stated; if the dead-reckoned positions include no current, "
                "--measurements.dead-reckoning through_water computes them"
            )
        self._notes = (*by_variable(_counted(notes)), *_heading_note(self._columns, self._dialect))
        self.statistics.notes = self._notes

    def messages(self) -> Iterator[Message]:
        """Yield the log's messages in order of time.

        ``/vehicle/fix``: GPS. ``/vehicle/position``: dead-reckoned or interpolated, with the depth, once a minute. ``/adcp``: velocity
        relative to the glider. ``/ctd``, ``/vehicle/altimeter``, ``/vehicle/battery``, ``/vehicle/waypoint``: as
        ``instrument_entries``. ``/adcp/inverted``, ``/adcp/absolute``: absolute profiles. ``/dac``: the mean current of each dive, at the
        fix after it.
        """
        self.statistics = ReadStatistics()
        self.statistics.notes = self._notes
        for loss in self._losses:
            self.statistics.lose(loss.what, loss.offset, loss.bytes)
        for topic, reason, count in self._columns.skipped:
            self._skip(topic, reason, count)
        self._skip(
            "/vehicle/fix",
            "GPS fix without time or position",
            max(self._lost_fixes - self._flagged("/vehicle/fix"), 0),
        )
        for reason, count in self._means.skipped:
            self._skip("/dac", reason, count)
        # at one time a position comes before the velocities measured there
        yield from self._by_time(
            [*self._fixes.entries(), *self._positions(), *self._dacs(), *self._adcp],
            *instrument_entries(self._columns.samples),
        )

    def is_gliders(self) -> bool:
        """Return True."""
        return True

    def _flagged(self, topic: str) -> int:
        return sum(count for at, _, count in self._columns.skipped if at == topic)

    def _dacs(self) -> Iterator[Entry]:
        # an inversion weighs the mean current against the pings; profiles that were only shifted to it hold nothing else of it
        found = {topic for _, topic, _, _ in self._adcp}
        named = (
            {"also_in": PROFILES}
            if PROFILES in found
            else {"inverted_in": INVERTED}
            if INVERTED in found
            else {}
        )
        for mean in self._means.means:
            yield mean.end.time_ns, "/dac", _DAC, _dac(mean, self._dialect.dac_kind) | named

    def _positions(self) -> Iterator[Entry]:
        """Yield the track, one position a minute; the first and the deepest sample are treated like the others."""
        samples = self._columns.samples
        for middle, depth in (
            (mean.middle, mean.max_depth) for mean in self._means.means if mean.middle is not None
        ):
            fix = location_fix(
                middle.time_ns, middle.longitude, middle.latitude, depth, True, math.nan
            )
            yield middle.time_ns, "/vehicle/position", FIX, fix
        if not {"longitude", "latitude"} <= set(samples):
            return
        depth = _depth_at_times(samples)
        usable = np.isfinite(samples["longitude"] + samples["latitude"]) & ~np.isin(
            samples["time"], self._fixes.time_ns
        )
        usable &= np.isfinite(depth) if self.format == "seaglider" else True
        if self._dialect.raw and self._fixes.time_ns.size:
            usable &= samples["time"] >= self._fixes.time_ns[0]
        due = -_DECIMATED_NS
        angles = [
            name
            for name in ("heading", "pitch", "roll")
            if name in samples and self.format != "seaglider"
        ]
        for k in np.flatnonzero(usable).tolist():
            time_ns = int(samples["time"][k])
            if time_ns >= due:
                due = time_ns + _DECIMATED_NS
                fix = location_fix(
                    time_ns,
                    samples["longitude"][k],
                    samples["latitude"][k],
                    depth[k],
                    True,
                    math.nan,
                )
                fix["metadata"] += [
                    {"key": name, "value": f"{value:.2f}"}
                    for name in angles
                    if math.isfinite(value := samples[name][k])
                ]
                yield time_ns, "/vehicle/position", FIX, fix


def _depth_at_times(samples: Mapping[str, Any]) -> Any:
    """Return the samples' depths [m], NaN where samples at other depths have the same time."""
    if "depth" not in samples:
        return np.full(samples["time"].size, np.nan)
    depth = np.array(samples["depth"], np.float64)
    _, of_time = np.unique(samples["time"], return_inverse=True)
    least, most = np.full((2, of_time.max(initial=-1) + 1), [[np.inf], [-np.inf]])
    np.fmin.at(least, of_time, depth)
    np.fmax.at(most, of_time, depth)
    return np.where((most - least)[of_time] > _ONE_DEPTH, np.nan, depth)


def _dac(mean: DiveMean, kind: str) -> dict[str, Any]:
    return {
        "stamp": stamp(mean.end.time_ns),
        **({} if mean.dive is None else {"dive": mean.dive}),
        "dac_eastward": number(mean.east),
        "dac_northward": number(mean.north),
        "error": number(mean.error),
        "start_fix": _end(mean.start),
        "end_fix": _end(mean.end),
        "duration": (mean.end.time_ns - mean.start.time_ns) / _NS,
        "max_depth": number(mean.max_depth),
        "radius": number(mean.radius),
        "dac_kind": kind,
    }


def _end(end: Fix) -> dict[str, Any]:
    return {"time": stamp(end.time_ns), "lon": end.longitude, "lat": end.latitude}


def _one_mission(files: Sequence[GliderFile], notes: list[str]) -> str:
    """Return the mission that all files are of; empty when they state none, or several, which is noted."""
    names = list(
        dict.fromkeys(
            name for part in files for name in mission_of(part.content, part.dialect.name)
        )
    )
    if len(names) > 1:
        shown = f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"
        notes.append(
            f"{len(names)} missions in one log ({shown}): their dives are merged as if one glider had made them"
        )
    return names[0] if len(names) == 1 else ""


def _counted(notes: Sequence[str]) -> Iterator[str]:
    """Yield each note once; those that several files give say how many."""
    for note, found in gather(notes).items():
        yield note if len(found) == 1 else f"{note} (in {len(found)} files)"


def _heading_note(columns: Columns, dialect: Dialect) -> Iterator[str]:
    if "heading" in columns.samples:
        how = (
            "whether headings are magnetic or true is not known"
            if dialect.heading == "unknown"
            else f"headings are {dialect.heading}"
        )
        yield f"{how}; no declination was added to them"


def open_glider(
    paths: Sequence[Path],
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
) -> LogFile:
    """Return the reader of the glider files that are one log; also of currents by radar, drifters and pings in NetCDF.

    Args:
        paths: The files.
        input: Position of the log among the run's inputs.
        config: How logs are read.
        wanted: Without effect.

    Raises:
        LogError: A file cannot be read, or is of no known dialect.
    """
    for path in paths:
        refuse_forecast(path)
    files = [file for path in paths if (file := open_glider_file(path)) is not None]
    if files:
        return GliderReader(files, input, config)
    kind = surface_kind(paths[0])
    if kind == "drifters":
        from replay_kit.logs.surface.drifters import DrifterReader

        return DrifterReader(paths, input, config)
    if kind:
        from replay_kit.logs.surface.totals import TotalsReader

        return TotalsReader(paths, input, config)
    from replay_kit.logs.table import TableReader, holds_pings

    if holds_pings(paths[0], config.columns if config else {}):
        return TableReader(paths, input, config)
    return NetcdfRows(paths, input, config, wanted)
