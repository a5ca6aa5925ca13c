"""CTD samples of a dive as profiles, layer means and casts; and faults that would appear as currents.

Wrong units, a lag, a fouled cell: each is reported, and affected data are not used.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import gsw
import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.observation.table import Columns
from replay_kit.measurements.ctd.sections import Profile, at_levels
from replay_kit.measurements.means import Spot
from replay_kit.measurements.track.dives import legs_of
from replay_kit.measurements.track.positions import LONG_AGO

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
_FOULED, _SAME_WATER, _DEEP = 0.15, 0.5, 0.1

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
    return bool(np.ptp(salinity[same]) > _FOULED)
