"""A vessel's fixes in a raw ADCP file, and what they determine: the clock's offset and the magnetic declination."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.logs.shared.positions import Positions

_NS = 1_000_000_000
_HALF_DAY_NS = 43_200 * _NS


@dataclass(frozen=True, slots=True, eq=False)
class Fixes(Positions):
    """A vessel's fixes.

    Attributes:
        offset_ns: What is to be added to the instrument's clock to have UTC [ns]; None without fixes.
        n_bad: Records of the GPS that are no fix.
    """

    offset_ns: int | None
    n_bad: int

    def declination_deg(self, time_ns: int) -> float | None:
        """Return the magnetic declination at the first fix from a time on, or at the last; None without fixes and before 2010."""
        if not self.time_ns.size:
            return None
        near = min(int(np.searchsorted(self.time_ns, time_ns)), self.time_ns.size - 1)
        return declination_deg(time_ns, float(self.longitude[near]), float(self.latitude[near]))


def fixes_of(datasets: Sequence[Any]) -> Fixes:
    """Return the fixes in datasets of MHKiT (xarray) of one file, in any order."""
    found = [
        _raw_fixes(dataset)
        for dataset in datasets
        if "time_gps" in dataset and "latitude_gps" in dataset
    ]
    if not found:
        return Fixes(np.zeros(0, np.int64), np.zeros(0), np.zeros(0), None, 0)
    gps_ns, instrument_ns, longitude, latitude, good = (
        np.concatenate(parts) for parts in zip(*found, strict=True)
    )
    n_bad = int(good.size - good.sum())
    gps_ns, instrument_ns, longitude, latitude = (
        values[good] for values in (gps_ns, instrument_ns, longitude, latitude)
    )
    dated = any(dataset.attrs.get("source_program") == "VMDAS" for dataset in datasets)
    offset_ns = clock_offset_ns(gps_ns, instrument_ns, dated) if good.any() else None
    if offset_ns is not None and not dated:
        # of several whole days the one that the offset means
        gps_ns = (
            gps_ns
            - np.round((gps_ns - instrument_ns - offset_ns) / (2 * _HALF_DAY_NS)).astype(np.int64)
            * 2
            * _HALF_DAY_NS
        )
    time_ns, first = np.unique(gps_ns, return_index=True)
    return Fixes(time_ns, longitude[first], latitude[first], offset_ns, n_bad)


def _raw_fixes(dataset: Any) -> tuple[NDArray[Any], ...]:
    """Return GPS time and instrument's clock [ns], longitude, latitude, and whether each is a fix, shape (n,) each."""
    gps, instrument = (
        dataset[name].values.astype("datetime64[us]").astype(np.int64)
        for name in ("time_gps", "hdwtime_gps")
    )
    longitude, latitude = (
        np.asarray(dataset[f"{name}_gps"].values, dtype=np.float64)
        for name in ("longitude", "latitude")
    )
    good = np.isfinite(longitude + latitude) & ((longitude != 0.0) | (latitude != 0.0))
    if "fix_gps" in dataset:
        good &= dataset["fix_gps"].values > 0
    # to the millisecond: MHKiT carries seconds as floats
    gps_ns, instrument_ns = (
        np.round(values / 1000).astype(np.int64) * 1_000_000 for values in (gps, instrument)
    )
    return gps_ns, instrument_ns, longitude, latitude, good


def clock_offset_ns(
    gps_ns: NDArray[np.int64], instrument_ns: NDArray[np.int64], dated: bool
) -> int:
    """Return what is to be added to the instrument's clock to have UTC [ns]: the median over the fixes.

    Args:
        gps_ns: shape (n,), GPS time of each fix.
        instrument_ns: shape (n,), the instrument's clock when it was recorded.
        dated: Whether the GPS time has a date of its own; where it has the instrument's, the offset is known up to whole days and
            the one within half a day is returned.
    """
    difference = gps_ns - instrument_ns
    if not dated:
        difference = (difference + _HALF_DAY_NS) % (2 * _HALF_DAY_NS) - _HALF_DAY_NS
    return int(np.median(difference))


def declination_deg(time_ns: int, longitude: float, latitude: float) -> float | None:
    """Return the magnetic declination [degrees, positive east] by the World Magnetic Model of the time; None before 2010.

    Places are rounded to a tenth of a degree and times to a tenth of a year, over which it changes by less than a compass resolves.
    """
    year = datetime.fromtimestamp(time_ns // _NS, UTC)
    return _declination(
        round(year.year + (year.timetuple().tm_yday - 1) / 366.0, 1),
        round(longitude, 1),
        round(latitude, 1),
    )


@lru_cache(maxsize=1024)
def _declination(year: float, longitude: float, latitude: float) -> float | None:
    from pygeomag import GeoMag

    # models of five years each: the first that covers the year; none does before 2010
    for file in ("WMM_2010", "WMM_2015v2", "WMM_2020", "WMM_2025"):
        model = GeoMag(coefficients_file=f"wmm/{file}.COF")
        low, high = model.life_span
        if low <= year <= high:
            return round(
                float(model.calculate(glat=latitude, glon=longitude, alt=0.0, time=year).d), 2
            )
    return None
