"""Reader of Slocum binary files: segments of one glider as two tables, flight and science."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.inputs import open_input
from replay_kit.core.message import Loss
from replay_kit.logs.netcdf.glider_dialects import SLOCUM_BINARY
from replay_kit.logs.netcdf.reader import ColumnsReader
from replay_kit.logs.netcdf.variables import NetcdfFile
from replay_kit.logs.reader import unreadable
from replay_kit.logs.slocum.cycles import read_cycles
from replay_kit.logs.slocum.header import (
    FLIGHT,
    SCIENCE,
    Header,
    SensorLists,
    first_header,
    read_header,
    read_sensors,
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
        units: Units of the sensors, by name.
        losses: Damaged parts.
        out_of_time: Number of cycles excluded for inconsistent times.
    """

    header: Header
    rows: Rows
    units: Mapping[str, str]
    losses: tuple[Loss, ...]
    out_of_time: int


def read_segment(path: Path, lists: SensorLists) -> Segment:
    """Return the contents of a file.

    The first cycle repeats earlier values and is skipped.

    Args:
        path: Binary file.
        lists: Caches of sensor lists.

    Raises:
        LogError: The file or its list of sensors cannot be read.
    """
    try:
        with open_input(path) as file:
            stored = file.read()
    except OSError as error:
        raise unreadable(path, error) from error
    data, lost_at = unpacked(stored)
    header = read_header(path, data)
    if header.cache:
        cache, text = lists.find(header)
        sensors, at = read_sensors(header, text, str(cache))[0], header.size
    else:
        sensors, length = read_sensors(header, data[header.size :], str(path))
        at = header.size + length
    cycles = read_cycles(data, at, sensors, WANTED)
    where = "decompressed byte" if len(data) != len(stored) else "byte"
    losses = [
        Loss(f"{path.name}: {lost.what} at {where} {lost.offset}", lost.offset, lost.size)
        for lost in cycles.lost
    ]
    if lost_at >= 0:
        what = f"{path.name}: the compressed block at byte {lost_at} is damaged, and what follows is lost"
        losses = [Loss(what, lost_at, len(stored) - lost_at)]
    clock = CLOCKS[header.is_science]
    time = cycles.values.get(clock, np.empty(0))
    if not cycles.lost and clock not in cycles.values:
        losses.append(Loss(f"{path.name}: {clock} is not among its sensors", at, len(data) - at))
    timed = np.isfinite(time) & (time > 0.0)
    middle = np.median(time[timed]) if timed.any() else 0.0
    near = timed & (np.abs(time - middle) < _FAR)
    kept = np.flatnonzero(near[1:]) + 1
    rows = Rows(
        time[kept],
        {name: values[kept] for name, values in cycles.values.items()},
        {name: written[kept] for name, written in cycles.written.items()},
    )
    units = {sensor.name: sensor.unit for sensor in sensors if sensor.name in cycles.values}
    return Segment(header, rows, units, tuple(losses), int(near[1:].size - kept.size))


def open_slocum(
    paths: Sequence[Path],
    input: int = 0,
    config: LogConfig | None = None,
    wanted: frozenset[str] | None = None,
) -> ColumnsReader:
    """Return the reader of the binary files of one Slocum.

    Args:
        paths: Binary files.
        input: Position of the log among the run's inputs.
        config: Settings of log reading; ``caches`` is the folder of the sensor lists.
        wanted: Ignored.

    Raises:
        LogError: No file can be read.
    """
    del wanted
    lists = SensorLists(None if config is None or config.caches is None else Path(config.caches))
    segments: list[Segment] = []
    errors: dict[Path, LogError] = {}
    notes: list[str] = []
    for file in _without_subsets(paths, notes):
        try:
            segments.append(read_segment(file, lists))
        except LogError as error:
            errors[file] = error
    if not segments:
        raise next(iter(errors.values()))
    segments.sort(key=lambda segment: (segment.header.number, segment.header.segment))
    losses = [loss for segment in segments for loss in segment.losses]
    losses += [Loss(f"{error}; not used", 0, file.stat().st_size) for file, error in errors.items()]
    notes += _missing_files(segments)
    parts = [
        part
        for is_science in (False, True)
        if (part := _joined(segments, is_science, notes)) is not None
    ]
    return ColumnsReader(parts, SLOCUM_BINARY, input, config, losses, notes)


def glider_of(path: Path) -> tuple[str, ...]:
    """Return the name of the glider of a file; empty if the header cannot be read."""
    try:
        return (first_header(path).vehicle,)
    except (LogError, OSError):
        return ()


def _without_subsets(paths: Sequence[Path], notes: list[str]) -> list[Path]:
    """Return the files without those of sensor subsets: one per segment and computer, with all sensors if possible."""
    best: dict[tuple[str, bool], Path] = {}
    unknown, left_out = [], []
    for path in paths:
        try:
            header = first_header(path)
        except (LogError, OSError):
            # what is wrong is said where it is read
            unknown.append(path)
            continue
        key = header.segment, header.is_science
        other = best.get(key)
        first = other is None or _rank(path) < _rank(other)
        if other is not None:
            left_out.append(other if first else path)
        if first:
            best[key] = path
    if left_out:
        notes.append(
            f"{len(left_out)} files with fewer sensors of segments that are there with more, such as {left_out[0].name}: not used"
        )
    return [*best.values(), *unknown]


def _rank(path: Path) -> int:
    """Return the rank of a file among those of one segment and computer, the one with most sensors first."""
    endings = (*zip(FLIGHT, SCIENCE, strict=True),)
    return next(
        (k % 3 * 2 + k // 3 for k, pair in enumerate(endings) if path.suffix.lower() in pair), 9
    )


def _missing_files(segments: Sequence[Segment]) -> list[str]:
    """Return a sentence on segments without files of one computer; empty if none."""
    flight, science = (
        {s.header.segment for s in segments if s.header.is_science == which}
        for which in (False, True)
    )
    lacking = (("flight", science - flight), ("science", flight - science))
    return [
        f"{len(names)} of {len(flight | science)} segments without the file of the {computer} computer"
        for computer, names in lacking
        if names
    ]


def _missing_sensors(parts: Sequence[Segment], units: Mapping[str, str]) -> Iterator[str]:
    """Yield sentences on sensors that some files of a computer lack and others have."""
    without: dict[tuple[str, ...], list[str]] = {}
    for part in parts:
        if lacks := tuple(name for name in units if name not in part.units):
            without.setdefault(lacks, []).append(part.header.path.name)
    for lacks, files in without.items():
        kept = units.keys() - set(lacks)
        means = any(set(pair) <= units.keys() for pair in CURRENTS)
        dives = (
            ""
            if not means or any(set(pair) <= kept for pair in CURRENTS)
            else "; their dives have no mean current"
        )
        yield f"{', '.join(lacks)}: not among the sensors of {len(files)} of {len(parts)} files, such as {files[0]}{dives}"


def _joined(segments: Sequence[Segment], is_science: bool, notes: list[str]) -> NetcdfFile | None:
    """Return the joined files of one computer in order of time; None without files."""
    parts = [segment for segment in segments if segment.header.is_science == is_science]
    if not parts:
        return None
    units = {name: unit for segment in parts for name, unit in segment.units.items()}
    notes += _missing_sensors(parts, units)
    rows = Rows.joined([segment.rows for segment in parts], list(units))
    if late := sum(segment.out_of_time for segment in parts):
        notes.append(
            f"{CLOCKS[is_science]}: {late} cycles without a time, or 30 days from the others of their file, excluded"
        )
    variables = (science_table if is_science else flight_table)(rows, units, notes)
    return NetcdfFile(
        parts[0].header.path,
        {"deployment_name": parts[0].header.vehicle},
        variables,
        tuple(units),
        tuple(segment.header.path for segment in parts),
    )
