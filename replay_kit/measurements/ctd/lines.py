"""Dives along a line to measurements of the geostrophic shear across it, as soon as the line is long enough: online as afterwards.

Windows of a line have no profile in common, so that no dive counts twice; the statistics of waves are those of the window and of the one
before it. The shear is relative to an unknown current: the mean over its depths is left to mean currents of dives, whose errors are
others'.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Flag, Label, LinearMeasurement, Source
from replay_kit.core.table import Columns, Integers, Table
from replay_kit.measurements.ctd.casts import (
    LAG,
    Cast,
    fault_of_units,
    has_lag,
    is_fouled,
    without_spikes,
)
from replay_kit.measurements.ctd.sections import Profile, Section, section_of
from replay_kit.measurements.ctd.thermal_wind import (
    EQUATOR,
    GeostrophicShear,
    fitted_line,
    radius_of,
    window_shear,
)
from replay_kit.measurements.dives import Depths, depth_of
from replay_kit.measurements.ledger import Ledger, left_out_reason
from replay_kit.measurements.means import Spot, spot
from replay_kit.measurements.pings import Way
from replay_kit.measurements.positions import as_of, beside, chosen, joined

#: Rossby radii: a line as long is complete, and one shorter tells less than an ensemble knows.
COMPLETE, LEAST = 1.0, 0.3
_LEAST_PROFILES = 4
# Levels at which the shear is stated.
_STATED = 12

_NEAR_EQUATOR = f"within {EQUATOR:g} degrees of the equator there is no geostrophic balance"
_NO_LINE = "profiles along no straight line of 0.3 Rossby radii"
_NO_LEG = "no leg of 40 m with temperature and salinity"
_MIXED = "mixed water: without stratification there are no internal waves to fit, and no shear"
_FOULED = "deep salinity drifts along the line: it looks like a fouled cell"
# ns; a vehicle that has sent no sample for so long has surfaced, whether or not its log says so
_LONGEST_NS = 3 * 3600 * 10**9
_INCOMPLETE = "sample without depth, temperature, or salinity"
_AT_SURFACE, _NO_POSITION = "sample at the surface", "sample before the first position"
# m/s; of currents where nothing else is known
_SPEED = 0.2
_CTD = ("temperature", "salinity", "conductivity", "pressure")
_NEVER = np.iinfo(np.int64).max
_NONE = dict.fromkeys(("order", "time"), np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class SectionLine:
    """What is remembered of a CTD.

    Attributes:
        cast: The samples since the last surfacing.
        profiles: Of the line so far, that are in no window.
        earlier: Of the window before, if the line goes on from it.
        undecided: Number of messages of ``profiles``.
        source: Of the first of their messages; None without.
        lagging: Number of dives of ``profiles`` whose legs differ as a lagging cell makes them.
    """

    cast: Cast = field(default_factory=Cast)
    profiles: tuple[Profile, ...] = ()
    earlier: tuple[Profile, ...] = ()
    undecided: int = 0
    source: Source | None = None
    lagging: int = 0


def measurement(shear: GeostrophicShear, section: Section, label: Label) -> LinearMeasurement:
    """Return the shear as values at some of its levels, relative to an unknown current, of the component across the line.

    Args:
        shear: The shear.
        section: Of which it is.
        label: For statistics; its source has the time at which the shear was known.
    """
    at = np.unique(np.linspace(0, shear.levels.size - 1, _STATED).round().astype(np.int64))
    along = shear.along * np.array([np.cos(section.direction), np.sin(section.direction)])
    east, north = to_geographic(Projection(section.longitude, section.latitude), *along)
    std = shear.standard_error[at]
    return LinearMeasurement(
        label.source.time_ns,
        None,
        np.array([float(east)]),
        np.array([float(north)]),
        shear.levels[at],
        None,
        shear.velocity[at, None],
        std,
        np.full(at.size, Flag.GOOD, np.int8),
        np.zeros(at.size, np.int32),
        label,
        np.inf,
        components=np.array([[np.cos(shear.direction), np.sin(shear.direction)]]),
        correlation=shear.covariance[np.ix_(at, at)] / np.outer(std, std),
    )


def _section(profiles: tuple[Profile, ...]) -> Section | None:
    """Return profiles as a section; None where they make none."""
    try:
        return section_of(profiles)
    except MeasurementError:
        return None


class Sampled:
    """One way through the samples of a block."""

    def __init__(
        self,
        line: SectionLine | None,
        way: Way,
        depths: Depths,
        config: MeasurementConfig,
        ledger: Ledger,
    ) -> None:
        """Begin with what is remembered; ``line`` and ``found`` hold what is at the end."""
        self.line = line or SectionLine()
        self.way, self.depths, self.config, self.ledger = way, depths, config, ledger
        self.speed = config.regional_speed or _SPEED
        self.found: list[tuple[int, LinearMeasurement]] = []

    def take(self, tables: Sequence[Table], surfacings: Integers) -> None:
        """Take samples in.

        Args:
            tables: Of the samples.
            surfacings: Places in the stream of positions at the surface that messages of their own state.
        """
        samples = joined(*map(self._samples, tables)) if tables else _NONE
        samples = chosen(samples, np.argsort(samples["order"], kind="stable"))
        time, cuts = samples["time"], np.searchsorted(surfacings, samples["order"])
        late = np.diff(time, prepend=time[:1]) > _LONGEST_NS
        starts, upto = np.flatnonzero((np.diff(cuts, prepend=-1) > 0) | late), 0
        for part in np.split(np.arange(cuts.size), starts)[1:]:
            self._surfaced(surfacings[upto : cuts[part[0]]])
            self._sampled(chosen(samples, part))
            upto = cuts[part[0]]
        self._surfaced(surfacings[upto:])
        if self.way.last:
            self._after_dive(_NEVER, None)
            self._close(_NEVER)

    def _samples(self, table: Table) -> dict[str, NDArray[Any]]:
        """Return the samples of a table that count, and note the others.

        The columns are the place in the stream, the time, the position before, the message, and what ``Cast.after`` takes of each.
        """
        before = as_of(table.order, self.way.positions["order"])
        places = beside(self.way.positions, before)
        depth = table["depth"]
        depth = np.where(np.isfinite(depth), depth, depth_of(table["pressure"], places[2]))
        known = np.isfinite(table["salinity"]) | np.isfinite(table["conductivity"])
        why = np.full(len(table), "", object)
        why[before < 0] = _NO_POSITION
        why[depth < self.config.surface_depth] = _AT_SURFACE
        why[~(known & np.isfinite(depth + table["temperature"]))] = _INCOMPLETE
        if "shear" in self.config.without:
            why[:] = left_out_reason(("shear",))
        good = why == ""
        self.ledger.add(table.order[~good], table.topic, why[~good])
        columns = {
            "input": np.full(len(table), table.input),
            "topic": np.full(len(table), table.topic, object),
            "position": table.position,
            "time": table.time,
            "order": table.order,
            "before": before,
            "values": np.column_stack([*places[1:], depth, *(table[name] for name in _CTD)]),
        }
        return chosen(columns, good)

    def _fix(self, at: int) -> Spot | None:
        """Return one of the positions; None where it is dead-reckoned."""
        positions = self.way.positions
        return None if positions["dead_reckoned"][at] else spot(positions, at)

    def _sampled(self, samples: Columns) -> None:
        """Take in samples between which nothing ends the dive."""
        time, fix = samples["time"], self._fix(samples["before"][0])
        if time[0] > self.line.cast.last_ns + _LONGEST_NS:
            self._after_dive(int(samples["order"][0]), None)
        source = Source(*(samples[name].item(0) for name in list(samples)[:4]))
        cast = self.line.cast.after(source, fix, time, samples["values"])
        self.line = replace(self.line, cast=cast)

    def _surfaced(self, surfacings: Integers) -> None:
        """End the dive at the first of some positions at the surface."""
        for order in surfacings[:1]:
            self._after_dive(int(order), self._fix(int(as_of(order, self.way.positions["order"]))))

    def _after_dive(self, due: int, fix: Spot | None) -> None:
        """End a dive, if there is one, at a place in the stream and the fix after it: the line becomes longer, or ends."""
        cast, line = self.line.cast, replace(self.line, cast=Cast())
        if cast.source is None:
            return
        self.line = line
        profiles = cast.profiles(fix, self.config.surface_depth)
        cleaned = [without_spikes(each) for each in profiles]
        sound = tuple(each for each, _ in cleaned if np.isfinite(each.salinity).sum() > 2)
        reason = fault_of_units(cast, profiles) or ("" if sound else _NO_LEG)
        if not reason and abs(float(np.mean(sound[0].latitude))) < EQUATOR:
            reason = _NEAR_EQUATOR
        if reason:
            self._note(cast.source, cast.samples, due, reason)
            return
        lags = has_lag(sound, [share for _, share in cleaned])
        self.line = SectionLine(
            Cast(),
            line.profiles + sound,
            line.earlier,
            line.undecided + cast.samples,
            line.source or cast.source,
            line.lagging + lags,
        )
        section = _section(self.line.profiles)
        if section is None and len(self.line.profiles) >= _LEAST_PROFILES:
            # it turned here, or came into other water
            self.line = line
            self._close(due)
            self.line = SectionLine(Cast(), sound, (), cast.samples, cast.source, int(lags))
        elif section is not None and self._radii(section) >= COMPLETE:
            self._close(due)

    def _radii(self, section: Section) -> float:
        """Return the length of a line in Rossby radii."""
        return float(np.ptp(section.along)) / radius_of(section)

    def _close(self, due: int) -> None:
        """End the line as it is: its shear is measured, or the reason noted why not."""
        line = self.line
        self.line = SectionLine(line.cast, (), line.profiles)
        if line.source is None:
            return
        section, reason = _section(line.profiles), ""
        if section is not None and section.is_mixed:
            reason = _MIXED
        elif section is None or self._radii(section) < LEAST:
            reason = _NO_LINE
        elif is_fouled(line.profiles):
            reason = _FOULED
        else:
            at, positions = np.array(due), self.way.positions
            time = positions["time"][as_of(at, positions["order"])]
            source = replace(line.source, time_ns=int(time))
            doubt = LAG if 4 * line.lagging > len(line.profiles) else ""
            label = Label(int(self.depths.at(at)[2]), source, kind="shear", doubt=doubt)
            self.found.append((due, self._measured(line, section, label)))
        self._note(line.source, line.undecided, due, reason)

    def _measured(self, line: SectionLine, section: Section, label: Label) -> LinearMeasurement:
        """Return the shear of a line, with the statistics of it and of the window before."""
        whole = _section(line.earlier + line.profiles)
        if whole is None or whole.is_mixed:
            whole = section
        begun_s = (int(line.profiles[0].time_ns.mean()) - whole.time_ns) * 1e-9
        part = np.flatnonzero(whole.time >= begun_s - 1.0)
        return measurement(window_shear(fitted_line(whole, self.speed), part), whole, label)

    def _note(self, source: Source, messages: int, due: int, reason: str) -> None:
        self.ledger.add(np.full(messages, due), source.topic, reason)
