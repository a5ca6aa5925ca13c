"""Fit of UTC to a clock that counts from boot, with late or wrong stamps excluded; and GPS time as UTC."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Times

#: In shorter logs the jitter of the stamps hides the drift of a quartz clock [ns].
_SPAN_FOR_DRIFT_NS = 600_000_000_000
#: No quartz clock drifts faster; a larger slope has another cause, which the residual shows.
_MAX_DRIFT = 1e-3
#: Pairs used for the slope: it is the median over all pairs of pairs.
_FOR_SLOPE = 400
#: Farther from the fit than this many robust standard deviations, and than the least step that stamps have [ns], a pair is an outlier.
_OUTLIER_STD = 5.0
_OUTLIER_NS = 1_000_000
#: A single stamp farther than this ahead of, or behind, both its neighbours is wrong [microseconds].
_SPIKE_US = 10_000_000
_GPS_EPOCH_NS = 315_964_800_000_000_000
_WEEK_MS = 604_800_000
#: First day of UTC on which GPS time is ahead by one second more (IERS, Bulletin C); none is announced after the last.
_LEAP_DAYS = """
1981-07-01 1982-07-01 1983-07-01 1985-07-01 1988-01-01 1990-01-01 1991-01-01 1992-07-01 1993-07-01
1994-07-01 1996-01-01 1997-07-01 1999-01-01 2006-01-01 2009-01-01 2012-07-01 2015-07-01 2017-01-01
"""
_LEAP_NS = np.array(_LEAP_DAYS.split(), dtype="datetime64[ns]").astype(np.int64)


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Linear fit of UTC to a clock that counts from boot.

    Attributes:
        boot_ns: Reference time on that clock [ns].
        utc_ns: UTC at that time [ns].
        drift: Rate at which UTC gains on the clock [s/s].
        residual_std: Standard deviation of the inliers [s].
        pairs: Number of pairs of stamps.
        outliers: Number of outliers among them.
    """

    boot_ns: int
    utc_ns: int
    drift: float
    residual_std: float
    pairs: int
    outliers: int

    def utc(self, boot_ns: Times) -> Times:
        """Return UTC [ns] at times on the vehicle's clock [ns]."""
        since = boot_ns - self.boot_ns
        utc_ns: Times = self.utc_ns + since + np.rint(self.drift * since).astype(np.int64)
        return utc_ns

    def __str__(self) -> str:
        drift = f", drift {1e6 * self.drift:.1f} ppm" if self.drift else ""
        return f"{self.pairs} pairs, {self.outliers} outliers, residual {1e3 * self.residual_std:.1f} ms{drift}"


def fit_clock(boot_ns: Times, utc_ns: Times) -> ClockFit:
    """Return the fit to pairs of stamps: median offset and, over at least ten minutes, the median slope (Theil and Sen).

    Args:
        boot_ns: Times on the vehicle's clock, shape (n,), n at least 1 [ns].
        utc_ns: UTC at these times [ns].
    """
    middle = int(np.median(boot_ns))
    since = boot_ns - middle
    offset = utc_ns - boot_ns
    # floats hold nanoseconds of a difference, not of a year
    base = int(np.sort(offset)[offset.size // 2])
    residual = (offset - base).astype(np.float64)
    drift = 0.0
    if np.ptp(boot_ns) >= _SPAN_FOR_DRIFT_NS:
        some = np.unique(np.linspace(0, offset.size - 1, _FOR_SLOPE).astype(np.int64))
        slope = _median_slope(since[some].astype(np.float64), residual[some])
        drift = slope if abs(slope) <= _MAX_DRIFT else 0.0
    residual -= drift * since
    centre = float(np.median(residual))
    residual -= centre
    robust_std = 1.4826 * float(np.median(np.abs(residual)))
    fits = np.abs(residual) <= max(_OUTLIER_STD * robust_std, _OUTLIER_NS)
    std = float(np.sqrt(np.mean(residual[fits] ** 2))) * 1e-9
    return ClockFit(
        middle, middle + base + round(centre), drift, std, offset.size, int(np.count_nonzero(~fits))
    )


def _median_slope(x: Array, y: Array) -> float:
    """Return the median slope of the lines through two points each (Theil, Sen), robust to outliers."""
    # scipy.stats has it too, but takes longer to import than a log takes to read
    first, second = np.triu_indices(x.size, 1)
    apart = x[second] != x[first]
    return float(np.median((y[second] - y[first])[apart] / (x[second] - x[first])[apart]))


def without_spikes(stamp_us: Times, before_us: int | None) -> tuple[Times, int]:
    """Return stamps with single outliers replaced by the next stamp, and the number of outliers.

    A stamp has no checksum: one flipped bit can put it years ahead, and all later messages would count as late. The last stamp, also of a
    reader's block, is kept.

    Args:
        stamp_us: Consecutive stamps, shape (n,) [microseconds].
        before_us: Previous stamp; None without one.
    """
    if stamp_us.size < 3:
        return stamp_us, 0
    before = stamp_us[:-1] - np.concatenate(
        [[stamp_us[2] if before_us is None else before_us], stamp_us[:-2]]
    )
    after = stamp_us[:-1] - stamp_us[1:]
    spikes = np.flatnonzero(
        (np.minimum(np.abs(before), np.abs(after)) > _SPIKE_US)
        & (np.sign(before) == np.sign(after))
    )
    steady = stamp_us.copy()
    steady[spikes] = stamp_us[spikes + 1]
    return steady, int(spikes.size)


def spikes_note(spikes: int) -> str:
    """Return the note on stamps that ``without_spikes`` replaced."""
    return f"{spikes} outlier stamps were replaced by the following stamp"


def gps_to_utc(week: NDArray[np.int64], week_ms: NDArray[np.int64]) -> Times:
    """Return UTC [ns] from GPS time, which has no leap seconds.

    Args:
        week: Weeks since 6 January 1980, not folded into 1024.
        week_ms: Milliseconds of the week.
    """
    gps_ns = _GPS_EPOCH_NS + (week * _WEEK_MS + week_ms) * 1_000_000
    return gps_ns - leap_seconds(gps_ns) * 10**9


def leap_seconds(gps_ns: Times) -> NDArray[np.int64]:
    """Return GPS time minus UTC [s] at times of GPS [ns since 1970]."""
    ahead = np.arange(1, _LEAP_NS.size + 1)
    return np.searchsorted(_LEAP_NS + ahead * 10**9, gps_ns, side="right").astype(np.int64)
