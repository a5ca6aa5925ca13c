"""Geostrophic shear across lines of dives, measured as soon as a line is long enough.

Windows of a line share no profile, so that no dive counts twice; wave statistics are from a window and the previous one. The shear is
relative to an unknown current: its depth mean is left to the DACs, whose errors are independent.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Flag, Label, LinearMeasurement, Source
from replay_kit.core.observation.table import Columns, Integers, Table, chosen
from replay_kit.measurements.ctd.casts import (
    LAG,
    fault_of_units,
    has_lag,
    is_fouled,
    layers_of,
    profiles_of,
    without_spikes,
)
from replay_kit.measurements.ctd.sections import Profile, Section, section_of
from replay_kit.measurements.ctd.thermal_wind import EQUATOR, radius_of, shear_of
from replay_kit.measurements.means import spot
from replay_kit.measurements.step import Found, Step, left_out_reason
from replay_kit.measurements.track.dives import depth_of
from replay_kit.measurements.track.positions import LONG_AGO, NEVER, as_of, beside, in_order

#: Rossby radii: a line as long is complete, and one shorter tells less than an ensemble knows.
COMPLETE, LEAST = 1.0, 0.3
_LEAST_PROFILES = 4
# Levels at which the shear is stated.
_STATED = 12

_FOULED = "deep salinity drifts along the line: it looks like a fouled cell"
# ns; a vehicle that has sent no sample for so long has surfaced, whether or not its log says so
_LONGEST_NS = 3 * 3600 * 10**9
_INCOMPLETE = "sample without depth, temperature, or salinity"
_AT_SURFACE, _NO_POSITION = "sample at the surface", "sample before the first position"
# m/s; of currents where nothing else is known
_SPEED = 0.2
_CTD = ("temperature", "salinity", "conductivity", "pressure")
_NO_SAMPLES: Columns = {
    **dict.fromkeys(("input", "topic", "position", "time", "order", "fix"), np.empty(0, np.int64)),
    "values": np.empty((0, 7)),
}


class Dive(NamedTuple):
    """Dive of a line: first message, number of messages, profiles, and whether the conductivity cell lags."""

    source: Source
    messages: int
    profiles: tuple[Profile, ...]
    lags: bool


class SectionLine(NamedTuple):
    """State of a CTD between blocks.

    Attributes:
        samples: Samples since the last surfacing, as in ``casts.layers_of``, with messages and positions in the stream.
        dives: Dives of the line so far that are in no window.
        earlier: Profiles of the previous window of the line, if any.
    """

    samples: Columns = _NO_SAMPLES
    dives: tuple[Dive, ...] = ()
    earlier: tuple[Profile, ...] = ()

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """Profiles of the line so far."""
        return sum((dive.profiles for dive in self.dives), ())


def of_ctd(
    line: SectionLine, tables: Sequence[Table], surfacings: Integers, step: Step
) -> tuple[SectionLine, Found]:
    """Return the state after a block, and the completed shears.

    Args:
        line: State before the block.
        tables: Tables of samples.
        surfacings: Positions in the stream of surfacings.
        step: Block.
    """
    found, samples = Found(), in_order(line.samples, *(_samples(one, step) for one in tables))
    time, order = samples["time"], np.append(samples["order"], NEVER)
    before = np.searchsorted(surfacings, order[:-1])
    late = np.diff(time, prepend=time[:1]) > _LONGEST_NS
    starts = np.flatnonzero((np.diff(before, prepend=-1) > 0) | late)
    for part in np.split(np.arange(time.size), starts)[1:]:
        own, due = chosen(samples, part), order[part[-1] + 1]
        surfaced = np.append(surfacings, NEVER)[before[part[0]]]
        if min(due, surfaced) == NEVER and not step.last:
            line = line._replace(samples=own)
            break
        fix = as_of(surfaced, step.positions["order"]) if surfaced < due else -1
        line = _after_dive(line, own, int(min(due, surfaced)), int(fix), step, found)
    else:
        line = line._replace(samples=_NO_SAMPLES)
    return (_close_line(line, NEVER, step, found) if step.last and line.dives else line), found


def _samples(table: Table, step: Step) -> Columns:
    """Return the usable samples of a table, as in ``SectionLine``, and note the others."""
    before = as_of(table.order, step.positions["order"])
    time, *places = beside(step.positions, before)
    depth = table["depth"]
    depth = np.where(np.isfinite(depth), depth, depth_of(table["pressure"], places[1]))
    known = np.isfinite(table["salinity"]) | np.isfinite(table["conductivity"])
    why = np.full(len(table), "", object)
    why[before < 0] = _NO_POSITION
    why[depth < step.config.surface_depth] = _AT_SURFACE
    why[~(known & np.isfinite(depth + table["temperature"]))] = _INCOMPLETE
    if "shear" in step.config.without:
        why[:] = left_out_reason(("shear",))
    columns = {
        "input": np.full(len(table), table.input),
        "topic": np.full(len(table), table.topic, object),
        "position": table.position,
        "time": table.time,
        "order": table.order,
        "fix": np.where(np.append(step.positions["dead_reckoned"], True)[before], LONG_AGO, time),
        "values": np.column_stack([*places, depth, *(table[name] for name in _CTD)]),
    }
    return step.kept(replace(table, columns=columns), why).columns


def _after_dive(
    line: SectionLine, samples: Columns, due: int, fix: int, step: Step, found: Found
) -> SectionLine:
    """Return the line after a dive that ends at a position in the stream, extended or closed; ``fix`` is the row of its fix."""
    source = Source(*(samples[name].item(0) for name in list(samples)[:4]))
    layers, n, end = layers_of(samples), len(samples["time"]), None
    if fix >= 0 and not step.positions["dead_reckoned"][fix]:
        end = spot(step.positions, fix)
    profiles = profiles_of(samples, layers, end, step.config.surface_depth)
    cleaned = [without_spikes(each) for each in profiles]
    sound = tuple(each for each, _ in cleaned if np.isfinite(each.salinity).sum() > 2)
    reason = fault_of_units(layers, profiles)
    if not reason and not sound:
        reason = "no leg of 40 m with temperature and salinity"
    if not reason and abs(np.mean(sound[0].latitude)) < EQUATOR:
        reason = f"within {EQUATOR:g} degrees of the equator there is no geostrophic balance"
    if reason:
        step.add(np.full(n, due), step.topic(source.topic), reason)
        return line
    dive = Dive(source, n, sound, has_lag(sound, [share for _, share in cleaned]))
    longer = line._replace(dives=(*line.dives, dive))
    section = section_of(longer.profiles)
    if section is None and len(longer.profiles) >= _LEAST_PROFILES:
        # it turned here, or came into other water
        if line.dives:
            _close_line(line, due, step, found)
        return SectionLine(dives=(dive,))
    if section is not None and _radii(section) >= COMPLETE:
        return _close_line(longer, due, step, found)
    return longer


def _radii(section: Section) -> float:
    """Return the length of a line in Rossby radii."""
    return float(np.ptp(section.along)) / radius_of(section)


def _close_line(line: SectionLine, due: int, step: Step, found: Found) -> SectionLine:
    """Close a line: measure its shear, or note the reason for exclusion."""
    profiles, dives, reason = line.profiles, line.dives, ""
    section = section_of(profiles)
    if section is not None and section.is_mixed:
        reason = (
            "mixed water: without stratification there are no internal waves to fit, and no shear"
        )
    elif section is None or _radii(section) < LEAST:
        reason = "profiles along no straight line of 0.3 Rossby radii"
    elif is_fouled(profiles):
        reason = _FOULED
    else:
        at, positions = np.array(due), step.positions
        time = positions["time"][as_of(at, positions["order"])]
        source = replace(dives[0].source, time_ns=int(time))
        doubt = LAG if 4 * sum(dive.lags for dive in dives) > len(profiles) else ""
        label = Label(int(step.dived(at)["dive"]), source, kind="shear", doubt=doubt)
        reason = step.left_out("shear", label.dive)
        whole = section_of(line.earlier + profiles)
        whole = section if whole is None or whole.is_mixed else whole
        if not reason:
            found.append((due, _shear_measurement(whole, profiles[0], label, step)))
    for dive in dives:
        step.add(np.full(dive.messages, due), step.topic(dive.source.topic), reason)
    return SectionLine(earlier=profiles)


def _shear_measurement(
    section: Section, first: Profile, label: Label, step: Step
) -> LinearMeasurement:
    """Return the shear across a line from a profile on, relative to an unknown current, at some levels."""
    begun_s = (int(first.time_ns.mean()) - section.time_ns) * 1e-9
    part = np.flatnonzero(section.time >= begun_s - 1.0)
    shear = shear_of(section, step.config.regional_speed or _SPEED, part)
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
