"""Fixes of a vessel in raw ADCP files, with the instrument's clock and the magnetic declination that follow from them."""

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation.table import Columns

_SECOND_NS, _MS_NS = 1_000_000_000, 1_000_000
_DAY_MS = 86_400_000.0


class Fixes(NamedTuple):
    """Fixes of a vessel.

    Attributes:
        columns: ``time`` [ns, UTC], increasing, ``longitude``, ``latitude`` [degrees] and ``error`` [m], NaN; shape (n,).
        offset_ns: UTC minus the instrument's clock [ns]; None without fixes.
        n_bad: Number of GPS records without a fix.
    """

    columns: Columns
    offset_ns: int | None
    n_bad: int

    def declination(self, time_ns: int) -> float | None:
        """Return the magnetic declination [degrees] at the first fix from a time on, or at the last; None without fixes or before 2010."""
        times, longitude, latitude, _ = self.columns.values()
        if not times.size:
            return None
        near = min(int(np.searchsorted(times, time_ns)), times.size - 1)
        return declination_at(time_ns, float(longitude[near]), float(latitude[near]))


def fixes_of(datasets: Sequence[Any]) -> Fixes:
    """Return the fixes in the MHKiT datasets (xarray) of one file, in any order."""
    table = np.concatenate([np.empty((5, 0)), *map(_raw_fixes, datasets)], axis=1)
    good = table[4] > 0.0
    gps, own, longitude, latitude = table[:4, good]
    dated = any(dataset.attrs.get("source_program") == "VMDAS" for dataset in datasets)
    offset = clock_offset(gps, own, dated) if gps.size else None
    if offset is not None and not dated:
        # of several whole days the one that the offset means
        gps = gps - np.round((gps - own - offset) / _DAY_MS) * _DAY_MS
    time, first = np.unique(gps.astype(np.int64) * _MS_NS, return_index=True)
    places = {"longitude": longitude[first], "latitude": latitude[first]}
    columns = {"time": time, **places, "error": np.full(time.size, np.nan)}
    return Fixes(
        columns, None if offset is None else int(offset * _MS_NS), int(good.size - good.sum())
    )


def _raw_fixes(dataset: Any) -> Array:
    """Return GPS time and instrument's clock [ms], longitude, latitude, and whether it is valid, of each fix, shape (5, n)."""
    if not {"time_gps", "latitude_gps"} <= {*dataset.variables}:
        return np.empty((5, 0))
    # to the millisecond: MHKiT carries seconds as floats
    times = [
        np.round(dataset[name].values.astype("datetime64[us]").astype(np.int64) / 1000)
        for name in ("time_gps", "hdwtime_gps")
    ]
    longitude, latitude = (dataset[f"{name}_gps"].values for name in ("longitude", "latitude"))
    good = np.isfinite(longitude + latitude) & ((longitude != 0.0) | (latitude != 0.0))
    if "fix_gps" in dataset:
        good &= dataset["fix_gps"].values > 0
    return np.array([*times, longitude, latitude, good], np.float64)


def clock_offset(gps: Array, own: Array, dated: bool) -> float:
    """Return UTC minus the instrument's clock [ms], the median over the fixes.

    Args:
        gps: GPS time of each fix, shape (n,) [ms].
        own: The instrument's clock at each fix, shape (n,) [ms].
        dated: Whether the GPS time has its own date; otherwise the offset is known modulo a day, and that within half a day is returned.
    """
    ahead = gps - own
    return float(np.median(ahead if dated else (ahead + _DAY_MS / 2) % _DAY_MS - _DAY_MS / 2))


def declination_at(time_ns: int, longitude: float, latitude: float) -> float | None:
    """Return the magnetic declination [degrees, positive east] by the World Magnetic Model of the time; None before 2010.

    Positions are rounded to 0.1 degree and times to 0.1 year, below the resolution of a compass.
    """
    when = datetime.fromtimestamp(time_ns // _SECOND_NS, UTC)
    year = round(when.year + (when.timetuple().tm_yday - 1) / 366.0, 1)
    return _declination(year, round(longitude, 1), round(latitude, 1))


@lru_cache(maxsize=1024)
def _declination(year: float, longitude: float, latitude: float) -> float | None:
    from pygeomag import GeoMag

    # models of five years each: the first that covers the year; none does before 2010
    for file in ("WMM_2010", "WMM_2015v2", "WMM_2020", "WMM_2025"):
        model = GeoMag(coefficients_file=f"wmm/{file}.COF")
        low, high = model.life_span
        if low <= year <= high:
            found = model.calculate(glat=latitude, glon=longitude, alt=0.0, time=year)
            return round(float(found.d), 2)
    return None
