"""Reader of ArduPilot's DataFlash logs (.BIN).

A record is the bytes a3 95, its type, and the fields that the FMT record of that type declares. There is no checksum: after bad bytes a
record counts only if another record or the end of the log follows it. The field letters are in ArduPilot's
``libraries/AP_Logger/README.md``; their factors are applied, units and multipliers (UNIT, MULT, FMTU) are not.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from mmap import ACCESS_READ, mmap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import ReadStatistics
from replay_kit.logs.shared.clock import (
    ClockFit,
    fit_clock,
    gps_to_utc,
    leap_seconds,
    spikes_note,
    without_spikes,
)

MAGIC = b"\xa3\x95"
_HEAD, _FMT_TYPE = 3, 0x80
# each letter as struct has it
_CODES: Mapping[str, str] = {
    **{letter: letter for letter in "bBhHiIfdqQ"},
    **{"a": "32h", "g": "e", "n": "4s", "N": "16s", "Z": "64s", "M": "B"},
    **{"c": "h", "C": "H", "e": "i", "E": "I", "L": "i"},
}
# of stored values: more exact than multiplying by a hundredth
_DIVISORS: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
#: A stamp of more [microseconds], three years after the start, is damage.
_MAX_BOOT_US = 10**14
_FIX_3D = 3
_GPS_TIME = ("TimeUS", "Status", "GWk", "GMS")
#: A GPS week in the year 2171, and still within int64 nanoseconds.
_MAX_WEEK = 10_000
#: Records of which the times are computed at once.
_BATCH = 4096


@dataclass(frozen=True)
class Format:
    """Record type declared by FMT.

    Attributes:
        type: Type number.
        name: ``GPS``, ``BARO`` and so on.
        length: Length of a record with its header [bytes].
        letters: Type letter of each column.
        columns: Column names.
    """

    type: int
    name: str
    length: int
    letters: str
    columns: tuple[str, ...]

    @cached_property
    def layout(self) -> struct.Struct | None:
        """Struct of the fields; None if a letter is unknown or the columns or length disagree."""
        if not len(self.letters) == len(self.columns) == len(set(self.columns)):
            return None
        if not set(self.letters) <= _CODES.keys():
            return None
        layout = struct.Struct("<" + "".join(_CODES[letter] for letter in self.letters))
        return layout if self.length == _HEAD + layout.size else None

    @cached_property
    def stamp(self) -> tuple[int, int] | None:
        """Index and unit [microseconds] of the field with the time since boot; None without one."""
        fields = [*zip(self.columns, self.letters, strict=False)] if self.layout else []
        stamps = ((("TimeUS", "Q"), 1), (("TimeMS", "I"), 1000))
        return next(
            ((fields.index(field), unit) for field, unit in stamps if field in fields), None
        )

    def payload(self, values: tuple[Any, ...]) -> dict[str, Any]:
        """Return the fields by name, with the letters' factors applied and texts decoded; FILE data stay bytes."""
        named, fields = {}, iter(values)
        for name, letter in zip(self.columns, self.letters, strict=True):
            value: Any = [*islice(fields, 32)] if letter == "a" else next(fields)
            if letter in _DIVISORS:
                value = value / _DIVISORS[letter]
            elif letter in "nNZ" and not (letter == "Z" and self.name == "FILE"):
                value = _text(value)
            named[name] = value
        return named


#: The format of formats.
FMT = Format(_FMT_TYPE, "FMT", 89, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


class Record(NamedTuple):
    """Record: its type, stored fields, and time since boot [microseconds], None if not stated."""

    form: Format
    values: tuple[Any, ...]
    boot_us: int | None


def _declared(values: tuple[Any, ...]) -> Format | None:
    """Return the format declared by an FMT record; None if the bytes are no valid declaration."""
    try:
        name, letters, columns = (part.split(b"\0", 1)[0].decode("ascii") for part in values[2:])
    except UnicodeDecodeError:
        return None
    names = tuple(columns.split(",")) if columns else ()
    plausible = (
        values[1] >= _HEAD
        and all(part.isidentifier() for part in (name, *names))
        and (letters.isalnum() or not letters)
    )
    return Format(values[0], name, values[1], letters, names) if plausible else None


def is_dataflash(head: bytes) -> bool:
    """Return whether the first bytes of a file contain the declaration of a record type."""
    at, mark = -1, MAGIC + bytes([_FMT_TYPE])
    while (at := head.find(mark, at + 1)) >= 0:
        body = head[at + _HEAD : at + FMT.length]
        if FMT.layout and len(body) == FMT.layout.size and _declared(FMT.layout.unpack(body)):
            return True
    return False


def _records(data: mmap, statistics: ReadStatistics) -> Iterator[Record]:
    """Yield the records of a log, under the formats declared so far; bytes between them and a truncated last record are losses."""
    formats, size, at = {_FMT_TYPE: FMT}, len(data), 0

    def format_at(at: int) -> Format | None:
        """Return the format of the record at an offset; None without a whole record."""
        form = formats.get(data[at + 2]) if at + _HEAD <= size else None
        whole = form is not None and data[at : at + 2] == MAGIC and at + form.length <= size
        return form if whole else None

    def is_followed(end: int) -> bool:
        """Return whether a record or the end of the log follows at an offset; the second magic byte may be missing."""
        return MAGIC.startswith(data[end : end + 2])

    def after(first: int, last: int) -> int | None:
        """Return the offset of the next record that another record or the end of the log follows; None without one."""
        at = first - 1
        while (at := data.find(MAGIC, at + 1, min(last + 1, size))) >= 0:
            form = format_at(at)
            if form is not None and is_followed(at + form.length):
                return at
        return None

    while at < size:
        form = format_at(at)
        # the next one may be damaged, unless a sound one begins in this one
        if form is None or not (
            is_followed(at + form.length) or after(at + 1, at + form.length) is None
        ):
            following = after(at + 1, size)
            what = "bad bytes, or records of an unknown type, skipped"
            if following is None:
                what = "at the end: a truncated record or bad bytes, skipped"
            end = size if following is None else following
            statistics.lose(what, at, end - at)
            at = end
            continue
        values = form.layout.unpack_from(data, at + _HEAD) if form.layout is not None else ()
        if form is FMT and (new := _declared(values)) and new.type != _FMT_TYPE:
            formats[new.type] = new
        stamp = form.stamp
        yield Record(form, values, None if stamp is None else values[stamp[0]] * stamp[1])
        at += form.length


class DataflashReader(LogFile):
    """Reader of a DataFlash log, which has one clock.

    Times are UTC if the log has GPS time, fitted to the vehicle's clock over the whole log; otherwise they count from boot, as the report
    notes.
    """

    format = "dataflash"

    def messages(self) -> Iterator[Message]:
        """Yield the wanted records in file order.

        ``topic`` is ``dataflash/{NAME}``, ``schema`` is ``dataflash.{NAME}``, ``position`` the ordinal among all records of the file. A
        record without a stamp takes that of the previous one.

        Raises:
            LogError: The file cannot be read.
        """
        self.statistics = ReadStatistics()
        clock, stamp_us, notes = self._fit_clock()
        stamps = _Stamps(stamp_us)
        records, first = self._records(self.statistics), 0
        while batch := list(islice(records, _BATCH)):
            boot_ns = stamps.of([record.boot_us for record in batch]) * 1000
            times = (boot_ns if clock is None else clock.utc(boot_ns)).tolist()
            for position, (time_ns, record) in enumerate(zip(times, batch, strict=True), first):
                form = record.form
                topic, schema = self._topic(f"dataflash/{form.name}"), f"dataflash.{form.name}"
                self.statistics.read[topic] += 1
                if form.layout is None:
                    why = f"its format {form.letters} of {form.length} bytes does not fit the columns {','.join(form.columns)}"
                    self.statistics.undecodable(topic, why)
                elif self._wanted is None or schema in self._wanted:
                    payload = form.payload(record.values)
                    yield Message(time_ns, topic, schema, payload, self.input, position)
            first += len(batch)
            self.statistics.notes = (*notes, *stamps.notes())

    def _records(self, statistics: ReadStatistics) -> Iterator[Record]:
        with self._opened() as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            yield from _records(data, statistics)

    def _fit_clock(self) -> tuple[ClockFit | None, int, tuple[str, ...]]:
        """Return the clock fitted to the log's GPS time, the log's first stamp [microseconds], and notes."""
        gps, first_us = [], None
        for form, values, boot_us in self._records(ReadStatistics()):
            if boot_us is None or boot_us > _MAX_BOOT_US:
                continue
            if first_us is None:
                first_us = boot_us
            if form.name == "GPS" and set(_GPS_TIME) <= set(form.columns):
                payload = form.payload(values)
                stated = [payload[key] for key in _GPS_TIME]
                if all(isinstance(value, int) for value in stated):
                    gps.append(stated)
        boot, status, week, week_ms = np.array(gps or np.empty((0, 4)), dtype=np.int64).T
        timed = (status >= _FIX_3D) & (week > 0) & (week < _MAX_WEEK)
        if not timed.any():
            note = "no GPS time: times count from the vehicle's start, as if that were 1970-01-01"
            return None, first_us or 0, (note,)
        fit = fit_clock(boot[timed] * 1000, gps_to_utc(week[timed], week_ms[timed]))
        ahead = int(leap_seconds(np.array([fit.utc_ns]))[0])
        note = f"UTC from GPS time less {ahead} leap seconds, fitted to the vehicle's clock: {fit}"
        return fit, first_us or 0, (note,)


class _Stamps:
    """Times since boot of consecutive records, with counts of implausible stamps; mutable, as records are streamed."""

    def __init__(self, first_us: int) -> None:
        """Create the state from the stamp for records before the first stamped one [microseconds]."""
        self._last = first_us
        self._backward = 0
        self._most_us = 0
        self._impossible = 0
        self._spikes = 0

    def of(self, stated: list[int | None]) -> NDArray[np.int64]:
        """Return the stamps of the next records [microseconds]; a record without a stamp takes that of the previous one."""
        known = [k for k, stamp in enumerate(stated) if stamp is not None and stamp <= _MAX_BOOT_US]
        self._impossible += len(stated) - stated.count(None) - len(known)
        stamps, spikes = without_spikes(np.array([stated[k] for k in known], np.int64), self._last)
        self._spikes += spikes
        steps = np.diff(stamps, prepend=self._last)
        self._backward += int(np.count_nonzero(steps < 0))
        self._most_us = max(self._most_us, -int(steps.min(initial=0)))
        before = np.searchsorted(known, np.arange(len(stated)), side="right")
        filled = np.append(self._last, stamps)[before]
        self._last = int(filled[-1])
        return filled

    def notes(self) -> tuple[str, ...]:
        """Return notes for the user."""
        back = f"stamps go backwards, by up to {self._most_us / 1000:.3f} ms"
        odd = "records with an impossible stamp were given the time of the record before"
        notes = [
            f"{n} {what}" for n, what in ((self._backward, back), (self._impossible, odd)) if n
        ]
        return (*notes, *([spikes_note(self._spikes)] if self._spikes else []))


def _text(value: bytes) -> str:
    value = value.split(b"\0", 1)[0]
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value.decode("latin-1")
