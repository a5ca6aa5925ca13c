"""CTD samples of dives as casts, and geostrophic shear across lines of them, measured as soon as a line is long enough.

Wrong units, a lag or a fouled cell would appear as currents: each is reported, and affected data are not used. Windows of a line share no
profile, so that no dive counts twice; wave statistics are from a window and the previous one. The shear is relative to an unknown current:
its depth mean is left to the DACs, whose errors are independent.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Flag, Label, LinearMeasurement, Source
from replay_kit.core.observation.table import Columns, Integers, Table, chosen_rows
from replay_kit.measurements.ctd.sections import Profile, Section, at_levels, section_of
from replay_kit.measurements.ctd.thermal_wind import EQUATOR, radius_of, shear_of
from replay_kit.measurements.means import Spot, spot
from replay_kit.measurements.step import Found, Step, left_out_reason
from replay_kit.measurements.track.dives import depth_of, legs_of
from replay_kit.measurements.track.positions import LONG_AGO, NEVER, as_of, in_order, positions_at

# m; layers over which samples are averaged, and a shorter leg is no profile
_LAYER, _LEG = 4.0, 40.0
# s; a longer time without a sample ends a leg, and mS/cm of one S/m
_GAP, _MS_CM = 1800.0, 10.0


def layers_of(samples: Columns) -> Array:
    """Return means of samples over depth layers in the order of passage.

    Args:
        samples: ``time`` [ns, UTC], ``fix``, time of the last position [ns, UTC], long ago if dead-reckoned, and ``values``, shape (n, 7):
            its longitude and latitude [degrees], depth [m], temperature [degrees C], salinity, conductivity [S/m], pressure [dbar].

    Returns:
        shape (l, 8), time since the first sample [s], and means of the values.
    """
    since = (samples["time"] - samples["time"][0]) * 1e-9
    rows = np.column_stack([since, samples["values"]])
    starts = np.flatnonzero(np.diff(rows[:, 3] // _LAYER, prepend=-1.0))
    return np.add.reduceat(rows, starts) / np.diff(np.append(starts, len(rows)))[:, None]


def profiles_of(
    samples: Columns, layers: Array, end: Spot | None, surface_depth: float
) -> list[Profile]:
    """Return the profile of each cast of a dive; missing salinity is computed from conductivity.

    Args:
        samples: See ``layers_of``.
        layers: Means over layers.
        end: Fix after the dive, to which positions are adjusted linearly in time; None for no adjustment.
        surface_depth: Depth above which the vehicle is at the surface [m].
    """
    first, start = samples["time"][0], samples["fix"][0]
    time, longitude, latitude, depth, temperature, salinity, conductivity, pressure = layers.T
    if end is not None and LONG_AGO < start < end.time:
        share = (time * 1e9 + first - start) / (end.time - start)
        west, south = samples["values"][0, :2]
        longitude = west + share * (unwrap_longitude(end.longitude, west) - west)
        latitude = south + share * (end.latitude - south)
    with np.errstate(invalid="ignore"):
        pressure = np.where(np.isfinite(pressure), pressure, gsw.p_from_z(-depth, latitude))
        computed = gsw.SP_from_C(_MS_CM * conductivity, temperature, pressure)
    salinity = np.where(np.isfinite(salinity), salinity, computed)
    time_ns = first + (time * 1e9).astype(np.int64)
    legs = legs_of(time_ns, depth, surface_depth, _LEG, _GAP)
    table = (time_ns, longitude, latitude, depth, temperature, salinity)
    return [
        Profile(*(values[legs == number] for values in table))
        for number in range(1, legs.max() + 1)
    ]


# Practical salinity by which a spike stands out at least.
_SPIKE = 0.05


def without_spikes(profile: Profile) -> tuple[Profile, float]:
    """Return a profile without salinity spikes, and the fraction of its samples removed."""
    salinity = profile.salinity
    padded = np.pad(salinity, 2, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, 5)
    with np.errstate(invalid="ignore"):
        away = np.abs(salinity - np.median(near, axis=1))
        bad = away > max(_SPIKE, 6.0 * float(np.nanmedian(away)))
    return replace(profile, salinity=np.where(bad, np.nan, salinity)), float(bad.mean())


# Practical salinity of the ocean and its marginal seas, and S/m that sea water never has.
_LEAST_SALINITY, _MOST_SALINITY, _MOST_CONDUCTIVITY = 2.0, 42.0, 8.0
# mS/cm per degree by which conductivity follows temperature; how well; over how many degrees at least
_FOLLOWS, _CORRELATED, _LEAST_RANGE = (0.75, 1.25), 0.99, 2.0
# m/s; no glider is slower over a leg. Ratio of the depth by pressure to the vehicle's: 0.1 in bar, 1.45 in psi.
_SLOWEST, _SAME_DEPTH = 0.03, (0.8, 1.25)
# By how much the legs down and up differ in the gradient of the temperature before it is named: salinity, and correlation with it.
_LAGGED, _OF_GRADIENT, _MANY_SPIKES = 0.03, 0.7, 0.1
# Change of deep salinity from dive to dive, where temperatures there are this near each other [degrees], that no water makes.
_DRIFTED, _SAME_WATER, _DEEP = 0.15, 0.5, 0.1

LAG = "salinity spikes of the legs down and up: the lag of the cell is not corrected"


def _known_median(values: Array) -> float:
    """Return the median of the known values; NaN without any."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def fault_of_units(layers: Array, profiles: Sequence[Profile]) -> str:
    """Return the wrong stated unit as text; empty if none is wrong."""
    depth, conductivity, pressure = layers[:, [3, 6, 7]].T
    if _known_median(conductivity) > _MOST_CONDUCTIVITY:
        return f"conductivity above {_MOST_CONDUCTIVITY:g} S/m: it looks like mS/cm"
    ratio = _known_median((pressure / depth)[depth > 20.0])
    if ratio <= _SAME_DEPTH[0] or ratio >= _SAME_DEPTH[1]:
        bar = "; it looks like bar" if 0.08 < ratio < 0.125 else ""
        return f"pressure [dbar] that is not the vehicle's depth{bar}"
    seconds = [np.ptp(each.time_ns) * 1e-9 for each in profiles]
    speeds = [np.ptp(each.depth) / s for each, s in zip(profiles, seconds, strict=True) if s]
    if speeds and np.median(speeds) < _SLOWEST:
        return "the vehicle moves vertically by less than 3 cm/s: the pressure looks like bar"
    for each in profiles:
        _, temperature, salinity = each.water
        if salinity.size < 5:
            continue
        if np.ptp(temperature) > _LEAST_RANGE and np.std(salinity) > 0.0:
            slope = np.polyfit(temperature, salinity, 1)[0]
            if (
                _FOLLOWS[0] < slope < _FOLLOWS[1]
                and np.corrcoef(temperature, salinity)[0, 1] > _CORRELATED
            ):
                return "salinity that follows temperature: it looks like conductivity in mS/cm"
        if not _LEAST_SALINITY < np.median(salinity) < _MOST_SALINITY:
            return f"salinity outside {_LEAST_SALINITY:g} to {_MOST_SALINITY:g}: wrong unit, or no salinity"
    return ""


def has_lag(profiles: Sequence[Profile], spiky: Sequence[float]) -> bool:
    """Return whether the salinity of descents and ascents differs as for a lagging cell.

    Args:
        profiles: Profiles of a dive, in order.
        spiky: Fraction of salinity spikes in each.
    """
    if np.mean(spiky) > _MANY_SPIKES:
        return True
    for down, up in itertools.pairwise(profiles):
        levels = np.arange(10.0, min(down.depth.max(), up.depth.max()), 10.0)
        if levels.size < 8:
            continue
        (first, warm), (second, _) = (
            at_levels(levels, each.depth, each.salinity, each.temperature) for each in (down, up)
        )
        pair = np.array([first - second, np.gradient(warm, levels)])
        known = pair[:, np.isfinite(pair).all(axis=0)]
        if known.shape[1] < 8 or np.std(known[0]) < _LAGGED:
            continue
        if abs(np.corrcoef(known)[0, 1]) > _OF_GRADIENT:
            return True
    return False


def is_fouled(profiles: Sequence[Profile]) -> bool:
    """Return whether deep salinity drifts along a line at constant temperature."""
    at = (1.0 - _DEEP) * np.median([each.depth.max() for each in profiles])
    found = []
    for each in profiles:
        water = each.water
        deep = water[1:, water[0] > at]
        found += [np.median(deep, axis=1)] if deep.size else []
    if not found:
        return False
    temperature, salinity = np.array(found).T
    same = np.abs(temperature - np.median(temperature)) < _SAME_WATER
    return bool(np.ptp(salinity[same]) > _DRIFTED)


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
    **dict.fromkeys(
        ["input", "topic", "position", "time", "order", "fix", "dive"], np.empty(0, np.int64)
    ),
    "values": np.empty((0, 7)),
}


class Dive(NamedTuple):
    """Dive of a line: first message, number of messages, profiles, whether the conductivity cell lags, and its number as stated or NaN."""

    source: Source
    messages: int
    profiles: tuple[Profile, ...]
    lags: bool
    stated: float


class SectionLine(NamedTuple):
    """State of a CTD between blocks.

    Attributes:
        samples: Samples since the last surfacing, as in ``layers_of``, with messages and positions in the stream.
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


def ctd_shears(
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
        samples_of_part, due = chosen_rows(samples, part), order[part[-1] + 1]
        surfaced = np.append(surfacings, NEVER)[before[part[0]]]
        if min(due, surfaced) == NEVER and not step.last:
            line = line._replace(samples=samples_of_part)
            break
        fix = as_of(surfaced, step.positions["order"]) if surfaced < due else -1
        line = _after_dive(line, samples_of_part, int(min(due, surfaced)), int(fix), step, found)
    else:
        line = line._replace(samples=_NO_SAMPLES)
    return (_close_line(line, NEVER, step, found) if step.last and line.dives else line), found


def _samples(table: Table, step: Step) -> Columns:
    """Return the usable samples of a table, as in ``SectionLine``, and note the others."""
    before = as_of(table.order, step.positions["order"])
    time, *places = positions_at(step.positions, before)
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
        "dive": table["dive"],
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
    lags = has_lag(sound, [share for _, share in cleaned])
    dive = Dive(source, n, sound, lags, float(samples["dive"][-1]))
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
        stated, counted = dives[-1].stated, step.dived(at)["dive"]
        number = int(counted if np.isnan(stated) else stated)
        label = Label(number, source, kind="shear", doubt=doubt)
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
