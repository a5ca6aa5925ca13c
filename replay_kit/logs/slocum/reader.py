"""Reader of Slocum binary files: segments of one glider as two tables, flight and science."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import Loss
from replay_kit.logs.netcdf.glider_dialects import SLOCUM_BINARY
from replay_kit.logs.netcdf.reader import log_of_columns
from replay_kit.logs.netcdf.variables import NetcdfFile
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
    unpacked,
)
from replay_kit.logs.slocum.tables import (
    CLOCKS,
    CURRENTS,
    WANTED,
    Rows,
    flight_table,
    science_table,
)

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
    data, lost_at = unpacked(stored)
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
