"""Reader of Slocum binary files: segments of one glider as two tables, flight and science, of samples, fixes and mean currents."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array, Mask
from replay_kit.core.errors import LogError
from replay_kit.core.message import Loss
from replay_kit.logs.netcdf.columns import rows_of, stacked_tables
from replay_kit.logs.netcdf.dialects import SLOCUM_BINARY, log_of_columns
from replay_kit.logs.netcdf.units import from_minutes
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.reader import LogFile, Told, WholeLog, read_bytes
from replay_kit.logs.slocum.cycles import (
    FLIGHT,
    SCIENCE,
    Header,
    first_header,
    read_cycles,
    read_header,
    sensor_list,
    sensors_of,
    unpacked_file,
)

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
_TRACK = (*_PLACE, *_DEPTHS, *_ATTITUDE, *_OTHERS, *_WAYPOINT)
_CTD = ("sci_water_pressure", "sci_water_temp", "sci_water_cond")
#: All sensors that are read.
WANTED = frozenset((*CLOCKS, *_FIX, *_QUALITY, *_TRACK, *_CTD)).union(*CURRENTS)
# s; between values how far apart depths and positions are interpolated
_BETWEEN_DEPTHS, _BETWEEN_PLACES = 180.0, 1800.0
# m; a dive was deeper
_DEEP = 3.0
# horizontal dilution of precision; with more a position is not used
_LARGEST_HDOP = 20.0
_EPOCH = {"units": "seconds since 1970-01-01"}
_DEGREES = {"units": "degrees"}
_GPS_FLAGS: dict[str, Any] = {
    "flag_values": [1, 2],
    "flag_meanings": "bad_status bad_dilution_of_precision",
}


class Rows(NamedTuple):
    """Cycles of one computer.

    Attributes:
        time: shape (n,) [s since 1970].
        held: Last value of each sensor by cycle, shape (n,).
        written: State of each sensor by cycle, shape (n,): 0 not written, 1 unchanged, 2 new value.
        units: Unit of each sensor.
    """

    time: Array
    held: Mapping[str, Array]
    written: Mapping[str, NDArray[np.uint8]]
    units: Mapping[str, str]

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """Return the cycles of several files in order of time; missing sensors count as not written."""
        held = stacked_tables([{"time": part.time, **part.held} for part in parts])
        written = stacked_tables([{"time": part.time, **part.written} for part in parts], 0)
        order = np.argsort(held["time"], kind="stable")
        held, written = rows_of(held, order), rows_of(written, order)
        units = {name: unit for part in parts for name, unit in part.units.items()}
        return cls(held.pop("time"), held, written, units)

    def has(self, names: Sequence[str]) -> bool:
        """Return whether all these sensors exist."""
        return self.held.keys() >= {*names}

    def among(self, names: Sequence[str]) -> list[str]:
        """Return those of these sensors that exist."""
        return [name for name in names if name in self.held]

    def any_written(self, names: Sequence[str], least: int = 1) -> Mask:
        """Return the cycles in which any of some sensors is written; with 2, with a new value."""
        found = np.zeros(self.time.size, np.bool_)
        for name in self.among(names):
            found |= self.written[name] >= least
        return found

    def now(self, name: str) -> Array:
        """Return a sensor's values, NaN where not written."""
        return np.where(self.written[name] > 0, self.held[name], np.nan)

    def degrees(self, name: str) -> Array:
        """Return a latitude or longitude [degrees]; NaN for invalid values, such as 69696969."""
        values = from_minutes(self.held[name])
        return np.where(np.abs(values) <= (90.0 if name.endswith("lat") else 360.0), values, np.nan)


def science_table(rows: Rows, notes: list[str]) -> dict[str, Stored]:
    """Return pressure, temperature and conductivity at the cycles that write any of them.

    Args:
        rows: Cycles.
        notes: Receives notes on assumptions.
    """
    at = rows.any_written(_CTD)
    values = {name: rows.now(name)[at] for name in rows.among(_CTD)}
    if rows.has((_CTD[0], _CTD[2])):
        off = (values["sci_water_pressure"] == 0.0) & (values["sci_water_cond"] == 0.0)
        if off.any():
            notes.append(
                f"sci_water_pressure: {int(off.sum())} of exactly 0 with a conductivity of 0 taken as missing: the CTD was off"
            )
        values = {name: np.where(off, np.nan, found) for name, found in values.items()}
    stored = {name: (found, {"units": rows.units[name]}) for name, found in values.items()}
    return _stored("cycle", {"sci_m_present_time": (rows.time[at], _EPOCH), **stored})


def _stored(
    dim: str, columns: Mapping[str, tuple[NDArray[Any], Mapping[str, Any]]]
) -> dict[str, Stored]:
    return {name: Stored(values, about, (dim,)) for name, (values, about) in columns.items()}


def flight_table(rows: Rows, notes: list[str]) -> dict[str, Stored]:
    """Return samples along the track, fixes and mean currents.

    Args:
        rows: Cycles.
        notes: Receives notes on assumptions.
    """
    fixes: dict[str, Stored] = {}
    if rows.has(_FIX):
        # each once: cycles with a new latitude or longitude
        at = rows.any_written(_FIX, 2)
        status, dilution = (rows.held.get(name, np.zeros(rows.time.size))[at] for name in _QUALITY)
        flags = np.where(status > 0.0, 1, np.where(dilution > _LARGEST_HDOP, 2, 0))
        places = {name: (rows.degrees(name)[at], _DEGREES) for name in _FIX}
        flagged = {"m_gps_status": (flags, _GPS_FLAGS)}
        fixes = _stored("fix", {"gps_time": (rows.time[at], _EPOCH), **places, **flagged})
    track = rows.any_written(_TRACK)
    time = rows.time[track]
    samples = {name: rows.now(name)[track] for name in rows.among((*_ATTITUDE, *_OTHERS))}
    for depth in rows.among(_DEPTHS)[:1]:
        known = np.isfinite(rows.now(depth))
        samples[depth] = _between(time, rows.time[known], rows.held[depth][known], _BETWEEN_DEPTHS)
    degrees = rows.among((*_PLACE, *_FIX, *_WAYPOINT))
    if rows.has(_WAYPOINT):
        aimed = rows.any_written(_WAYPOINT)
        samples |= {n: np.where(aimed, rows.degrees(n), np.nan)[track] for n in _WAYPOINT}
    if rows.has(_PLACE):
        samples |= _places(rows, time, fixes, notes)
    about = {name: {"units": rows.units[name], "positive": "down"} for name in samples}
    about |= {name: about[name] | _DEGREES for name in degrees if name in samples}
    if degrees:
        notes.append(f"{', '.join(degrees)}: degrees and minutes (ddmm.mmm) converted to degrees")
    stored = {name: (values, about[name]) for name, values in samples.items()}
    table = _stored("cycle", {"m_present_time": (time, _EPOCH), **stored})
    return table | fixes | _currents(rows)


def _places(
    rows: Rows, time: Array, fixes: Mapping[str, Stored], notes: list[str]
) -> dict[str, Array]:
    """Return dead-reckoned positions at some times, interpolated between written ones and from a fix to the next.

    The last one of a dive is not interpolated to the fix after it, which shows the error of dead reckoning.
    """
    known = np.column_stack([rows.time, *map(rows.degrees, _PLACE)])[rows.any_written(_PLACE)]
    n_computed = len(known)
    if fixes:
        good = fixes["m_gps_status"].values == 0
        more = np.column_stack([fixes[name].values for name in ("gps_time", *_FIX)])[good]
        known = np.vstack([known, more])
    order = np.argsort(known[:, 0], kind="stable")
    order = order[np.isfinite(known[order]).all(axis=1)]
    known, is_fix = known[order], order >= n_computed
    if not known.size:
        return {name: np.full(time.size, np.nan) for name in _PLACE}
    notes.append(
        f"{', '.join(_PLACE)}: {n_computed} dead-reckoned positions, interpolated in time in each dive"
    )
    after = np.minimum(np.searchsorted(known[:, 0], time), len(known) - 1)
    latitude, longitude = (
        np.where(is_fix[after], np.nan, _between(time, known[:, 0], values, _BETWEEN_PLACES))
        for values in (known[:, 1], np.unwrap(known[:, 2], period=360.0))
    )
    longitude = np.where(np.abs(longitude) > 180.0, (longitude + 180.0) % 360.0 - 180.0, longitude)
    return dict(zip(_PLACE, (latitude, longitude), strict=True))


def _between(time: Array, known: Array, values: Array, longest: float) -> Array:
    """Return values interpolated at some times between known ones at most ``longest`` apart [s]; NaN elsewhere."""
    if not known.size:
        return np.full(time.size, np.nan)
    after = np.clip(np.searchsorted(known, time), 0, known.size - 1)
    before = np.maximum(np.where(known[after] > time, after - 1, after), 0)
    inside = (known[before] <= time) & (known[after] >= time)
    near = inside & (known[after] - known[before] <= longest)
    return np.where(near, np.interp(time, known, values), np.nan)


def _currents(rows: Rows) -> dict[str, Stored]:
    """Return new mean currents in order of precedence, each at the last sample of its dive.

    The glider computes a dive's mean current at the surface and corrects it with later fixes. One corrected at the start of a file is
    written as unchanged, so that any different value counts as new.
    """
    reports = []
    for pair in filter(rows.has, CURRENTS):
        table = np.column_stack([rows.time, *(rows.held[name] for name in pair)])
        written = np.flatnonzero(rows.any_written(pair))
        new = rows.any_written(pair, 2)
        differs = (np.diff(table[written, 1:], axis=0) != 0.0).any(axis=1)
        new[written] |= np.r_[True, differs][: written.size]
        reports.append(table[new])
    if not sum(map(len, reports)):
        return {}
    time, east, north = np.concatenate(reports).T
    within = time
    for depth in rows.among(_DEPTHS)[:1]:
        # one bar of pressure is ten metres of depth
        scale = 10.0 if depth == "m_pressure" else 1.0
        deep = rows.time[rows.now(depth) * scale > _DEEP]
        before = np.searchsorted(deep, time) - 1
        within = np.where(before >= 0, np.append(deep, np.nan)[before], time)
    about = {"units": next(rows.units[x] for x, _ in CURRENTS if x in rows.units)}
    columns = {"report_time": (within, _EPOCH), "m_water_vx": (east, about)}
    return _stored("report", columns | {"m_water_vy": (north, about)})


# s; a cycle whose time is farther from the others of its file had a wrong clock, or is damaged
_FAR = 30 * 86_400.0


class Segment(NamedTuple):
    """Contents of one file.

    Attributes:
        header: Header.
        rows: Values of its sensors.
        losses: Damaged parts.
        out_of_time: Number of cycles excluded for inconsistent times.
    """

    header: Header
    rows: Rows
    losses: tuple[Loss, ...]
    out_of_time: int


def read_segment(path: Path, caches: Path | None, list_of: Callable[[Path], bytes]) -> Segment:
    """Return the contents of a file.

    The first cycle repeats earlier values and is skipped.

    Args:
        path: Binary file.
        caches: As in ``sensors_of``, as the next one.
        list_of: Returns the contents of a cache.

    Raises:
        LogError: The file or its list of sensors cannot be read.
    """
    stored = read_bytes(path)
    data, lost_at = unpacked_file(stored)
    header = read_header(path, data)
    sensors, at = sensors_of(header, data, caches, list_of)
    cycles = read_cycles(data, at, sensors, WANTED)
    where = "decompressed byte" if len(data) != len(stored) else "byte"
    losses = [
        (f"{lost.what} at {where} {lost.offset}", lost.offset, lost.size) for lost in cycles.lost
    ]
    if lost_at >= 0:
        what = f"the compressed block at byte {lost_at} is damaged, and what follows is lost"
        losses = [(what, lost_at, len(stored) - lost_at)]
    clock = CLOCKS[header.is_science]
    if not cycles.lost and clock not in cycles.values:
        losses.append((f"{clock} is not among its sensors", at, len(data) - at))
    time = cycles.values.get(clock, np.empty(0))[1:]
    timed = time > 0.0
    near = timed & (np.abs(time - (np.median(time[timed]) if timed.any() else 0.0)) < _FAR)
    rows = Rows(
        time[near],
        {name: values[1:][near] for name, values in cycles.values.items()},
        {name: written[1:][near] for name, written in cycles.written.items()},
        {sensor.name: sensor.unit for sensor in sensors if sensor.name in cycles.values},
    )
    told = tuple(Loss(f"{path.name}: {what}", *place) for what, *place in losses)
    return Segment(header, rows, told, int((~near).sum()))


def logs_of_slocums(paths: Sequence[Path], config: LogConfig | None) -> list[LogFile]:
    """Return the readers of binary files, one per glider.

    Args:
        paths: Binary files; those whose header cannot be read count as the first glider's.
        config: Settings of log reading; ``caches`` is the folder of the sensor lists.

    Raises:
        LogError: No file of a glider can be read.
    """
    gliders = defaultdict[str, dict[Path, Header | None]](dict)
    for path in paths:
        header = first_header(path)
        gliders["" if header is None else header.vehicle][path] = header
    damaged = gliders.pop("", {}) if len(gliders) > 1 else {}
    next(iter(gliders.values())).update(damaged)
    return [_log(files, config) for files in gliders.values()]


def _log(files: Mapping[Path, Header | None], config: LogConfig | None) -> WholeLog:
    """Return the reader of the files of one glider, with their headers where these can be read."""
    caches = None if config is None or config.caches is None else Path(config.caches)
    # the files of a mission have few lists
    list_of = cache(sensor_list)
    segments: list[Segment] = []
    errors: dict[Path, LogError] = {}
    notes: list[str] = []
    for file in _without_subsets(files, notes):
        try:
            segments.append(read_segment(file, caches, list_of))
        except LogError as error:
            errors[file] = error
    if not segments:
        raise next(iter(errors.values()))
    segments.sort(key=lambda segment: segment.header.order)
    losses = [loss for segment in segments for loss in segment.losses]
    losses += [Loss(f"{error}; not used", 0, file.stat().st_size) for file, error in errors.items()]
    flight, science = (
        [segment for segment in segments if segment.header.is_science == which]
        for which in (False, True)
    )
    names, others = ({segment.header.segment for segment in part} for part in (flight, science))
    for computer, lacking in (("flight", others - names), ("science", names - others)):
        if lacking:
            notes.append(
                f"{len(lacking)} of {len(names | others)} segments without the file of the {computer} computer"
            )
    parts = [_joined(part, notes) for part in (flight, science) if part]
    return log_of_columns(parts, SLOCUM_BINARY, Told(notes, losses=losses), config)


def _without_subsets(files: Mapping[Path, Header | None], notes: list[str]) -> list[Path]:
    """Return the files without those of sensor subsets: one per segment and computer, with all sensors if possible."""
    alike = defaultdict[Any, list[Path]](list)
    for path, header in files.items():
        # what is wrong is said where it is read
        alike[(header.segment, header.is_science) if header else path].append(path)
    ranked = [sorted(paths, key=_rank) for paths in alike.values()]
    left_out = [path for _, *others in ranked for path in others]
    if left_out:
        notes.append(
            f"{len(left_out)} files with fewer sensors of segments that are there with more, such as {left_out[0].name}: not used"
        )
    return [first for first, *_ in ranked]


def _rank(path: Path) -> int:
    """Return the rank of a file among those of one segment and computer, the one with most sensors first."""
    ending = path.suffix.lower()
    return next((part.index(ending) for part in (FLIGHT, SCIENCE) if ending in part), len(FLIGHT))


def _joined(parts: Sequence[Segment], notes: list[str]) -> NetcdfFile:
    """Return the joined files of one computer in order of time."""
    is_science = parts[0].header.is_science
    rows = Rows.joined([part.rows for part in parts])
    for pair in CURRENTS:
        lacking = [part.header.path.name for part in parts if not {*pair} <= part.rows.units.keys()]
        if rows.has(pair) and lacking:
            notes.append(
                f"{', '.join(pair)}: not among the sensors of {len(lacking)} of {len(parts)} files, such as {lacking[0]}"
            )
    if late := sum(part.out_of_time for part in parts):
        notes.append(
            f"{CLOCKS[is_science]}: {late} cycles without a time, or 30 days from the others of their file, excluded"
        )
    first = parts[0].header
    return NetcdfFile(
        first.path,
        {"deployment_name": first.vehicle},
        (science_table if is_science else flight_table)(rows, notes),
        tuple(rows.units),
        tuple(part.header.path for part in parts),
    )
