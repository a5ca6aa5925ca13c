"""What a vessel's GPS says in a raw ADCP file: the clock's offset, the fixes, the vessel's velocity, the magnetic declination."""

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from replay_kit.geodesy import rotate_to_geographic, to_local
from replay_kit.types import Array, Projection

_NS = 1_000_000_000
_HALF_DAY_NS = 43_200 * _NS
_WINDOW_S = 20.0  # fixes this far from a ping, before and after, give the vessel's velocity
_LEAST_FIXES = 3
_FIX_ERROR = 0.5  # m; noise of a fix against its neighbours, and the rounding of 32-bit degrees, at the least


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A vessel's fixes.

    Attributes:
        time_ns: shape (n,) [ns, UTC], increasing.
        longitude: shape (n,) [degrees east].
        latitude: shape (n,) [degrees north].
    """

    time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array


def clock_offset_ns(gps_ns: NDArray[np.int64], instrument_ns: NDArray[np.int64], dated: bool) -> int:
    """Return what is to be added to the instrument's clock to have UTC [ns]: the median over the fixes.

    Args:
        gps_ns: shape (n,), GPS time of each fix.
        instrument_ns: shape (n,), the instrument's clock when it was recorded.
        dated: Whether the GPS time has a date of its own; where it took the instrument's, the offset is known but for whole
            days and the one within half a day is meant.
    """
    difference = gps_ns - instrument_ns
    if not dated:
        difference = (difference + _HALF_DAY_NS) % (2 * _HALF_DAY_NS) - _HALF_DAY_NS
    return int(np.median(difference))


def vessel_velocity(time_ns: NDArray[np.int64], track: Track) -> tuple[Array, Array]:
    """Return the vessel's velocity over the ground at each time, shape (n, 2) [m/s], and its standard error, shape (n,).

    The slope of a straight line through the fixes within 20 s, by least squares; its error comes from how far the fixes lie from
    the line, so that a turning vessel's is larger. NaN where fewer than three fixes are so near.

    Args:
        time_ns: shape (n,) [ns, UTC].
        track: The fixes.
    """
    velocity, error = np.full((time_ns.size, 2), np.nan), np.full(time_ns.size, np.nan)
    if track.time_ns.size < _LEAST_FIXES:
        return velocity, error
    projection = Projection(float(track.longitude[0]), float(track.latitude[0]))
    place = np.column_stack(to_local(projection, track.longitude, track.latitude))
    window_ns = int(_WINDOW_S * _NS)
    first = np.searchsorted(track.time_ns, time_ns - window_ns)
    last = np.searchsorted(track.time_ns, time_ns + window_ns, side="right")
    for k in np.flatnonzero(last - first >= _LEAST_FIXES):
        near = slice(first[k], last[k])
        since = (track.time_ns[near] - time_ns[k]) / _NS
        velocity[k], error[k] = _slope(since, place[near])
    # the local axes are not quite true east and north away from the first fix
    nearest = np.clip(np.searchsorted(track.time_ns, time_ns), 0, track.time_ns.size - 1)
    longitude, latitude = track.longitude[nearest], track.latitude[nearest]
    return np.column_stack(rotate_to_geographic(projection, longitude, latitude, velocity[:, 0], velocity[:, 1])), error


def _slope(since: Array, place: Array) -> tuple[Array, float]:
    """Return the slope of positions, shape (n, 2), in time, and its standard error."""
    t = since - since.mean()
    spread = float(t @ t)
    slope = t @ place / spread
    residual = place - place.mean(axis=0) - t[:, None] * slope
    scatter = np.sqrt(np.sum(residual**2) / (2 * (since.size - 2)))
    return slope, float(max(scatter, _FIX_ERROR) / np.sqrt(spread))


def declination_deg(time_ns: int, longitude: float, latitude: float) -> float | None:
    """Return the magnetic declination [degrees, positive east] by the World Magnetic Model of the time; None before 2010.

    Places are rounded to a tenth of a degree and times to a tenth of a year, over which it changes by less than a compass knows.
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
