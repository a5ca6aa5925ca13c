"""Samples of a CTD to the profiles of a dive, means over layers and legs down and up; and faults that would be taken for currents.

Wrong units, a lag, a fouled cell: each is named, and what it spoils is not used.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.observation import Source
from replay_kit.core.table import Integers
from replay_kit.measurements.ctd.sections import Profile, at_levels
from replay_kit.measurements.dives import legs_of
from replay_kit.measurements.means import Spot

# m; layers over which samples are averaged, and a shorter leg is no profile
_LAYER, _LEG = 4.0, 40.0
# s; a longer time without a sample ends a leg, and mS/cm of one S/m
_GAP, _MS_CM = 1800.0, 10.0
# in a row of sums: number of samples, time, longitude, latitude, depth, temperature, salinity, conductivity, pressure
_COLUMNS, _DEPTH = 9, 4


@dataclass(frozen=True, slots=True, eq=False)
class Cast:
    """The samples since the last surfacing, averaged over layers.

    Attributes:
        source: Of the first sample; None before it.
        start: Last fix before the first sample; None without.
        sums: shape (l, 9), layer after layer as passed, the last one as far as it was: number of samples, and sums of their time since the
            first sample [s], longitude, latitude [degrees], depth [m], temperature [degrees C], salinity, conductivity [S/m], pressure
            [dbar].
        last_ns: Of the last [ns, UTC].
    """

    source: Source | None = None
    start: Spot | None = None
    sums: Array = field(default_factory=lambda: np.empty((0, _COLUMNS)))
    last_ns: int = 0

    @property
    def samples(self) -> int:
        """How many there are."""
        return int(self.sums[:, 0].sum())

    @property
    def layers(self) -> Array:
        """Means of what ``sums`` has the sums of, shape (l, 8)."""
        return self.sums[:, 1:] / self.sums[:, :1]

    def after(self, source: Source, fix: Spot | None, time: Integers, samples: Array) -> "Cast":
        """Return the cast with more samples, none earlier than the last.

        Args:
            source: Message of the first of them.
            fix: The position before it; None where it is dead-reckoned.
            time: shape (n,) [ns, UTC].
            samples: shape (n, 7): longitude, latitude of the position before, and the columns of ``sums`` from depth on.
        """
        first = self.source or source
        start = self.start if self.samples or fix is None else fix
        since = (time - first.time_ns) * 1e-9
        rows = np.column_stack([np.ones(time.size), since, samples])
        rows = np.concatenate([self.sums[-1:], rows])
        # a layer's mean depth lies in the layer
        cell = rows[:, _DEPTH] / rows[:, 0] // _LAYER
        parts = np.split(rows, np.flatnonzero(np.diff(cell)) + 1)
        # added one by one, so that sums do not depend on how samples are cut
        sums = [np.cumsum(part, axis=0)[-1] for part in parts]
        return Cast(first, start, np.vstack([self.sums[:-1], *sums]), int(time[-1]))

    def profiles(self, end: Spot | None, surface_depth: float) -> list[Profile]:
        """Return the profile of each leg; salinity is computed from conductivity where none is stated.

        Args:
            end: The fix after the dive, to which places are moved linearly in time from the fix before it; None leaves them.
            surface_depth: [m], shallower than this the vehicle is at the surface.
        """
        assert self.source is not None, "it has samples"
        first = self.source.time_ns
        time, longitude, latitude, depth, temperature, salinity, conductivity, pressure = (
            self.layers.T
        )
        start = self.start
        if end is not None and start is not None and end.time > start.time:
            share = (time * 1e9 + first - start.time) / (end.time - start.time)
            east = float(unwrap_longitude(end.longitude, start.longitude))
            longitude = start.longitude + share * (east - start.longitude)
            latitude = start.latitude + share * (end.latitude - start.latitude)
        with np.errstate(invalid="ignore"):
            pressure = np.where(np.isfinite(pressure), pressure, gsw.p_from_z(-depth, latitude))
            computed = gsw.SP_from_C(_MS_CM * conductivity, temperature, pressure)
        salinity = np.where(np.isfinite(salinity), salinity, computed)
        time_ns = first + (time * 1e9).astype(np.int64)
        of_legs = legs_of(time_ns, depth, surface_depth, _LEG, _GAP)
        table = (time_ns, longitude, latitude, depth, temperature, salinity)
        return [
            Profile(*(values[of_legs == number] for values in table))
            for number in range(1, of_legs.max() + 1)
        ]


# Practical salinity by which a spike stands out at least.
_SPIKE = 0.05


def without_spikes(profile: Profile) -> tuple[Profile, float]:
    """Return a profile without salinity that stands out of its neighbours, and the share of its samples that does."""
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
_FOULED, _SAME_WATER, _DEEP = 0.15, 0.5, 0.1

LAG = "salinity spikes of the legs down and up: the lag of the cell is not corrected"


def fault_of_units(cast: Cast, profiles: Sequence[Profile]) -> str:
    """Return which unit is not that stated, in words; empty where all may be."""
    depth, conductivity, pressure = cast.layers[:, [3, 6, 7]].T
    if np.isfinite(conductivity).any() and np.nanmedian(conductivity) > _MOST_CONDUCTIVITY:
        return f"conductivity above {_MOST_CONDUCTIVITY:g} S/m: it looks like mS/cm"
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = pressure[depth > 20.0] / depth[depth > 20.0]
    if np.isfinite(ratio).any():
        found = float(np.nanmedian(ratio))
        if not _SAME_DEPTH[0] < found < _SAME_DEPTH[1]:
            bar = "; it looks like bar" if 0.08 < found < 0.125 else ""
            return f"pressure [dbar] that is not the vehicle's depth{bar}"
    seconds = [np.ptp(each.time_ns) * 1e-9 for each in profiles]
    speeds = [np.ptp(each.depth) / s for each, s in zip(profiles, seconds, strict=True) if s]
    if speeds and np.median(speeds) < _SLOWEST:
        return "the vehicle moves vertically by less than 3 cm/s: the pressure looks like bar"
    for each in profiles:
        known = np.isfinite(each.salinity + each.temperature)
        salinity, temperature = each.salinity[known], each.temperature[known]
        if salinity.size < 5:
            continue
        if np.ptp(temperature) > _LEAST_RANGE and np.std(salinity) > 0.0:
            slope = np.polyfit(temperature, salinity, 1)[0]
            follows = np.corrcoef(temperature, salinity)[0, 1]
            if _FOLLOWS[0] < slope < _FOLLOWS[1] and follows > _CORRELATED:
                return "salinity that follows temperature: it looks like conductivity in mS/cm"
        if not _LEAST_SALINITY < np.median(salinity) < _MOST_SALINITY:
            return f"salinity outside {_LEAST_SALINITY:g} to {_MOST_SALINITY:g}: wrong unit, or no salinity"
    return ""


def has_lag(profiles: Sequence[Profile], spiky: Sequence[float]) -> bool:
    """Return whether the salinity of legs down and up differs as a lagging cell makes it.

    Args:
        profiles: Of a dive, in order.
        spiky: Share of each one's salinity that stands out.
    """
    if spiky and float(np.mean(spiky)) > _MANY_SPIKES:
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
    """Return whether deep salinity drifts along a line as no water does whose temperature stays."""
    at = (1.0 - _DEEP) * np.median([each.depth.max() for each in profiles])
    found = []
    for each in profiles:
        water = np.array([each.temperature, each.salinity])
        deep = water[:, (each.depth > at) & np.isfinite(water).all(axis=0)]
        found += [np.median(deep, axis=1)] if deep.size else []
    if not found:
        return False
    temperature, salinity = np.array(found).T
    same = np.abs(temperature - np.median(temperature)) < _SAME_WATER
    return bool(np.ptp(salinity[same]) > _FOULED)
