"""Values of a Slocum's sensors as columns of a glider file: samples, fixes, mean currents."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.logs.netcdf.units import from_minutes
from replay_kit.logs.netcdf.variables import Stored

#: The sensors with the time of a cycle [s since 1970], of the flight and the science computer.
CLOCKS = ("m_present_time", "sci_m_present_time")
_FIX = ("m_gps_lat", "m_gps_lon")
_QUALITY = ("m_gps_status", "m_gps_hdop")
#: Estimates of a dive's mean current, the better ones later
CURRENTS = (
    ("m_initial_water_vx", "m_initial_water_vy"),
    ("m_water_vx", "m_water_vy"),
    ("m_final_water_vx", "m_final_water_vy"),
)
_PLACE = ("m_lat", "m_lon")
_DEPTHS = ("m_depth", "m_pressure")
_ATTITUDE = ("m_heading", "m_pitch", "m_roll", "m_gps_mag_var")
_OTHERS = ("m_altitude", "m_water_depth", "m_battery", "m_coulomb_amphr_total")
_WAYPOINT = ("c_wpt_lat", "c_wpt_lon")
_CTD = ("sci_water_pressure", "sci_water_temp", "sci_water_cond")
#: All sensors that are read.
WANTED = frozenset(
    (*CLOCKS, *_FIX, *_QUALITY, *_PLACE, *_DEPTHS, *_ATTITUDE, *_OTHERS, *_WAYPOINT, *_CTD)
) | {name for pair in CURRENTS for name in pair}
# s; how long an attitude counts, and between which values depths and positions are interpolated
_ATTITUDE_HOLDS, _BETWEEN_DEPTHS, _BETWEEN_PLACES = 60.0, 180.0, 1800.0
# m; a dive was deeper
_DEEP = 3.0
# horizontal dilution of precision; with more a position is not used
_LARGEST_HDOP = 20.0
_EPOCH = {"units": "seconds since 1970-01-01"}
_GPS_FLAGS = {"flag_values": [1, 2], "flag_meanings": "bad_status bad_dilution_of_precision"}


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Cycles of one computer.

    Attributes:
        time: shape (n,) [s since 1970].
        held: Last value of each sensor by cycle, shape (n,).
        written: State of each sensor by cycle, shape (n,): 0 not written, 1 unchanged, 2 new value.
    """

    time: Array
    held: Mapping[str, Array]
    written: Mapping[str, NDArray[np.uint8]]

    @classmethod
    def joined(cls, parts: Sequence["Rows"], names: Sequence[str]) -> "Rows":
        """Return the cycles of several files in order of time; missing sensors count as not written."""
        time = np.concatenate([part.time for part in parts])
        order = np.argsort(time, kind="stable")
        held, written = (
            {
                name: np.concatenate(
                    [
                        getattr(part, column).get(name, np.full(part.time.size, empty))
                        for part in parts
                    ]
                )[order]
                for name in names
            }
            for column, empty in (("held", np.nan), ("written", np.uint8(0)))
        )
        return cls(time[order], held, written)

    def has(self, names: Sequence[str]) -> bool:
        """Return whether all these sensors exist."""
        return set(names) <= set(self.held)

    def any_written(self, names: Sequence[str], least: int = 1) -> NDArray[np.bool_]:
        """Return the cycles in which any of some sensors is written; with 2, with a new value."""
        found = np.zeros(self.time.size, np.bool_)
        for name in names:
            if name in self.written:
                found |= self.written[name] >= least
        return found

    def now(self, name: str) -> Array:
        """Return a sensor's values, NaN where not written."""
        return np.where(self.written[name] > 0, self.held[name], np.nan)


def science_table(rows: Rows, units: Mapping[str, str], notes: list[str]) -> dict[str, Stored]:
    """Return pressure, temperature and conductivity at the cycles that write any of them.

    Args:
        rows: Cycles.
        units: Units by sensor.
        notes: Receives notes on assumptions.
    """
    names = [name for name in _CTD if name in rows.held]
    at = np.flatnonzero(rows.any_written(names))
    values = {name: rows.now(name)[at] for name in names}
    if rows.has(("sci_water_pressure", "sci_water_cond")):
        off = (values["sci_water_pressure"] == 0.0) & (values["sci_water_cond"] == 0.0)
        if off.any():
            notes.append(
                f"sci_water_pressure: {int(off.sum())} of exactly 0 with a conductivity of 0 taken as missing: the CTD was off"
            )
        values = {name: np.where(off, np.nan, found) for name, found in values.items()}
    return {"sci_m_present_time": Stored(rows.time[at], _EPOCH, ("cycle",))} | {
        name: Stored(found, {"units": units[name]}, ("cycle",)) for name, found in values.items()
    }


def flight_table(rows: Rows, units: Mapping[str, str], notes: list[str]) -> dict[str, Stored]:
    """Return samples along the track, fixes and mean currents.

    Args:
        rows: Cycles.
        units: Units by sensor.
        notes: Receives notes on assumptions.
    """
    found = _fixes(rows)
    at = np.flatnonzero(rows.any_written((*_PLACE, *_DEPTHS, *_ATTITUDE, *_OTHERS, *_WAYPOINT)))
    time = rows.time[at]
    samples: dict[str, Array] = {name: rows.now(name)[at] for name in _OTHERS if name in rows.held}
    samples |= {name: _recent_values(rows, name)[at] for name in _ATTITUDE if name in rows.held}
    if depth := next((name for name in _DEPTHS if name in rows.held), ""):
        known = np.isfinite(rows.now(depth))
        samples[depth] = _between(time, rows.time[known], rows.held[depth][known], _BETWEEN_DEPTHS)
    degrees = {
        name: {"units": "degrees"} for name in (*_PLACE, *_FIX, *_WAYPOINT) if name in rows.held
    }
    if rows.has(_WAYPOINT):
        aimed = rows.any_written(_WAYPOINT)[at]
        samples |= {name: np.where(aimed, _degrees(rows, name)[at], np.nan) for name in _WAYPOINT}
    if rows.has(_PLACE):
        samples |= _places(rows, time, found, notes)
    table = {
        "m_present_time": Stored(time, _EPOCH, ("cycle",)),
        **{
            name: Stored(
                values,
                {"units": units[name], "positive": "down"} | degrees.get(name, {}),
                ("cycle",),
            )
            for name, values in samples.items()
        },
    }
    if degrees:
        notes.append(f"{', '.join(degrees)}: degrees and minutes (ddmm.mmm) converted to degrees")
    return table | found | _currents(rows, units)


def _degrees(rows: Rows, name: str) -> Array:
    """Return a latitude or longitude [degrees]; NaN for invalid values, such as 69696969."""
    values = from_minutes(rows.held[name])
    return np.where(np.abs(values) <= (90.0 if name.endswith("lat") else 360.0), values, np.nan)


def _fixes(rows: Rows) -> dict[str, Stored]:
    """Return the fixes, each once: cycles with a new latitude or longitude."""
    if not rows.has(_FIX):
        return {}
    at = np.flatnonzero(rows.any_written(_FIX, 2))
    status, dilution = (rows.held.get(name, np.zeros(rows.time.size))[at] for name in _QUALITY)
    flags = np.where(status > 0.0, 1, np.where(dilution > _LARGEST_HDOP, 2, 0))
    return {
        "gps_time": Stored(rows.time[at], _EPOCH, ("fix",)),
        "m_gps_status": Stored(flags, _GPS_FLAGS, ("fix",)),
        **{name: Stored(_degrees(rows, name)[at], {"units": "degrees"}, ("fix",)) for name in _FIX},
    }


def _places(
    rows: Rows, time: Array, fixes: Mapping[str, Stored], notes: list[str]
) -> dict[str, Array]:
    """Return dead-reckoned positions at some times, interpolated between written ones and from a fix to the next.

    The last one of a dive is not interpolated to the fix after it, which shows the error of dead reckoning.
    """
    computed = rows.any_written(_PLACE)
    known = np.column_stack([rows.time, *(_degrees(rows, name) for name in _PLACE)])[computed]
    n_computed = len(known)
    if fixes:
        good = fixes["m_gps_status"].values == 0
        known = np.vstack(
            [known, np.column_stack([fixes[name].values for name in ("gps_time", *_FIX)])[good]]
        )
    is_fix = np.arange(len(known)) >= n_computed
    order = np.flatnonzero(np.isfinite(known).all(axis=1))
    order = order[np.argsort(known[order, 0], kind="stable")]
    known, is_fix = known[order], is_fix[order]
    if not known.size:
        return {name: np.full(time.size, np.nan) for name in _PLACE}
    after = np.minimum(np.searchsorted(known[:, 0], time), len(known) - 1)
    latitude, longitude = (
        _between(time, known[:, 0], values, _BETWEEN_PLACES)
        for values in (known[:, 1], np.unwrap(known[:, 2], period=360.0))
    )
    longitude = np.where(np.abs(longitude) > 180.0, (longitude + 180.0) % 360.0 - 180.0, longitude)
    usable = ~is_fix[after]
    notes.append(
        f"{', '.join(_PLACE)}: {n_computed} dead-reckoned positions, interpolated in time to the other samples of a dive"
    )
    return dict(
        zip(_PLACE, (np.where(usable, v, np.nan) for v in (latitude, longitude)), strict=True)
    )


def _between(time: Array, known: Array, values: Array, longest: float) -> Array:
    """Return values interpolated at some times between known ones at most ``longest`` apart [s]; NaN elsewhere."""
    if not known.size:
        return np.full(time.size, np.nan)
    after = np.clip(np.searchsorted(known, time), 0, known.size - 1)
    before = np.maximum(np.where(known[after] > time, after - 1, after), 0)
    inside = (known[before] <= time) & (known[after] >= time)
    near = inside & (known[after] - known[before] <= longest)
    return np.where(near, np.interp(time, known, values), np.nan)


def _recent_values(rows: Rows, name: str) -> Array:
    """Return the last value of a sensor written within a minute; NaN without one."""
    cycle = np.arange(rows.time.size)
    last = np.maximum.accumulate(np.where(rows.written[name] > 0, cycle, -1))
    recent = (last >= 0) & (rows.time - rows.time[last] <= _ATTITUDE_HOLDS)
    return np.where(recent, rows.held[name][last], np.nan)


def _currents(rows: Rows, units: Mapping[str, str]) -> dict[str, Stored]:
    """Return new mean currents in order of precedence, each at the last sample of its dive.

    The glider computes a dive's mean current at the surface and corrects it with later fixes. One corrected at the start of a file is
    written as unchanged, so that any different value counts as new.
    """
    reports = [
        np.column_stack([rows.time, rows.held[x], rows.held[y]])[_is_new(rows, (x, y))]
        for x, y in CURRENTS
        if rows.has((x, y))
    ]
    if not sum(map(len, reports)):
        return {}
    time, east, north = np.concatenate(reports).T
    depth = next((name for name in _DEPTHS if name in rows.held), "")
    # one bar of pressure is ten metres of depth
    scale = 10.0 if depth == "m_pressure" else 1.0
    deep = rows.time[rows.now(depth) * scale > _DEEP] if depth else np.empty(0)
    before = np.searchsorted(deep, time) - 1
    within = np.where(before >= 0, deep[np.maximum(before, 0)] if deep.size else time, time)
    attributes = {"units": next(units[x] for x, _ in CURRENTS if x in units)}
    return {
        "report_time": Stored(within, _EPOCH, ("report",)),
        "m_water_vx": Stored(east, attributes, ("report",)),
        "m_water_vy": Stored(north, attributes, ("report",)),
    }


def _is_new(rows: Rows, names: Sequence[str]) -> NDArray[np.bool_]:
    """Return the cycles that write a new value of a sensor, or one that differs from the last written."""
    written = rows.any_written(names)
    table = np.column_stack([rows.held[name] for name in names])[written]
    differs = np.r_[True, (table[1:] != table[:-1]).any(axis=1)][: len(table)]
    new = rows.any_written(names, 2)
    new[written] |= differs
    return new
