"""Faults of a CTD that would be taken for currents: wrong units, a lag, a fouled cell. Each is named, and what it spoils is not used."""

import itertools
from collections.abc import Sequence

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.measurements.section.casts import Cast
from replay_kit.measurements.section.hydrography import Profile

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
    depth, conductivity, pressure = cast.columns()
    if np.isfinite(conductivity).any() and np.nanmedian(conductivity) > _MOST_CONDUCTIVITY:
        return f"conductivity above {_MOST_CONDUCTIVITY:g} S/m: it looks like mS/cm"
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = pressure[depth > 20.0] / depth[depth > 20.0]
    if np.isfinite(ratio).any():
        found = float(np.nanmedian(ratio))
        if not _SAME_DEPTH[0] < found < _SAME_DEPTH[1]:
            bar = "; it looks like bar" if 0.08 < found < 0.125 else ""
            return f"pressure [dbar] that is not the vehicle's depth{bar}"
    speeds = [abs(np.ptp(each.depth) / _seconds(each)) for each in profiles if _seconds(each) > 0.0]
    if speeds and float(np.median(speeds)) < _SLOWEST:
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
        if not _LEAST_SALINITY < float(np.median(salinity)) < _MOST_SALINITY:
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
        (first, warm), (second, _) = (_at(each, levels) for each in (down, up))
        difference, gradient = first - second, np.gradient(warm, levels)
        known = np.isfinite(difference + gradient)
        if known.sum() < 8 or np.std(difference[known]) < _LAGGED:
            continue
        related = np.corrcoef(difference[known], gradient[known])[0, 1]
        if abs(related) > _OF_GRADIENT:
            return True
    return False


def is_fouled(profiles: Sequence[Profile]) -> bool:
    """Return whether deep salinity drifts along a line as no water does whose temperature stays."""
    deepest = float(np.median([each.depth.max() for each in profiles]))
    at = (1.0 - _DEEP) * deepest
    found = []
    for each in profiles:
        deep = (each.depth > at) & np.isfinite(each.salinity + each.temperature)
        if deep.any():
            found.append((np.median(each.temperature[deep]), np.median(each.salinity[deep])))
    if len(found) < 2:
        return False
    temperature, salinity = np.array(found).T
    same = np.abs(temperature - np.median(temperature)) < _SAME_WATER
    return bool(np.ptp(salinity[same]) > _FOULED)


def _seconds(profile: Profile) -> float:
    return float(profile.time_ns[-1] - profile.time_ns[0]) * 1e-9


def _at(profile: Profile, levels: Array) -> tuple[Array, Array]:
    """Return salinity and temperature at levels, shapes (Z,)."""
    order = np.argsort(profile.depth, kind="stable")
    salinity, temperature = (
        np.interp(levels, profile.depth[order], values[order], left=np.nan, right=np.nan)
        for values in (profile.salinity, profile.temperature)
    )
    return salinity, temperature
