"""Dives along a line to measurements of the geostrophic shear across it, as soon as the line is long enough: online as afterwards.

Windows of a line have no profile in common, so that no dive counts twice; the statistics of waves are those of the window and of the one
before it. The shear is relative to an unknown current: the mean over its depths is left to mean currents of dives, whose errors are
others'.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Flag, Label, LinearMeasurement, Source
from replay_kit.core.table import Integers, Table
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
    regime_of,
    window_shear,
)
from replay_kit.measurements.dives import Depths, depth_of
from replay_kit.measurements.ledger import Ledger, left_out_reason
from replay_kit.measurements.means import Spot, spot
from replay_kit.measurements.pings import Way
from replay_kit.measurements.positions import as_of, beside

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


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of messages.

    Attributes:
        topic: Theirs.
        messages: How many.
        reason: Why they are not used; empty where they are.
        shear: The measurement that they gave.
    """

    topic: str
    messages: int
    reason: str = ""
    shear: LinearMeasurement | None = None


@dataclass(frozen=True, slots=True)
class Surfacing:
    """When and where a line is looked at.

    Attributes:
        time_ns: Of the message that ended the dive [ns, UTC].
        dive: Its number.
        fix: After it; None where there is none.
        surface_depth: [m].
        speed: Rms speed of the region's currents [m/s].
    """

    time_ns: int
    dive: int
    fix: Spot | None
    surface_depth: float
    speed: float


def after_dive(line: SectionLine, at: Surfacing) -> tuple[SectionLine, list[Outcome]]:
    """Return the line after a dive, and what became of the messages of those that are decided."""
    cast, line = line.cast, replace(line, cast=Cast())
    profiles = cast.profiles(at.fix, at.surface_depth)
    if fault := fault_of_units(cast, profiles):
        return line, [Outcome(_topic(cast.source), cast.samples, fault)]
    cleaned = [without_spikes(each) for each in profiles]
    profiles = [each for each, _ in cleaned if np.isfinite(each.salinity).sum() > 2]
    if not profiles:
        return line, [Outcome(_topic(cast.source), cast.samples, _NO_LEG)]
    if abs(float(np.mean(profiles[0].latitude))) < EQUATOR:
        return line, [Outcome(_topic(cast.source), cast.samples, _NEAR_EQUATOR)]
    lags = has_lag(profiles, [share for _, share in cleaned])
    longer = replace(
        line,
        profiles=(*line.profiles, *profiles),
        undecided=line.undecided + cast.samples,
        source=line.source or cast.source,
        lagging=line.lagging + lags,
    )
    if len(longer.profiles) < _LEAST_PROFILES:
        return longer, []
    section = _section(longer.profiles)
    if section is None:
        # it turned here, or came into other water
        _, done = close(line, at)
        begun = SectionLine(Cast(), tuple(profiles), (), cast.samples, cast.source, int(lags))
        return begun, done
    if _length(section) < COMPLETE * regime_of(section, at.speed).rossby_radius:
        return longer, []
    return close(longer, at)


def close(line: SectionLine, at: Surfacing) -> tuple[SectionLine, list[Outcome]]:
    """Return what goes on from a line that is looked at as it is, and what became of its messages."""
    after = SectionLine(line.cast, (), line.profiles)
    if not line.undecided:
        return after, []
    section = _section(line.profiles)
    if section is not None and section.is_mixed:
        return after, [Outcome(_topic(line.source), line.undecided, _MIXED)]
    if section is None or _length(section) < LEAST * regime_of(section, at.speed).rossby_radius:
        return after, [Outcome(_topic(line.source), line.undecided, _NO_LINE)]
    if is_fouled(line.profiles):
        return after, [Outcome(_topic(line.source), line.undecided, _FOULED)]
    whole = _section((*line.earlier, *line.profiles)) or section
    whole = section if whole.is_mixed else whole
    begun_s = (int(line.profiles[0].time_ns.mean()) - whole.time_ns) * 1e-9
    part = np.flatnonzero(whole.time >= begun_s - 1.0)
    shear = window_shear(fitted_line(whole, at.speed), part)
    doubt = LAG if 4 * line.lagging > len(line.profiles) else ""
    assert line.source is not None, "it has profiles"
    label = Label(at.dive, replace(line.source, time_ns=at.time_ns), kind="shear", doubt=doubt)
    return after, [
        Outcome(line.source.topic, line.undecided, shear=measurement(shear, whole, label))
    ]


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


def _length(section: Section) -> float:
    return float(np.ptp(section.along))


def _topic(source: Source | None) -> str:
    return "" if source is None else source.topic


# ns; a vehicle that has sent no sample for so long has surfaced, whether or not its log says so
_LONGEST_NS = 3 * 3600 * 10**9
_INCOMPLETE = "sample without depth, temperature, or salinity"
_AT_SURFACE, _NO_POSITION = "sample at the surface", "sample before the first position"
# m/s; of currents where nothing else is known
_SPEED = 0.2
_CTD = ("temperature", "salinity", "conductivity", "pressure")
_NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Samples of a block that count, in order: places in the stream, times, columns as of ``Cast.after``, positions before, and tables."""

    order: Integers
    time: Integers
    values: Array
    before: NDArray[np.intp]
    table: NDArray[np.intp]
    ordinal: Integers


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
        self.line, self.way, self.depths, self.config, self.ledger = (
            line,
            way,
            depths,
            config,
            ledger,
        )
        self.found: list[tuple[int, LinearMeasurement]] = []

    def take(self, tables: Sequence[Table], surfacings: Integers) -> None:
        """Take samples in.

        Args:
            tables: Of the samples.
            surfacings: Places in the stream of positions at the surface that messages of their own state.
        """
        samples = self._samples(tables)
        cuts = np.searchsorted(surfacings, samples.order)
        begin, upto = 0, 0
        ends = np.flatnonzero((np.diff(cuts) > 0) | (np.diff(samples.time) > _LONGEST_NS)) + 1
        for end in [*ends.tolist(), samples.order.size]:
            if end == begin:
                continue
            self._ended(surfacings[upto : cuts[begin]])
            self._sampled(samples, begin, end, tables)
            begin, upto = end, cuts[begin]
        self._ended(surfacings[upto:])
        if self.way.last and self.line is not None:
            if self.line.cast.samples:
                self._after_dive(_NEVER, None)
            self.line, outcomes = close(self.line, self._surfacing(_NEVER, None))
            self._note(outcomes, _NEVER)

    def _samples(self, tables: Sequence[Table]) -> _Samples:
        """Return the samples that count, and note the others."""
        found = []
        positions = self.way.positions
        for number, table in enumerate(tables):
            before = as_of(table.order, positions["order"])
            places = beside(positions, before)
            depth = table["depth"]
            depth = np.where(np.isfinite(depth), depth, depth_of(table["pressure"], places[2]))
            values = np.column_stack([*places[1:], depth, *(table[name] for name in _CTD)])
            known = np.isfinite(table["salinity"]) | np.isfinite(table["conductivity"])
            why = np.full(len(table), "", object)
            why[before < 0] = _NO_POSITION
            why[depth < self.config.surface_depth] = _AT_SURFACE
            why[~(known & np.isfinite(depth + table["temperature"]))] = _INCOMPLETE
            if "shear" in self.config.without:
                why[:] = left_out_reason(("shear",))
            good = why == ""
            self.ledger.add(table.order[~good], table.topic, why[~good])
            columns = (
                table.order,
                table.time,
                values,
                before,
                np.full(len(table), number),
                table.position,
            )
            found.append([column[good] for column in columns])
        if not found:
            none = np.empty(0, np.int64)
            return _Samples(none, none, np.empty((0, 7)), none, none, none)
        whole = [np.concatenate(parts) for parts in zip(*found, strict=True)]
        at = np.argsort(whole[0], kind="stable")
        return _Samples(*(column[at] for column in whole))

    def _sampled(self, samples: _Samples, begin: int, end: int, tables: Sequence[Table]) -> None:
        """Take in samples between which nothing ends the dive."""
        line = self.line or SectionLine()
        first = int(samples.time[begin])
        if line.cast.samples and first > line.cast.last_ns + _LONGEST_NS:
            self.line = line
            self._after_dive(int(samples.order[begin]), None)
            line = self.line
        table, at = tables[samples.table[begin]], int(samples.before[begin])
        source = Source(table.input, table.topic, int(samples.ordinal[begin]), first)
        fix = None if self.way.positions["dead_reckoned"][at] else spot(self.way.positions, at)
        cast = line.cast.after(source, fix, samples.time[begin:end], samples.values[begin:end])
        self.line = replace(line, cast=cast)

    def _ended(self, surfacings: Integers) -> None:
        """End the dive at the first of some positions at the surface."""
        if self.line is None or not self.line.cast.samples or not surfacings.size:
            return
        order, positions = int(surfacings[0]), self.way.positions
        at = int(as_of(surfacings[:1], positions["order"])[0])
        self._after_dive(order, None if positions["dead_reckoned"][at] else spot(positions, at))

    def _after_dive(self, due: int, fix: Spot | None) -> None:
        assert self.line is not None, "it has samples"
        self.line, outcomes = after_dive(self.line, self._surfacing(due, fix))
        self._note(outcomes, due)

    def _surfacing(self, due: int, fix: Spot | None) -> Surfacing:
        positions, order = self.way.positions, np.array([due])
        time = int(positions["time"][as_of(order, positions["order"])[0]])
        dive, config = int(self.depths.at(order)[2][0]), self.config
        return Surfacing(time, dive, fix, config.surface_depth, config.regional_speed or _SPEED)

    def _note(self, outcomes: Sequence[Outcome], due: int) -> None:
        for each in outcomes:
            self.ledger.add(np.full(each.messages, due, np.int64), each.topic, each.reason)
            self.found += [] if each.shear is None else [(due, each.shear)]
