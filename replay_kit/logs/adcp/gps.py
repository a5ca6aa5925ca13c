"""What a vessel's GPS determines in a raw ADCP file: the clock's offset and the magnetic declination."""

from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_NS = 1_000_000_000
_HALF_DAY_NS = 43_200 * _NS


def clock_offset_ns(gps_ns: NDArray[np.int64], instrument_ns: NDArray[np.int64], dated: bool) -> int:
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
    return _declination(round(year.year + (year.timetuple().tm_yday - 1) / 366.0, 1), round(longitude, 1), round(latitude, 1))


@lru_cache(maxsize=1024)
def _declination(year: float, longitude: float, latitude: float) -> float | None:
    from pygeomag import GeoMag

    # models of five years each: the first that covers the year; none does before 2010
    for file in ("WMM_2010", "WMM_2015v2", "WMM_2020", "WMM_2025"):
        model = GeoMag(coefficients_file=f"wmm/{file}.COF")
        low, high = model.life_span
        if low <= year <= high:
            return round(float(model.calculate(glat=latitude, glon=longitude, alt=0.0, time=year).d), 2)
    return None
